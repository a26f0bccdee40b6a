"""What stands beside the line: trees, houses, masts, and what comes and goes from traverse to traverse."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from .chance import Chance, Ints
from .route import COLUMNS, DEPTHS, METRE, View
from .seasons import SEASONS, Season, SnowCover
from .shapes import SHAPE

SNOW = np.array([234, 239, 247])
_BARK = np.array([112, 104, 98])
_GLASS = np.array([44, 48, 56])
_STEEL = np.array([92, 94, 96])
_CONCRETE = np.array([116, 114, 112])
_WALLS = np.array([
    (150, 44, 36), (186, 150, 62), (226, 224, 214),
    (146, 120, 92), (124, 58, 46), (96, 112, 122),
])  # fmt: skip
_ROOFS = np.array([(70, 66, 66), (104, 70, 58), (52, 54, 60), (88, 84, 80)])
_PAINTS = np.array([
    (170, 40, 36), (40, 70, 140), (214, 214, 214), (40, 44, 50), (200, 160, 40), (60, 100, 70),
])  # fmt: skip
_COATS = np.array([(226, 222, 210), (96, 66, 46), (52, 42, 38), (160, 120, 80)])

_NOWHERE = -(10**6)  # as a foot: stand on the ground, whatever its height


@dataclass
class Things:
    """Flat outlines that face the camera, n of them; lengths in units of the route."""

    depth: Ints  # (n,)
    x: Ints  # to the right of the track's middle
    foot: Ints  # above the rails
    half_width: Ints
    height: Ints
    shape: Ints
    colour: Ints  # (n, 3), before light and haze
    rough: Ints  # strength of the texture, 0 to 255


@dataclass
class _Slots:
    """Short stretches of the line, m of them, each with its own dice: what stands in one stays there."""

    view: View
    depth: Ints  # (m,)
    side: Ints  # 0 left, 1 right
    section: Ints  # the cross-section just behind
    dice: Ints  # (8, m)

    def here(self, cover: Ints) -> Ints:
        """Return what a cover (n, 2) is at each slot."""
        return cover[self.section, self.side]

    def take(self, chosen: npt.NDArray[np.bool_]) -> _Slots:
        """Return only the chosen slots."""
        at = np.flatnonzero(chosen)
        return _Slots(self.view, self.depth[at], self.side[at], self.section[at], self.dice[:, at])

    def part(
        self, shape: Ints | int, lateral: Ints | int, half_width: Ints | int, height: Ints | int,
        colour: Ints, rough: int, foot: int = _NOWHERE,
    ) -> Ints:  # fmt: skip
        """Return rows (m, 12) for `Scenery.things`: one outline in each slot, `lateral` from the track."""
        rows = np.empty((len(self.depth), 12), np.int64)
        rows[:, 0], rows[:, 1], rows[:, 2] = self.depth, self.side, self.section
        rows[:, 3], rows[:, 4], rows[:, 5], rows[:, 6] = shape, lateral, half_width, height
        rows[:, 7:10], rows[:, 10], rows[:, 11] = colour, rough, foot
        return rows


# Channel, spacing and reach in metres.
_KINDS = {
    "trees": (1000, 4, 200),
    "houses": (1010, 22, 300),
    "masts": (1020, 50, 360),
    "bridges": (1030, 500, 420),
    "visitors": (1100, 12, 150),  # of each traverse its own
}


class Scenery:
    """Knows the slots of everything that stands beside the line; the slots follow from chance alone."""

    def __init__(self, chance: Chance) -> None:
        """Lay out the slots ahead of any camera, so that a view has to look up its dice only once."""
        self._chance = chance
        number, metres, reach = np.array([*_KINDS.values()]).T
        counts = 2 * (reach // metres)
        firsts = np.cumsum(counts) - counts
        within = np.arange(counts.sum()) - np.repeat(firsts, counts)
        self._parts = {kind: slice(a, a + n) for kind, a, n in zip(_KINDS, firsts, counts, strict=True)}
        self._ahead, self._spacing = 1 + within // 2, np.repeat(metres * METRE, counts)
        channels = np.repeat(number, counts) + within % 2
        self._side = channels % 2
        coming_and_going = channels >= _KINDS["visitors"][0]
        self._channels = {name: channels + 10 * season.number * coming_and_going for name, season in SEASONS.items()}

    def things(self, view: View, season_name: str, position: int, snow: SnowCover) -> Things:
        """Return all that stands in view; the houses' roofs carry as much snow as the land."""
        index = position // self._spacing + self._ahead
        depth = index * self._spacing - position
        dice = self._chance.dice(self._channels[season_name], index)
        section = np.searchsorted(-DEPTHS, -depth, "right") - 1
        seen = depth > DEPTHS[-1]

        def slots(kind: str) -> _Slots:
            own = self._parts[kind]
            return _Slots(view, depth[own], self._side[own], section[own], dice[:, own]).take(seen[own])

        season = SEASONS[season_name]
        rows = np.concatenate([
            *_trees(slots("trees"), season, snow.woods), *_houses(slots("houses"), snow.land), *_masts(slots("masts")),
            *_bridges(slots("bridges")), *_visitors(slots("visitors")),
        ])  # fmt: skip
        depth, side, section, shape, lateral, half_width, height = rows[:, :7].T
        foot = np.where(rows[:, 11] == _NOWHERE, _ground(view, section, side, np.abs(lateral)), rows[:, 11])
        x = lateral * (2 * side - 1)
        return Things(depth, x, foot, half_width, height, shape, rows[:, 7:10], rows[:, 10])


