"""Recall at 1 of a stored run under a wider ground truth, from its best places alone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from vprbench.api.arrays import Scores
from vprbench.errors import BadInput
from vprbench.metrics.accuracy import Values
from vprbench.metrics.ranking import PlacesPerQuery

_FAR = np.iinfo(np.int64).max  # of a query without a right place


def hits_within(
    top_places: npt.NDArray[np.integer],
    top_scores: Scores,
    positives: PlacesPerQuery,
    tolerances: Sequence[int],
    place_numbers: npt.NDArray[np.int64] | None = None,
) -> Values:
    """Return the chance that the best place lies so many places from a right one, (n_tolerances, n_queries).

    Right under tolerance k is every place at most k from a place of the ground truth, inclusive; beyond the ends
    of the traverse there is none. `top_places` and `top_scores` (n_queries, depth) are the best places of each
    query, best first. If several share the highest score, the hit is the share of right ones among them, as
    in recall at 1; of more than `depth` such places only those that are stored count. A query without a right
    place or without any candidate is a miss. Places are counted along the journey by their `place_numbers`
    (n_places,), without these along the map. Raises BadInput for a tolerance below 0, ValueError for shapes that
    do not fit.
    """
    if top_places.shape != top_scores.shape or top_places.ndim != 2 or len(positives) != len(top_places):
        raise ValueError(
            f"best places {top_places.shape}, scores {top_scores.shape} and right places of {len(positives)} queries "
            "must be of the same queries and depth"
        )
    wrong = [k for k in tolerances if k < 0]
    if wrong:
        raise BadInput(f"a tolerance of {wrong[0]} places is not defined: give 0 or more")
    best = top_scores[:, :1]
    tied = (top_scores == best) & (best > -np.inf)
    rows, columns = np.nonzero(tied)
    places = top_places[rows, columns].astype(np.int64)
    if place_numbers is not None:
        places, positives = place_numbers[places], [place_numbers[right] for right in positives]
    distances = _distances(rows, places, positives)
    n_tied = np.maximum(tied.sum(axis=1), 1)
    return np.stack([np.bincount(rows[distances <= k], minlength=len(tied)) / n_tied for k in tolerances])


def _distances(
    queries: npt.NDArray[np.int64], places: npt.NDArray[np.int64], positives: PlacesPerQuery
) -> npt.NDArray[np.int64]:
    """Return how many places each of `places` lies from the nearest right place of its query."""
    distances = np.full(len(places), _FAR)
    ends = np.searchsorted(queries, np.arange(len(positives) + 1))  # queries ascend
    for right, start, end in zip(positives, ends[:-1], ends[1:], strict=True):
        if len(right) and end > start:
            distances[start:end] = np.abs(places[start:end, None] - right).min(axis=1)
    return distances
