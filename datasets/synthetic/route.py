"""The railway line itself, without season: where the land rises, what grows and what was built along it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .chance import FULL, Chance, Ints

METRE = 16  # units of length
PLACE_SPACING = 150 * METRE  # what a train covers between two frames of Nordland, some 8 s apart

#: Cross-sections of the land that a view is built from, far to near.
DEPTHS = METRE * np.array([420, 330, 260, 205, 162, 128, 101, 80, 63, 50, 39, 31, 25, 20, 16, 13, 10, 8])
#: Where each cross-section is known, to either side of the track.
COLUMNS = METRE * np.array([3, 5, 8, 12, 18, 27, 41, 62, 95, 150, 240])
#: Woods stand behind the first so many cross-sections, each with as many treetops to either side.
BELTS = 14
TOPS = 28
#: Far mountain ridges are known every so many pixels.
RIDGE_X = np.arange(-8, 169, 4)
WATER_LEVEL = -4 * METRE

_SIDES = np.array([0, 1])
# Rise of a bank or a cutting, of the hills behind it and of a lake's basin, per column, in 1/64 of all.
_BANK = np.array([0, 4, 24, 52, 64, 64, 64, 64, 64, 64, 64])
_HILL = np.array([0, 0, 1, 2, 4, 7, 12, 20, 32, 48, 64])
_BASIN = np.array([0, 0, 8, 40, 64, 64, 64, 64, 60, 36, 0])
_HILL_WAVELENGTH = np.array([60, 60, 70, 90, 120, 150, 190, 240, 320, 450, 700])


@dataclass(frozen=True)
class View:
    """The land ahead of one camera position; n is the number of cross-sections, the last axis left and right.

    Covers run from 0 to FULL - 1 unless said otherwise.
    """

    heights: Ints  # (n, 2, columns), in units above the rails
    wet: Ints  # (n, 2), above 0 where there is water
    forest: Ints  # (n, 2), may leave the range at both ends
    birch: Ints  # (n, 2)
    tillage: Ints  # (n, 2)
    settlement: Ints  # (n, 2)
    tone: Ints  # (n, 2), light and dark ground
    rock: Ints  # (n, 2)
    clearing: Ints  # (n, 2), how far the woods stand back from the line
    altitude: Ints  # (n,)
    station: Ints  # (n,), above 0 beside a platform
    road: Ints  # (n,), above 0 where a road runs along
    road_side: int  # 0 left, 1 right
    treetops: Ints  # (BELTS, 2, TOPS)
    ridges: Ints  # (2, len(RIDGE_X)), far to near, in 1/16 pixel above the horizon
    bend: int  # of the track, in 1/16 pixel at the farthest cross-section
    grade: int  # of the horizon, in 1/16 pixel
    electrified: bool


def _ridge_basis() -> Ints:
    """Return what each knot of three octaves adds to each ridge column, (columns, knots), in 1/256."""
    parts = []
    for spacing, weight in ((44, 128), (16, 64), (4, 28)):
        knots = np.arange(-8, 169 + spacing, spacing)
        nearness = np.maximum(0, spacing - np.abs(RIDGE_X[:, None] - knots[None]))
        parts.append(nearness * weight // spacing)
    return np.concatenate(parts, axis=1)


_RIDGE_BASIS = _ridge_basis()

# Every noise that a view needs, as (name, channels, depths, wavelengths in metres), broadcast to one shape
# each: looking all of them up at once is several times faster than one after the other.
_NOISES: tuple[tuple[str, Ints, Ints, Ints], ...] = (
    (
        "covers",  # bank, hills, wet, forest, birch, tillage, settlement, tone, rock, clearing
        10 + 2 * np.arange(10)[:, None, None] + _SIDES,
        DEPTHS[:, None],
        np.array([260, 1300, 900, 700, 700, 350, 1500, 24, 90, 180])[:, None, None],
    ),
    ("line", np.array([30, 31, 32])[:, None], DEPTHS, np.array([6000, 1400, 2500])[:, None]),
    ("here", np.arange(40, 46), np.array(0), np.array([330, 800, 9000, 4000, 3000, 3000])),
    ("hills", 100 + 2 * np.arange(11) + _SIDES[:, None], DEPTHS[:, None, None], _HILL_WAVELENGTH),
    ("treetops", 200 + 2 * np.arange(TOPS) + _SIDES[:, None], DEPTHS[:BELTS, None, None], np.array(45)),
    (
        "ridges",
        np.array([[300], [400]]) + np.arange(_RIDGE_BASIS.shape[1]),
        np.array(0),
        np.array([[5200], [1700]]),
    ),
)


class Route:
    """A pure function from a position on the line to the land ahead of it."""

    def __init__(self, chance: Chance) -> None:
        """Lay out which noises a view needs; they themselves follow from chance."""
        grids = {name: np.broadcast_arrays(*grid) for name, *grid in _NOISES}
        self._shapes = {name: grid[0].shape for name, grid in grids.items()}
        flat = [np.concatenate([grid[i].ravel() for grid in grids.values()]) for i in range(3)]
        self._chance = chance
        self._channels, self._depths, self._waves = flat[0], flat[1], flat[2] * METRE

    def view(self, position: int) -> View:
        """Return the land ahead of `position` (units)."""
        flat = self._chance.smooth(self._channels, self._depths + position, self._waves)
        noise, start = {}, 0
        for name, shape in self._shapes.items():
            size = int(np.prod(shape))
            noise[name] = flat[start : start + size].reshape(shape)
            start += size
        bank, hills, wet, forest, birch, tillage, settlement, tone, rock, clearing = noise["covers"]
        altitude, station, road = noise["line"]
        bend, grade, electrified, road_side = (int(value) for value in noise["here"][:4])
        lift = noise["here"][4:, None]
        wet = np.maximum(0, wet - 640)
        thinned = np.maximum(0, altitude - 600)[:, None] * 2 + np.maximum(0, tillage - 600)
        profile = noise["ridges"] @ _RIDGE_BASIS.T >> 8
        return View(
            heights=_heights(bank, hills, noise["hills"], wet),
            wet=wet,
            forest=(forest >> 1) + 480 + (birch >> 3) - thinned,
            birch=birch,
            tillage=tillage,
            settlement=settlement,
            tone=tone,
            rock=rock,
            clearing=clearing,
            altitude=altitude,
            station=np.maximum(0, station - 800),
            road=np.maximum(0, road - 520),
            road_side=int(road_side > FULL // 2),
            treetops=noise["treetops"],
            ridges=profile * (lift + 150) // 1600 - np.array([[0], [40]]),
            bend=(bend - FULL // 2) * 2,
            grade=(grade - FULL // 2) >> 3,
            electrified=electrified > 3 * FULL // 4,
        )


def _heights(bank: Ints, hills: Ints, rough: Ints, wet: Ints) -> Ints:
    """Return the land's height (n, 2, columns): a bank or cutting by the track, hills or a lake behind it."""
    bank_height = ((bank - 400) * (9 * METRE) >> 10)[..., None]
    hill_height = ((rough - 300) * (300 + hills[..., None]) >> 10) * (60 * METRE) >> 10
    heights = (bank_height * _BANK + hill_height * _HILL - (wet[..., None] * _BASIN >> 2)) >> 6
    # Below the water the land is out of sight: sink it far enough to stay hidden.
    return np.where((wet[..., None] > 0) & (heights < WATER_LEVEL), -40 * METRE, heights)