def _ground(view: View, section: Ints, side: Ints, lateral: Ints) -> Ints:
    """Return the land's height at a distance from the track."""
    column = np.minimum(np.searchsorted(COLUMNS[1:], lateral), len(COLUMNS) - 2)
    before = COLUMNS[column]
    low, high = view.heights[section, side, column], view.heights[section, side, column + 1]
    height: Ints = low + (high - low) * (lateral - before) // (COLUMNS[column + 1] - before)
    return height


def blend(colour: npt.ArrayLike, other: npt.ArrayLike, amount: Ints) -> Ints:
    """Return (m, 3) colours that are `amount` (m,), 0 to 256, on the way from one colour to another."""
    start = np.asarray(colour, np.int64)
    return start + ((np.asarray(other, np.int64) - start) * amount[:, None] >> 8)


def _trees(slots: _Slots, season: Season, snow: Ints) -> list[Ints]:
    """Return trees and bushes, as dense as the forest is here; broadleaved trees may be bare."""
    slots = slots.take((slots.dice[0] << 2) < np.minimum(np.maximum(slots.here(slots.view.forest), 130), 900))
    stand, size, kind, shade, lean, low = slots.dice[1:7]
    dry = slots.here(slots.view.wet) == 0
    lateral = np.where(dry, 6 * METRE + ((stand * stand * 52 * METRE) >> 16), (5 * METRE) + (stand >> 3))
    bush = (low < 90) | ~dry
    broad = ~bush & (kind * 4 < slots.here(slots.view.birch))
    height = np.where(bush, METRE + size * METRE // 128, 5 * METRE + size * METRE // 32)
    crown_width = height * (70 + (lean >> 2)) * (128 + season.foliage // 2) >> 16
    width = np.where(bush, METRE + lean * METRE // 200, np.where(broad, crown_width, height >> 2))
    leafy = (bush | broad)[:, None]
    colour = np.where(leafy, season.leaf, season.conifer) * (200 + (shade >> 1))[:, None] >> 8
    colour = blend(colour, SNOW, snow[slots.section] * np.where(bush, 90, np.where(broad, 40, 180)) >> 8)
    crown = SHAPE["crown"] + lean % 2 if season.foliage else SHAPE["twigs"]
    shape = np.where(bush, SHAPE["bush"], np.where(broad, crown, SHAPE["conifer"] + lean % 2))
    at = np.flatnonzero(broad)
    trunks = slots.take(broad).part(SHAPE["trunk"], lateral[at], height[at] >> 2, height[at], _BARK, 20)
    return [trunks, slots.part(shape, lateral, width, height, colour, 120)]


def _houses(slots: _Slots, snow: Ints) -> list[Ints]:
    """Return farms, houses and station buildings where there is a settlement."""
    dense = np.maximum(slots.here(slots.view.settlement) - 420, slots.view.station[slots.section] * 3)
    slots = slots.take((slots.dice[0] << 2 < dense) & (slots.here(slots.view.wet) == 0))
    if not len(slots.depth):
        return []
    paint, stand, wide, tall, cover = slots.dice[1:6]
    size = (14 + stand // 5) * METRE, 3 * METRE + wide * METRE // 50, 3 * METRE + tall * METRE // 60
    roof = blend(_ROOFS[cover % len(_ROOFS)], SNOW, snow[slots.section])
    return [
        slots.part(SHAPE["wall"], *size, _WALLS[paint % len(_WALLS)], 20),
        slots.part(SHAPE["roof"] + (cover >> 7), *size, roof, 20),
        slots.part(SHAPE["window left"], *size, _GLASS, 0),
        slots.part(SHAPE["window right"], *size, _GLASS, 0),
    ]


def _masts(slots: _Slots) -> list[Ints]:
    """Return the masts of the overhead line, or a few signals where there is none."""
    if slots.view.electrified:
        slots = slots.take(slots.side == 0)
        top = 7 * METRE + (slots.dice[0] >> 4)
        return [
            slots.part(SHAPE["trunk"], 4 * METRE, METRE, top, _STEEL, 10, foot=0),
            slots.part(SHAPE["arm"], 4 * METRE, 4 * METRE, 7 * METRE, _STEEL, 0, foot=0),
        ]
    slots = slots.take(slots.dice[0] < 24)
    height = 4 * METRE + (slots.dice[1] >> 4)
    return [
        slots.part(SHAPE["trunk"], 4 * METRE, METRE, height, _STEEL, 10, foot=0),
        slots.part(SHAPE["head"], 4 * METRE, METRE // 2, height, np.array([30, 30, 32]), 0, foot=0),
    ]


def _bridges(slots: _Slots) -> list[Ints]:
    """Return roads that cross over the track."""
    slots = slots.take((slots.side == 0) & (slots.dice[0] < 70))
    deck = 9 * METRE + (slots.dice[2] >> 4)
    return [
        slots.part(SHAPE["trunk"], -7 * METRE, 9 * METRE, deck, _CONCRETE, 40, foot=0),
        slots.part(SHAPE["trunk"], 7 * METRE, 9 * METRE, deck, _CONCRETE, 40, foot=0),
        slots.part(SHAPE["deck"], 0, 30 * METRE + slots.dice[1] * 2, deck, _CONCRETE, 60, foot=0),
    ]


# What visits the line: half width and height in units, and its two outlines.
_VISITORS = (
    (36, 16, "wall", "cabin"),  # cars
    (5, 24, "wall", "head"),  # people
    (16, 26, "body", "legs"),  # animals
    (44, 44, "wall", "flat roof"),  # sheds
)
_VISITOR_WIDTH, _VISITOR_HEIGHT = np.array([visitor[:2] for visitor in _VISITORS]).T
_VISITOR_SHAPES = np.array([[SHAPE[name] for name in visitor[2:]] for visitor in _VISITORS])


def _visitors(slots: _Slots) -> list[Ints]:
    """Return what only this traverse met: cars, people on platforms, animals, sheds and stacks."""
    platform = slots.view.station[slots.section]
    busy = 26 + (slots.here(slots.view.settlement) >> 5) + (platform >> 2)
    kind = slots.dice[1] % 4
    slots = slots.take((slots.dice[0] < busy) & (slots.here(slots.view.wet) == 0) & ((kind != 1) | (platform > 0)))
    if not len(slots.depth):
        return []
    kind, paint, stand = slots.dice[1] % 4, slots.dice[2], slots.dice[3]
    lateral = np.where(kind == 1, 3 * METRE + (stand >> 4), 7 * METRE + stand * METRE // 12)
    colour = np.where((kind == 2)[:, None], _COATS[paint % len(_COATS)], _PAINTS[paint % len(_PAINTS)])
    size = lateral, _VISITOR_WIDTH[kind], _VISITOR_HEIGHT[kind] + (slots.dice[4] >> 4)
    return [
        slots.part(_VISITOR_SHAPES[kind, 0], *size, colour, 20),
        slots.part(_VISITOR_SHAPES[kind, 1], *size, colour * 3 >> 2, 20),
    ]
