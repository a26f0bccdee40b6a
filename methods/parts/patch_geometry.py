"""How well the patches of two images match: pairs that are nearest to one another, and whether their places agree."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Literal

import cv2
import numpy as np
import numpy.typing as npt

from ..netvlad import STRIDE

Geometry = Literal["homography", "displacement"]
Pairs = tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]  # patches of the query, and theirs of the reference

_RECEPTIVE_FIELD, _PADDING = 196, 90  # pixels of a local descriptor
_TOLERANCE = 1.5 * STRIDE  # pixels that an inlier of the homography may be off
_FEWEST_PAIRS: Mapping[Geometry, int] = MappingProxyType({"homography": 4, "displacement": 1})


def mutual(best_of_query: npt.NDArray[np.int64], best_of_reference: npt.NDArray[np.int64]) -> Pairs:
    """Return the pairs of patches that are nearest to one another, in the order of the reference's patches.

    The arguments are, for each patch of the reference, the nearest of the query, and the other way round.
    """
    patches = np.arange(len(best_of_query))
    kept = best_of_reference[best_of_query] == patches
    return best_of_query[kept], patches[kept]


def score(geometry: Geometry, grid: npt.NDArray[np.int64], side: int, pairs: Pairs) -> float:
    """Return how well pairs of patches fit together, 0 or more. `grid` is (n_patches, 2).

    Fewer than 4 pairs have no homography and score 0; of displacements one pair is enough.
    """
    query, reference = (grid[ends] for ends in pairs)
    if len(query) < _FEWEST_PAIRS[geometry]:
        return 0.0
    if geometry == "homography":
        return inliers(centres(query, side), centres(reference, side)) / len(grid)
    displacements = reference - query
    residuals = np.abs(displacements - displacements.mean(0))
    return float(((grid.max(0) - residuals) ** 2).sum() / len(grid))


def centres(cells: npt.NDArray[np.int64], side: int) -> npt.NDArray[np.float32]:
    """Return the middle of what patches see of the image, whole pixels, (n, 2), from their first columns and rows."""
    first = STRIDE * cells - _PADDING
    last = first + STRIDE * (side - 1) + _RECEPTIVE_FIELD - 1
    return np.trunc((first + last) / 2).astype(np.float32)


def inliers(query: npt.NDArray[np.float32], reference: npt.NDArray[np.float32]) -> int:
    """Return how many points (n, 2) of the reference one homography takes to within 24 pixels of the query's."""
    cv2.setRNGSeed(0)  # the answer must not depend on what was asked before
    _, fitting = cv2.findHomography(reference, query, cv2.RANSAC, _TOLERANCE)
    return 0 if fitting is None else int(np.count_nonzero(fitting))
