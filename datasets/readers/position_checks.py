"""Positions that are none, and coordinates that are no metres: found before any image is read."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from vprbench.api import BadInput

from .coordinates import Positions

Mask = npt.NDArray[np.bool_]  # (n,), of the images of a traverse

_APART_RADII = 10  # from a number that stands twice to all other positions
_STANDING = 10  # times as many images at one position as usual
_LEAST = 10  # images before their extent tells anything
_NEAR = 1e-3  # no camera takes frames a millimetre apart; a thousandth of a degree is 100 m
_COARSE_METRES = (111_000, 11_100, 1_110)  # a degree, a tenth and a hundredth of it
_OR_DEGREES = "metres of one grid (degrees belong into columns lat,lon of dataset=image_list)"


def without_position(traverses: Sequence[Positions], radius_metres: float) -> list[Mask]:
    """Tell of every image of each traverse whether what is said of its position is none.

    That is so where nothing is said, where one number stands twice (0, 0 or -1, -1) and no other position is near, and
    where a fix stood still: a position that holds for `_STANDING` times as many images as usual, and then leaps at
    least half as far as that many usual steps lead.
    """
    nothing: list[Mask] = [np.isnan(each.said[:, 0] + each.said[:, 1]) for each in traverses]
    twice = [each.said[:, 0] == each.said[:, 1] for each in traverses]
    others = np.concatenate([
        each.metres[~(none | same)] for each, none, same in zip(traverses, nothing, twice, strict=True)
    ])  # fmt: skip
    if len(others) and any(map(np.any, twice)):
        tree = KDTree(others)
        for each, none, same in zip(traverses, nothing, twice, strict=True):
            none[same] = tree.query(each.metres[same])[0] > _APART_RADII * radius_metres
    return [none | _stale(each) for none, each in zip(nothing, traverses, strict=True)]


def name_without_position(traverses: Sequence[Positions], lacking: Sequence[Mask]) -> str:
    """Return how many images have no position, with the first of them and what is said of it."""
    each, lacks = next((each, lacks) for each, lacks in zip(traverses, lacking, strict=True) if lacks.any())
    first = int(np.flatnonzero(lacks)[0])
    said = each.said[first]
    why = "far from all others" if said[0] == said[1] else "where its fix stands still"
    return (
        f"{sum(int(lacks.sum()) for lacks in lacking)} of {sum(map(len, lacking))} images have no position (first: "
        f"{each.files[first]}{'' if np.isnan(said).any() else f' at {_pair(said)}, {why}'})"
    )


def last_stand(positions: Positions) -> str:
    """Return a note on a traverse whose last images all have one position, else nothing."""
    first, last = _runs(positions)
    lengths = last - first + 1
    if len(lengths) == 1 or lengths[-1] < _STANDING * np.median(lengths):
        return ""
    return (
        f"the last {lengths[-1]} images up to {positions.files.names[-1]} have one position: if the camera went on, "
        "their fix was lost"
    )


def check_coordinates(traverses: Sequence[Positions], radius_metres: float) -> None:
    """Raise BadInput for degrees where metres are wanted, for coarse degrees, and where all lies within the radius."""
    said = np.concatenate([each.said for each in traverses])
    metres = np.concatenate([each.metres for each in traverses])
    own = said[:, 0] != said[:, 1]  # 0, 0 beside degrees is no place
    if own.any():
        said, metres = said[own], metres[own]
    in_degrees = traverses[0].in_degrees
    found = (
        f"the positions of {traverses[0].files[0]} and {sum(map(len, traverses)) - 1} more images run from "
        f"{_pair(said.min(axis=0))} to {_pair(said.max(axis=0))}"
    )
    if not in_degrees and _look_like_degrees(said):
        raise BadInput(f"{found}, which look like degrees: give {_OR_DEGREES}")
    if len(said) < _LEAST:
        return
    for decimals, step in enumerate(_COARSE_METRES):
        if in_degrees and step > radius_metres and np.array_equal(said, said.round(decimals)):
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


def _stale(positions: Positions) -> Mask:
    """Tell of every image whether its position is that of an earlier image, which the camera has left since."""
    first, last = _runs(positions)
    steps = np.linalg.norm(positions.metres[first[1:]] - positions.metres[last[:-1]], axis=1)
    steps[positions.files.numbers[first[1:]] != positions.files.numbers[last[:-1]]] = np.nan  # another drive
    fixes = (last - first + 1)[:-1] / np.median(last - first + 1)
    usual = np.median(steps[np.isfinite(steps)]) if np.isfinite(steps).any() else np.nan
    stale = np.full(len(positions.said), False)
    for run in np.flatnonzero((fixes >= _STANDING) & (steps >= fixes * usual / 2)):
        stale[first[run] + 1 : last[run] + 1] = True
    return stale


def _runs(positions: Positions) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Return the first and the last image of every run at one position in one folder, (n_runs,) each."""
    moves = (np.diff(positions.said, axis=0) != 0).any(axis=1) | (np.diff(positions.files.numbers) != 0)
    ends = np.flatnonzero(moves)
    return np.append(0, ends + 1), np.append(ends, len(positions.said) - 1)


def _look_like_degrees(said: npt.NDArray[np.float64]) -> bool:
    """Tell whether numbers are within 180, and half of the different ones have another less than `_NEAR` away."""
    if len(said) < 2 or np.abs(said).max() > 180:
        return False
    different = np.unique(said, axis=0)
    return len(different) > 1 and bool(np.median(KDTree(different).query(different, 2)[0][:, 1]) < _NEAR)


def _pair(numbers: npt.NDArray[np.float64]) -> str:
    return ", ".join(f"{number:.10g}" for number in numbers)
