"""What is built along the street, whatever the weather: lots with houses, parks and side streets."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..rendering.chance import FULL, Chance, Ints
from .faces import METRE, REACH, Mask

PLACE_SPACING = 14 * METRE
ROAD = 5 * METRE  # from the street's middle to the kerb
TERRACE, STONE, SHOP, MODERN, PARK, SIDE_STREET = range(6)

_DICE = ("dice", "block")
_LOT = 7 * METRE
_BLOCK = 4  # lots that were built together
_LOTS = REACH // _LOT + 2
_SIGNS = np.array([-1, 1])
_SIDES = np.array([0, 1])[:, None]

_BRICK = ((142, 78, 60), (158, 96, 72), (124, 66, 54), (170, 128, 98))
_LIMESTONE = ((206, 182, 136), (188, 166, 122), (216, 198, 160), (172, 156, 124))
_PAINTED = ((226, 220, 206), (206, 196, 178), (178, 200, 206), (222, 196, 170))
_CONCRETE = ((150, 148, 144), (172, 168, 162), (126, 124, 124), (164, 140, 120))
_WALLS = np.array([_BRICK, _LIMESTONE, _PAINTED, _CONCRETE])  # of TERRACE, STONE, SHOP, MODERN
_TINTS = np.array([0, -26, 18, -12])


@dataclass(frozen=True)
class Lots:
    """Stretches of both sides of the street, n of them, the left side first; lengths in units, depth from the camera.

    Every lot has its own dice, and shares others with its block.
    """

    sign: Ints  # (n,), -1 on the left, 1 on the right
    index: Ints  # (n,), counted along the street
    start: Ints
    end: Ints
    front: Ints  # distance of the house from the street's middle
    kind: Ints
    floors: Ints
    floor: Ints  # height of a floor
    rise: Ints  # from the eaves to the ridge
    bare: Mask  # the wall towards the camera is seen
    wall: Ints  # (n, 3), colour
    dice: Ints  # (8, n)
    block: Ints  # (8, n)

    @property
    def eaves(self) -> Ints:
        """Return the height of each front."""
        return self.floors * self.floor + METRE // 2

    def take(self, chosen: Mask) -> Lots:
        """Return only the chosen lots."""
        return self.at(np.flatnonzero(chosen))

    def at(self, numbers: Ints) -> Lots:
        """Return lots by number, as often as each is named."""
        return Lots(**{name: values[..., numbers] if name in _DICE else values[numbers]
                       for name, values in vars(self).items()})  # fmt: skip


@dataclass(frozen=True)
class Lie:
    """What a position on the street has whatever the traverse: how the street bends, climbs and lies to the sun."""

    bend: int  # in 1/16 pixel at REACH
    climb: int  # of the horizon, in 1/16 pixel
    sun_side: int  # -512 to 511: how much the sun comes from the right
    skyline: Ints  # heights of distant roofs, one every few pixels
    spire: int  # picture column of a church tower beyond the roofs, in 1/16 pixel; far outside mostly


class Town:
    """A pure function from a position on the street to what is built ahead of it."""

    def __init__(self, chance: Chance) -> None:
        """Keep the chance that everything follows from."""
        self._chance = chance

    def lots(self, position: int) -> Lots:
        """Return the lots ahead of `position` (units)."""
        index = position // _LOT + np.arange(_LOTS + 1) + 0 * _SIDES  # (2, lots + 1)
        dice = self._chance.dice(1000 + _SIDES, index)
        edge = index * _LOT + (dice[7] - 128 >> 2) - position
        index, dice = index[:, :-1], dice[:, :, :-1]
        block = self._chance.dice(1010 + _SIDES, (index + dice[6] // 200) // _BLOCK)
        district, green, breadth, tall = self._chance.smooth(
            (1020 + 2 * np.arange(4))[:, None, None] + _SIDES,
            index * _LOT,
            METRE * np.array([260, 230, 170, 140])[:, None, None],
        )
        kind = np.where(district < 440, TERRACE, np.where(district > 720, MODERN, STONE))
        kind = np.where((kind == STONE) & (block[1] < 120), SHOP, kind)
        kind = np.where(green > 770, PARK, kind)
        kind = np.where(dice[0] < 16, SIDE_STREET, kind)
        built = kind < PARK
        floors = 2 + (tall > 420) + (kind != TERRACE) * (block[2] > 150) + (kind == MODERN) * (dice[1] > 190)
        floor = np.where(kind == STONE, 56, 46) + (block[3] >> 5)
        garden = (kind == TERRACE) * (block[4] > 90) * 2 * METRE
        front = ROAD + 2 * METRE + (breadth * 4 * METRE // FULL) + garden + (block[5] >> 4) + (dice[2] > 200) * 12
        rise = np.where(kind == MODERN, 0, 2 * METRE + (block[6] >> 2)) * (block[7] > 40)
        height = np.where(built, floors * floor, 0)
        before = np.concatenate([height[:, :1], height[:, :-1]], axis=1)
        set_back = np.concatenate([front[:, :1], front[:, :-1]], axis=1)
        house = np.minimum(kind, MODERN)
        tint = _TINTS[dice[3] & 3] + (dice[3] >> 4)
        wall = _WALLS[house, np.where(house == SHOP, dice[4], block[0]) & 3] + tint[..., None]
        return Lots(
            sign=np.repeat(_SIGNS, _LOTS),
            index=index.ravel(),
            start=edge[:, :-1].ravel(),
            end=edge[:, 1:].ravel(),
            front=front.ravel(),
            kind=kind.ravel(),
            floors=floors.ravel(),
            floor=floor.ravel(),
            rise=rise.ravel(),
            bare=((before < height) | (set_back > front)).ravel(),
            wall=np.maximum(wall, 0).reshape(-1, 3),
            dice=dice.reshape(8, -1),
            block=block.reshape(8, -1),
        )

    def lie(self, position: int) -> Lie:
        """Return how the street lies at `position` (units)."""
        bend, climb, sun = self._chance.smooth(
            np.array([1040, 1041, 1042]), np.array(position), METRE * np.array([190, 240, 500])
        ).tolist()
        knots = np.arange(24)
        coarse, fine = self._chance.smooth(
            np.array([[1100], [1140]]) + knots,
            np.array(position),
            METRE * np.array([[160], [60]]),
        )
        tower = position // (420 * METRE)
        place, offset = self._chance.dice(1050, np.array([tower]))[:2, 0].tolist()
        ahead = (tower * 420 + 150 + place) * METRE - position
        spire = (offset - 128) * 3 + (offset - 128) * 60 * METRE // ahead if 0 < ahead < 260 * METRE else 10**6
        return Lie(
            bend=(bend - FULL // 2) * 3 // 2,
            climb=(climb - FULL // 2) >> 3,
            sun_side=sun - FULL // 2,
            skyline=16 + (coarse * 80 + fine * 50 >> 10),
            spire=spire,
        )
