"""What stands on the street: trees, lamps and signs that stay, vehicles and people that every traverse meets anew."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..rendering.chance import FULL, Chance, Ints
from .faces import METRE, NEAR, Corner, Mask, Numbers, faces
from .town import PARK, ROAD, Lots
from .weather import Weather

_SIDES = np.array([[0], [1]])
_BARK = np.array([86, 74, 62])
_STEEL = np.array([58, 60, 64])
_CAR_PAINTS = np.array([
    (160, 30, 30), (36, 60, 120), (216, 216, 216), (34, 36, 40),
    (120, 122, 126), (190, 190, 196), (50, 80, 60), (236, 236, 232),
])  # fmt: skip
_COATS = np.array([(40, 44, 60), (150, 40, 44), (60, 60, 62), (196, 170, 120), (40, 90, 110), (220, 210, 190)])
_CLEAR = 7 * METRE  # ahead of the camera: nearer vehicles would hide the street
_LAMPLIGHT = (255, 208, 128)
_LIGHTS = np.array([(120, 30, 28), (255, 246, 220), (230, 30, 24)])  # parked, oncoming, ahead
_VEHICLES = np.array([(68, 14, 15, 24), (84, 16, 30, 36), (170, 20, 44, 68)])  # length, half width, waist, top
_BUS_PAINT = np.array((176, 28, 32))
_GLASS = np.array([42, 48, 56])
# A tree's crown, in 1/64 of its half width and of its height above the ground.
_CROWN = ((-64, 36), (-50, 54), (-14, 64), (28, 61), (58, 48), (60, 32), (30, 20), (-36, 19))
_BARE = ((-4, 20), (-40, 46), (-20, 56), (-4, 64), (18, 58), (44, 48), (8, 26), (4, 20))


@dataclass(frozen=True)
class _Slots:
    """Where something may stand, n of them, on both sides of the street."""

    depth: Ints  # (n,), from the camera
    sign: Ints
    dice: Ints  # (8, n)

    def take(self, chosen: Mask) -> _Slots:
        at = np.flatnonzero(chosen & (self.depth > NEAR))
        return _Slots(self.depth[at], self.sign[at], self.dice[:, at])


class Furniture:
    """Knows the slots of everything that stands on the street."""

    def __init__(self, chance: Chance) -> None:
        """Keep the chance that everything follows from."""
        self._chance = chance

    def _slots(self, position: int, channel: int, spacing: int, reach: int) -> _Slots:
        """Return slots every `spacing` metres up to `reach` metres ahead, on the left and on the right."""
        index = position // (spacing * METRE) + np.arange(reach // spacing + 1)
        dice = self._chance.dice(channel + _SIDES, np.stack([index, index])).reshape(8, -1)
        depth = np.tile(index * spacing * METRE - position, 2)
        return _Slots(depth + (dice[7] * spacing * METRE >> 9), np.repeat([-1, 1], len(index)), dice)

    def faces(self, position: int, place: int, weather: Weather, lots: Lots) -> list[Ints]:
        """Return all that stands ahead of `position` (units) at a place."""
        own = 2000 + 100 * weather.number
        green, parking, queue, gap = self._chance.smooth(
            np.array([1900, 1901, own + 40, own + 41]),
            np.array([position, position, place * METRE, place * METRE]),
            METRE * np.array([170, 260, 9, 5]),
        ).tolist()
        return [
            *_trees(self._slots(position, 1500, 9, 90), weather, green, lots),
            *_lamps(self._slots(position, 1510, 26, 104), weather),
            *_signs(self._slots(position, 1520, 17, 60)),
            *_vehicles(
                _parked(self._slots(position, own, 6, 72), weather, parking),
                _oncoming(self._slots(position, own + 10, 24, 96), weather),
                _ahead(weather, self._chance.dice(own + 30, np.array([place // 7])), queue, gap),
                weather,
            ),
            *_people(self._slots(position, own + 20, 5, 45), weather),
        ]


def _upright(x: Numbers, half: Numbers, low: Numbers, high: Numbers, depth: Ints) -> list[Corner]:
    """Return a rectangle that faces the camera."""
    return [(x - half, low, depth), (x - half, high, depth), (x + half, high, depth), (x + half, low, depth)]


def _shaped(shape: tuple[tuple[int, int], ...], x: Ints, half: Ints, height: Ints, depth: Ints) -> list[Corner]:
    return [(x + across * half // 64, up * height // 64, depth) for across, up in shape]


def _trees(slots: _Slots, weather: Weather, green: int, lots: Lots) -> list[Ints]:
    """Return trees along the kerb where the street is green, and thicker behind it in parks."""
    parks = lots.take((lots.kind == PARK) & (lots.start > NEAR))
    chosen = slots.take(slots.dice[0] << 2 < green - 420)
    depth = np.concatenate([chosen.depth, parks.start, parks.start + 4 * METRE])
    sign = np.concatenate([chosen.sign, parks.sign, parks.sign])
    dice = np.concatenate([chosen.dice, parks.dice, parks.block], axis=1)
    beyond = np.repeat([METRE, 6 * METRE], [len(chosen.depth), 2 * len(parks.start)])
    x = sign * (ROAD + beyond + (dice[3] >> 2))
    height = (6 + dice[1] // 42) * METRE
    half = height * (60 + (dice[2] >> 2) + weather.foliage // 6) >> 8
    leaf = np.array(weather.leaf) + (dice[4] >> 3)[:, None] - 16
    full = weather.foliage > 100
    crown = _shaped(_CROWN if full else _BARE, x, half if full else half * 3 >> 2, height, depth)
    shaded = [(x, height // 4, depth), (x + half // 2, height // 3, depth), (x + half * 3 // 4, height * 2 // 3, depth),
              (x + half // 8, height * 5 // 8, depth)]  # fmt: skip
    branches = leaf if full else _BARK + (dice[4] >> 4)[:, None]
    return [
        faces(_upright(x, 3 + (dice[5] >> 6), 0, height >> 1, depth), _BARK, depth, 0, rough=40),
        faces(crown, branches, depth, 1, shade=250, rough=110),
        faces(shaded, branches, depth, 2, shade=180, rough=110),
    ]


def _lamps(slots: _Slots, weather: Weather) -> list[Ints]:
    """Return street lamps, on one side mostly."""
    slots = slots.take(slots.dice[0] < np.where(slots.sign > 0, 60, 220))
    x, depth, height = slots.sign * (ROAD + 8), slots.depth, 6 * METRE + (slots.dice[1] >> 3)
    arm = x - slots.sign * 14
    shining = weather.lamps > 200
    colour = _LAMPLIGHT if shining else (150, 150, 146)
    post = faces(_upright(x, 2, 0, height, depth), _STEEL, depth, 0, rough=0)
    reach = faces([(x, height - 3, depth), (x, height, depth), (arm, height, depth), (arm, height - 3, depth)],
                  _STEEL, depth, 0, rough=0)  # fmt: skip
    head = faces(_upright(arm, 7, height - 7, height, depth), colour, depth, 1, rough=0, glow=int(shining))
    return [post, reach, head]


def _signs(slots: _Slots) -> list[Ints]:
    """Return traffic signs, letter boxes and bus stops."""
    slots = slots.take(slots.dice[0] < 90)
    x, depth = slots.sign * (ROAD + 10), slots.depth
    kind = slots.dice[1] % 3
    colour = np.array([(196, 36, 32), (28, 80, 160), (232, 226, 210)])[kind]
    half, low, high = np.array([(8, 0, 26), (7, 34, 48), (10, 34, 58)])[kind].T
    return [
        faces(_upright(x, 1, 0, high, depth), _STEEL, depth, 0, rough=0),
        faces(_upright(x, half, low, high, depth), colour, depth, 1, rough=0),
    ]


def _flank(x: Ints, low: Numbers, high: Numbers, near: Ints, far: Ints) -> list[Corner]:
    """Return a rectangle that runs along the street."""
    return [(x, low, near), (x, high, near), (x, high, far), (x, low, far)]


def _parked(slots: _Slots, weather: Weather, parking: int) -> _Slots:
    """Return where this traverse finds vehicles at the kerb."""
    allowed = np.where(slots.sign < 0, parking - 300, 724 - parking) > 0
    return slots.take((slots.dice[0] < weather.parked) & allowed & (slots.depth > _CLEAR))


def _oncoming(slots: _Slots, weather: Weather) -> _Slots:
    """Return where this traverse meets vehicles in the other lane."""
    return slots.take((slots.dice[0] < weather.busy) & (slots.sign > 0) & (slots.depth > _CLEAR))


def _ahead(weather: Weather, dice: Ints, queue: int, gap: int) -> _Slots:
    """Return the vehicle that this traverse follows for a while, if any."""
    near = np.array([9 * METRE + gap * 26 * METRE // FULL])
    return _Slots(near, np.array([-1]), dice).take(np.array([queue * 256 < weather.busy * FULL]))


def _vehicles(parked: _Slots, oncoming: _Slots, ahead: _Slots, weather: Weather) -> list[Ints]:
    """Return cars, vans and a few buses: shadows, bodies, cabins, windows, wheels and lights."""
    groups = (parked, oncoming, ahead)
    group = np.repeat([0, 1, 2], [len(slots.depth) for slots in groups])
    near, sign = (np.concatenate([getattr(slots, name) for slots in groups]) for name in ("depth", "sign"))
    dice = np.concatenate([slots.dice for slots in groups], axis=1)
    beside = np.where(group == 0, ROAD - 16 - (dice[3] >> 6), 24 + (dice[3] >> 5))
    x, inner = sign * beside, -sign  # the side towards the street's middle is seen
    kind = np.searchsorted([170, 240], np.where(group == 0, np.minimum(dice[1], 230), dice[1]))  # car, van, bus
    length, half, waist, top = _VEHICLES[kind].T
    top = top + (dice[6] >> 6)
    far = near + length
    paint = np.where((kind == 2)[:, None], _BUS_PAINT, _CAR_PAINTS[dice[2] & 7])
    rear, front = near + length // 6, far - length // 4
    side, cabin_side, glass_side = x + inner * half, x + inner * (half - 2), x + inner * (half - 1)
    shining = (group > 0) & (weather.lamps > 0)
    light = np.where(shining[:, None], _LIGHTS[group], _LIGHTS[0])
    return [
        faces([(x - half - 2, 0, near), (x - half - 2, 0, far), (x + half + 2, 0, far), (x + half + 2, 0, near)],
              (26, 26, 28), far, 0, rough=0),
        faces(_upright(x, half - 2, 0, 5, near), (20, 20, 22), near, 1, rough=0),
        faces(_flank(cabin_side, waist, top, rear, front), paint * 7 >> 3, near, 2, shade=236, rough=0),
        faces(_flank(glass_side, waist + 1, top - 3, rear + 3, front - 3), _GLASS, near, 3, rough=0),
        faces(_upright(x, half - 2, waist, top, rear), paint, near, 4, shade=226, rough=0),
        faces(_upright(x, half - 4, waist + 1, top - 2, rear), _GLASS, near, 5, shade=300, rough=0),
        faces(_flank(side, 4, waist, near, far), paint, near, 6, shade=230, rough=4),
        faces(_upright(x, half, 4, waist, near), paint, near, 7, shade=210, rough=4),
        faces(_upright(x - half + 4, 2, 9, 12, near), light, near, 8, rough=0, glow=shining),
        faces(_upright(x + half - 4, 2, 9, 12, near), light, near, 8, rough=0, glow=shining),
    ]  # fmt: skip


def _people(slots: _Slots, weather: Weather) -> list[Ints]:
    """Return people on the pavements, some with an umbrella."""
    slots = slots.take(slots.dice[0] < weather.busy // 2)
    x, depth = slots.sign * (ROAD + 6 + (slots.dice[3] >> 3)), slots.depth
    tall, coat = 24 + (slots.dice[4] >> 5), _COATS[slots.dice[2] % len(_COATS)]
    head = faces(_upright(x, 2, tall, tall + 5, depth), (176, 132, 108), depth, 1, rough=0)
    umbrella = [
        (x - 11, tall + 4, depth),
        (x - 5, tall + 10, depth),
        (x + 5, tall + 10, depth),
        (x + 11, tall + 4, depth),
    ]
    open_now = np.broadcast_to(weather.drops > 0, x.shape) & (slots.dice[5] < 150)
    return [
        faces(_upright(x, 3, 0, 13, depth), (40, 42, 54), depth, 0, rough=0),
        faces(_upright(x, 5, 12, tall, depth), coat, depth, 0, rough=0),
        head,
        faces(umbrella, coat[:, ::-1], depth, 2, rough=0)[open_now],
    ]
