"""Ground truth by position: which references lie within a radius of each query, and positions that are none."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from vprbench.api import BadInput, Paths

from .drives import find_jumps
from .file_dataset import GroundTruth, make_ground_truth

Metres = npt.NDArray[np.float64]  # (n, 2) east and north, or (n, 3)
Mask = npt.NDArray[np.bool_]  # (n,), of images
WithoutPosition = Literal["error", "keep", "drop"]  # of images without a position: keep takes the position as given

MOST_METRES = 1e8  # the way round the Earth is 4e7; of much larger numbers centimetres are lost, and squares overflow
_APART_METRES = 1e9  # between two grids
_EQUATOR_METRES = 6378137.0  # WGS 84
_FLATTENING = 1 / 298.257223563
_ROUNDING_METRES = 1e-7  # of coordinates of some million metres: decides about nothing but the edge of the radius
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

    @property
    def metres(self) -> Metres:
        """The positions in metres."""
        if self.grids is not None:
            return np.column_stack([self.given, self.grids * _APART_METRES])
        return convert_degrees(*self.given.T) if self.in_degrees else self.given


def require_metres(named: str, array: npt.ArrayLike, n_images: int) -> Metres:
    """Return east and north of an array, (n, 2) or (2, n) of two images or more; raises BadInput for any other."""
    metres = np.asarray(array)
    if metres.shape == (2,) and n_images == 1:
        metres = metres[None]
    elif metres.shape == (2, n_images) and n_images != 2:
        metres = metres.T
    if metres.shape != (n_images, 2) or metres.dtype.kind not in "fiu":
        raise BadInput(f"{named} has the shape {metres.shape}; wanted are metres, 2 for each of {n_images} images")
    return metres.astype(np.float64)


def convert_degrees(latitude: npt.NDArray[np.float64], longitude: npt.NDArray[np.float64]) -> Metres:
    """Return points of the WGS 84 ellipsoid, given in degrees, in metres from the centre of the Earth, (n, 3).

    The straight line between two points is shorter than the way on the ground by about its share d^2 / 24 R^2, at
    10 km 0.1 mm in a kilometre. There are no zones and no seam.
    """
    phi, lambda_ = np.radians(latitude), np.radians(longitude)
    eccentricity_squared = _FLATTENING * (2 - _FLATTENING)
    across = _EQUATOR_METRES / np.sqrt(1 - eccentricity_squared * np.sin(phi) ** 2)
    x, y = across * np.cos(phi) * np.cos(lambda_), across * np.cos(phi) * np.sin(lambda_)
    return np.stack([x, y, across * (1 - eccentricity_squared) * np.sin(phi)], axis=1)


def match_metres(references: Metres, queries: Metres, radius_metres: float) -> GroundTruth:
    """Return every reference as a place of its own; right is what lies within the radius, the radius included.

    Raises BadInput for a radius that is not above 0, or that spans more than the Earth.
    """
    _check_radius(radius_metres)
    near = KDTree(references).query_ball_point(queries, radius_metres + _ROUNDING_METRES, return_sorted=True)
    truth = make_ground_truth(len(references), near, f"no reference within {radius_metres:g} m")
    return replace(truth, jumps=(find_jumps(references, radius_metres), find_jumps(queries, radius_metres)))


def match_positions(
    references: Sequence[Positions], queries: Positions, radius_metres: float, without: WithoutPosition = "error"
) -> GroundTruth:
    """Return the ground truth by the radius (`match_metres`) of traverses, in which some images may have no position.

    An image has no position where nothing is given, where one number stands twice (0, 0 or -1, -1) and no other
    position is near, and where a fix stood still. Such images are an error, are left out (`drop`), or count where they
    say (`keep`). Raises BadInput for them, for a bad radius, and for coordinates that are no metres.
    """
    _check_radius(radius_metres)
    traverses = [*references, queries]
    files = Paths.joined(each.files for each in traverses)
    given, metres = (np.concatenate(parts) for parts in zip(*((e.given, e.metres) for e in traverses), strict=True))
    is_query = np.arange(len(files)) >= len(files) - len(queries.files)
    wrong = ((np.abs(given) > MOST_METRES) | (np.isnan(given) & (without == "keep"))).any(axis=1)
    if wrong.any():
        raise BadInput(
            f"the position of {files[int(wrong.argmax())]} is {_format_pair(given[wrong.argmax()])}: wanted are metres "
            "from -1e8 to 1e8, or NaN with dataset.without_position=drop"
        )
    stale = np.concatenate([_find_stale(each) for each in traverses])
    lacking = stale | _find_lonely(given, metres, radius_metres)
    first = int(lacking.argmax())
    lack = f"{lacking.sum()} of {len(files)} images have no position (first: {files[first]} at "
    lack += f"{_format_pair(given[first])}{', where its fix stands still' if stale[first] else ''})"
    if without == "error" and lacking.any():
        raise BadInput(
            f"{lack}: correct them, or pass dataset.without_position=drop to leave them out, "
            "dataset.without_position=keep if they were taken there"
        )
    kept = ~lacking | (without != "drop")
    if not ((kept & is_query).any() and (kept & ~is_query).any()):
        raise BadInput(f"{lack}, and dataset.without_position=drop leaves none")
    _check_coordinates(files, given[kept], metres[kept], queries.in_degrees, radius_metres)
    counts = {
        "references_without_position": int((lacking & ~is_query).sum()),
        "queries_without_position": int((lacking & is_query).sum()),
    }
    note = f"{lack}; they {'are left out' if without == 'drop' else 'count where they say'}"
    return replace(
        match_metres(metres[kept & ~is_query], metres[kept & is_query], radius_metres),
        references=np.flatnonzero(kept[~is_query]) if without == "drop" else None,
        queries=np.flatnonzero(kept[is_query]) if without == "drop" else None,
        protocol={} if without == "error" else {"without_position": without, **counts},
        notes=[note] if lacking.any() else [],
    )


def _check_radius(radius_metres: float) -> None:
    if not 0 < radius_metres <= MOST_METRES:
        raise BadInput(f"dataset.radius_metres={radius_metres:g}: give more than 0 metres, at most {MOST_METRES:g}")


def _find_lonely(given: npt.NDArray[np.float64], metres: Metres, radius_metres: float) -> Mask:
    """Tell of every image whether its position is not given, or one number twice that is far from all others."""
    lonely: Mask = np.isnan(given[:, 0] + given[:, 1])
    twice = given[:, 0] == given[:, 1]
    others = metres[~lonely & ~twice]
    if len(others) and twice.any():
        lonely[twice] = KDTree(others).query(metres[twice])[0] > _APART_RADII * radius_metres
    return lonely


def _find_stale(positions: Positions) -> Mask:
    """Tell of every image whether its position is that of an earlier image, which the camera has left since.

    So it is where a position holds for `_STANDING` times as many images as usual, and then leaps at least half as far
    as that many usual steps lead.
    """
    folders, metres = positions.files.numbers, positions.metres
    ends = np.flatnonzero((np.diff(positions.given, axis=0) != 0).any(axis=1) | (np.diff(folders) != 0))
    first, last = np.append(0, ends + 1), np.append(ends, len(folders) - 1)  # of each run at one position
    steps = np.linalg.norm(metres[first[1:]] - metres[last[:-1]], axis=1)
    steps[folders[first[1:]] != folders[last[:-1]]] = np.nan  # another drive
    fixes = (last - first + 1)[:-1] / np.median(last - first + 1)
    usual = np.median(steps[np.isfinite(steps)]) if np.isfinite(steps).any() else np.nan
    runs = np.append((fixes >= _STANDING) & (steps >= fixes * usual / 2), False)
    stale: Mask = np.repeat(runs, last - first + 1)
    stale[first] = False
    return stale


def _check_coordinates(
    files: Paths, given: npt.NDArray[np.float64], metres: Metres, in_degrees: bool, radius_metres: float
) -> None:
    """Raise BadInput for degrees where metres are wanted, for coarse degrees, and where all lies within the radius."""
    own = given[:, 0] != given[:, 1]  # 0, 0 beside degrees is no place
    if own.any():
        given, metres = given[own], metres[own]
    found = f"the positions of {files[0]} and {len(files) - 1} more images run from "
    found += f"{_format_pair(given.min(axis=0))} to {_format_pair(given.max(axis=0))}"
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
            f"query: give a radius below {extent:.3g}, {'degrees with all decimals' if in_degrees else _OR_DEGREES}"
        )


def _look_like_degrees(given: npt.NDArray[np.float64]) -> bool:
    """Tell whether numbers are within 180, and half of the different ones have another less than `_NEAR` away."""
    if len(given) < 2 or np.abs(given).max() > 180:
        return False
    different = np.unique(given, axis=0)
    return len(different) > 1 and bool(np.median(KDTree(different).query(different, 2)[0][:, 1]) < _NEAR)


def _format_pair(numbers: npt.NDArray[np.float64]) -> str:
    return ", ".join(f"{number:.10g}" for number in numbers)
