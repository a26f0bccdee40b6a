"""Ground truth by position: which references lie within a radius of each query, and positions that are none."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from vprbench.api import BadInput, Paths

from .drives import position_jumps
from .file_dataset import GroundTruth, each_a_place

Metres = npt.NDArray[np.float64]  # (n, 2) east and north, or (n, 3)
Mask = npt.NDArray[np.bool_]  # (n,), of the images of a traverse
WithoutPosition = Literal["error", "keep", "drop"]  # of images without a position: keep takes the position as given

MOST_METRES = 1e8  # the way round the Earth is 4e7; of much larger numbers centimetres are lost, and squares overflow
_APART_METRES = 1e9  # between two grids
_EQUATOR_METRES = 6378137.0  # WGS 84
_FLATTENING = 1 / 298.257223563
_ROUNDING_METRES = 1e-7  # of coordinates of some million metres: decides about nothing but the edge of the radius
_AT_ONCE = 1024  # queries whose neighbours are lists of Python
_APART_RADII = 10  # from a number that stands twice to all other positions
_STANDING = 10  # times as many images at one position as usual
_LEAST = 10  # images before their extent tells anything
_NEAR = 1e-3  # no camera takes frames a millimetre apart; a thousandth of a degree is 100 m
_COARSE_METRES = (111_000, 11_100, 1_110)  # a degree, a tenth and a hundredth of it
_OR_DEGREES = "metres of one grid (degrees belong into columns lat,lon of dataset=image_list)"


@dataclass(frozen=True)
class Positions:
    """Where the images of one traverse were taken."""

    files: Paths
    given: npt.NDArray[np.float64]  # (n, 2), east and north in metres, or latitude and longitude; NaN: none
    in_degrees: bool = False
    grids: npt.NDArray[np.int64] | None = None  # (n,), of metres of several grids; images of two never show one place

    @cached_property
    def metres(self) -> Metres:
        """The positions in metres."""
        if self.grids is not None:
            return np.column_stack([self.given, self.grids * _APART_METRES])
        return earth_centred(*self.given.T) if self.in_degrees else self.given

    def choose(self, which: Mask) -> Positions:
        """Return the positions of some images."""
        grids = None if self.grids is None else self.grids[which]
        return Positions(self.files[which], self.given[which], self.in_degrees, grids)


def as_metres(named: str, array: npt.ArrayLike, n_images: int) -> Metres:
    """Return east and north of an array, (n, 2) or (2, n) of two images or more; raises BadInput for any other."""
    metres = np.asarray(array)
    if metres.shape == (2,) and n_images == 1:
        metres = metres[None]
    elif metres.shape == (2, n_images) and n_images != 2:
        metres = metres.T
    if metres.shape != (n_images, 2) or metres.dtype.kind not in "fiu":
        raise BadInput(f"{named} has the shape {metres.shape}; wanted are metres, 2 for each of {n_images} images")
    return metres.astype(np.float64)


def earth_centred(latitude: npt.NDArray[np.float64], longitude: npt.NDArray[np.float64]) -> Metres:
    """Return points of the WGS 84 ellipsoid, given in degrees, in metres from the centre of the Earth, (n, 3).

    The straight line between two points is shorter than the way on the ground by about its share d^2 / 24 R^2, at
    10 km 0.1 mm in a kilometre. There are no zones and no seam.
    """
    phi, lambda_ = np.radians(latitude), np.radians(longitude)
    eccentricity_squared = _FLATTENING * (2 - _FLATTENING)
    across = _EQUATOR_METRES / np.sqrt(1 - eccentricity_squared * np.sin(phi) ** 2)
    x, y = across * np.cos(phi) * np.cos(lambda_), across * np.cos(phi) * np.sin(lambda_)
    return np.stack([x, y, across * (1 - eccentricity_squared) * np.sin(phi)], axis=1)


def by_radius(references: Metres, queries: Metres, radius_metres: float) -> GroundTruth:
    """Return every reference as a place of its own; right is what lies within the radius, the radius included.

    Raises BadInput for a radius that is not above 0, or that spans more than the Earth.
    """
    _check_radius(radius_metres)
    tree, reach = KDTree(references), radius_metres + _ROUNDING_METRES
    near = (
        right
        for first in range(0, len(queries), _AT_ONCE)
        for right in tree.query_ball_point(queries[first : first + _AT_ONCE], reach, return_sorted=True)
    )
    truth = each_a_place(len(references), near, f"no reference within {radius_metres:g} m")
    return replace(truth, jumps=(position_jumps(references, radius_metres), position_jumps(queries, radius_metres)))


def by_positions(
    references: Sequence[Positions], queries: Positions, radius_metres: float, without: WithoutPosition = "error"
) -> GroundTruth:
    """Return the ground truth `by_radius` of traverses, in which some images may have no position.

    These (`find_without_position`) are an error, are left out (`drop`), or count where they say (`keep`). Raises
    BadInput for them, for a bad radius, and for coordinates that are no metres.
    """
    _check_radius(radius_metres)
    traverses = [*references, queries]
    for each in traverses:
        wrong = (np.abs(each.given) > MOST_METRES) | (np.isnan(each.given) & (without == "keep"))
        if wrong.any():
            first = int(wrong.any(axis=1).argmax())
            raise BadInput(
                f"the position of {each.files[first]} is {_pair(each.given[first])}: wanted are metres from -1e8 to "
                "1e8, or NaN with dataset.without_position=drop"
            )
    lacking = find_without_position(traverses, radius_metres)
    lack = _describe_lacking(traverses, lacking)
    if without == "error" and lack:
        raise BadInput(
            f"{lack}: correct them, or pass dataset.without_position=drop to leave them out, "
            "dataset.without_position=keep if they were taken there"
        )
    drops = without == "drop"
    kept = [~lacks if drops else np.full(len(lacks), True) for lacks in lacking]
    kept_references, kept_queries = np.flatnonzero(np.concatenate(kept[:-1])), np.flatnonzero(kept[-1])
    if not (len(kept_references) and len(kept_queries)):
        raise BadInput(f"{lack}, and dataset.without_position=drop leaves none")
    left = [each.choose(which) for each, which in zip(traverses, kept, strict=True)]
    _check_coordinates(left, radius_metres)
    truth = by_radius(np.concatenate([each.metres for each in left[:-1]]), left[-1].metres, radius_metres)
    counts = {
        "references_without_position": sum(int(lacks.sum()) for lacks in lacking[:-1]),
        "queries_without_position": int(lacking[-1].sum()),
    }
    note = f"{lack}; they {'are left out' if drops else 'count where they say'}" if lack else ""
    return replace(
        truth,
        references=kept_references if drops else None,
        queries=kept_queries if drops else None,
        protocol={} if without == "error" else {"without_position": without, **counts},
        notes=(note,) if note else (),
    )


def find_without_position(traverses: Sequence[Positions], radius_metres: float) -> list[Mask]:
    """Tell of every image of each traverse whether its position is none.

    That is so where nothing is given, where one number stands twice (0, 0 or -1, -1) and no other position is near, and
    where a fix stood still: a position that holds for `_STANDING` times as many images as usual, and then leaps at
    least half as far as that many usual steps lead.
    """
    nothing: list[Mask] = [np.isnan(each.given[:, 0] + each.given[:, 1]) for each in traverses]
    twice = [each.given[:, 0] == each.given[:, 1] for each in traverses]
    others = np.concatenate([
        each.metres[~(none | same)] for each, none, same in zip(traverses, nothing, twice, strict=True)
    ])  # fmt: skip
    if len(others) and any(map(np.any, twice)):
        tree = KDTree(others)
        for each, none, same in zip(traverses, nothing, twice, strict=True):
            none[same] = tree.query(each.metres[same])[0] > _APART_RADII * radius_metres
    lacking: list[Mask] = list(map(np.logical_or, nothing, map(_find_stale, traverses)))
    return lacking


def _find_stale(positions: Positions) -> Mask:
    """Tell of every image whether its position is that of an earlier image, which the camera has left since."""
    moves = (np.diff(positions.given, axis=0) != 0).any(axis=1) | (np.diff(positions.files.numbers) != 0)
    ends = np.flatnonzero(moves)
    first, last = np.append(0, ends + 1), np.append(ends, len(positions.given) - 1)  # of each run at one position
    steps = np.linalg.norm(positions.metres[first[1:]] - positions.metres[last[:-1]], axis=1)
    steps[positions.files.numbers[first[1:]] != positions.files.numbers[last[:-1]]] = np.nan  # another drive
    fixes = (last - first + 1)[:-1] / np.median(last - first + 1)
    usual = np.median(steps[np.isfinite(steps)]) if np.isfinite(steps).any() else np.nan
    stale = np.full(len(positions.given), False)
    for run in np.flatnonzero((fixes >= _STANDING) & (steps >= fixes * usual / 2)):
        stale[first[run] + 1 : last[run] + 1] = True
    return stale


def _describe_lacking(traverses: Sequence[Positions], lacking: Sequence[Mask]) -> str:
    """Return how many images have no position, with the first of them; empty if all have one."""
    each, lacks = next(((e, lacks) for e, lacks in zip(traverses, lacking, strict=True) if lacks.any()), (None, None))
    if each is None or lacks is None:
        return ""
    first = int(lacks.argmax())
    given = each.given[first]
    why = "far from all others" if given[0] == given[1] else "where its fix stands still"
    at = "" if np.isnan(given).any() else f" at {_pair(given)}, {why}"
    total, n = sum(int(lacks.sum()) for lacks in lacking), sum(map(len, lacking))
    return f"{total} of {n} images have no position (first: {each.files[first]}{at})"


def _check_radius(radius_metres: float) -> None:
    if not 0 < radius_metres <= MOST_METRES:
        raise BadInput(f"dataset.radius_metres={radius_metres:g}: give more than 0 metres, at most {MOST_METRES:g}")


def _check_coordinates(traverses: Sequence[Positions], radius_metres: float) -> None:
    """Raise BadInput for degrees where metres are wanted, for coarse degrees, and where all lies within the radius."""
    given = np.concatenate([each.given for each in traverses])
    metres = np.concatenate([each.metres for each in traverses])
    own = given[:, 0] != given[:, 1]  # 0, 0 beside degrees is no place
    if own.any():
        given, metres = given[own], metres[own]
    in_degrees = traverses[0].in_degrees
    found = (
        f"the positions of {traverses[0].files[0]} and {sum(len(each.given) for each in traverses) - 1} more images "
        f"run from {_pair(given.min(axis=0))} to {_pair(given.max(axis=0))}"
    )
    if not in_degrees and _look_like_degrees(given):
        raise BadInput(f"{found}, which look like degrees: give {_OR_DEGREES}")
    if len(given) < _LEAST:
        return
    for decimals, step in enumerate(_COARSE_METRES):
        if in_degrees and step > radius_metres and np.array_equal(given, given.round(decimals)):
            raise BadInput(
                f"{found} in steps of {step} m, and dataset.radius_metres={radius_metres:g}: give degrees with 5 "
                f"decimals, not {decimals}"
            )
    extent = float(np.linalg.norm(np.ptp(metres, axis=0)))
    if extent <= radius_metres:
        raise BadInput(
            f"{found}, all within dataset.radius_metres={radius_metres:g}, so that every place is right for every "
            f"query: give {'degrees with all decimals' if in_degrees else _OR_DEGREES}"
            f"{f', or a radius below {extent:.3g}' if extent else ''}"
        )


def _look_like_degrees(given: npt.NDArray[np.float64]) -> bool:
    """Tell whether numbers are within 180, and half of the different ones have another less than `_NEAR` away."""
    if len(given) < 2 or np.abs(given).max() > 180:
        return False
    different = np.unique(given, axis=0)
    return len(different) > 1 and bool(np.median(KDTree(different).query(different, 2)[0][:, 1]) < _NEAR)


def _pair(numbers: npt.NDArray[np.float64]) -> str:
    return ", ".join(f"{number:.10g}" for number in numbers)
