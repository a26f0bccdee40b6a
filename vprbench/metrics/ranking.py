"""Outcomes: where the right places of each query rank, small enough to keep; single-match metrics need no more."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
import numpy.typing as npt

from vprbench.api.arrays import Scores
from vprbench.errors import BadInput
from vprbench.metrics.bounds import Places

PlacesPerQuery = Sequence[npt.NDArray[np.int64]]  # per query some places; empty if there are none
Counts = npt.NDArray[np.int64]  # (n_queries,)

_BLOCK_CELLS = 1 << 20  # scores compared at once: bounds the memory and stays near the processor's cache
_RANKED_CELLS = 1 << 22  # scores whose best are looked for together: bounds the memory


@dataclass(frozen=True)
class Outcome:
    """Where the right places of each query stand, ties counted instead of broken. Arrays are (n_queries,).

    A place that is no candidate (score -inf) is neither above nor tied. If no right
    place can be retrieved, because there is none or because all are no candidates, `above` is `n_places` and
    `tied` is 0.
    """

    best_score: npt.NDArray[np.float32]  # the highest score; -inf where no place is a candidate
    top_tied: Counts  # places that share the highest score; 0 if no place is a candidate
    top_tied_correct: Counts  # right places among those
    above: Counts  # places that score higher than the best right place
    tied: Counts  # places that score the same as the best right place, itself included
    tied_correct: Counts  # right places among those
    n_positives: Counts  # right places, whether candidates or not
    n_places: Places

    @property
    def answerable(self) -> npt.NDArray[np.bool_]:
        """Whether each query has a right place, (n_queries,)."""
        return self.n_positives > 0

    def __len__(self) -> int:
        """Return the number of queries."""
        return len(self.best_score)


def judge_scores(scores: Scores, positives: PlacesPerQuery) -> Outcome:
    """Rank the right places of each query by `scores` (n_queries, n_places), higher means more alike.

    `positives` holds per query the right places. A score of -inf marks a place that is no candidate. Real scores of
    another type are compared as float32. Works in blocks, so the memory beside `scores` is small. Raises BadInput for
    scores that are no real numbers, NaN or +inf and for places that do not exist, ValueError for shapes that do not
    fit.
    """
    scores = require_scores(scores)
    n_queries, n_places = scores.shape
    right = find_right_cells(scores.shape, positives)
    n_rows = max(1, _BLOCK_CELLS // n_places)
    blocks = []
    for first in range(0, max(n_queries, 1), n_rows):  # no query at all is one empty block
        block = scores[first : first + n_rows]
        start = first * n_places
        low, high = np.searchsorted(right, (start, start + block.size))
        blocks.append(_judge_block(block, right[low:high] - start))
    return concatenate(blocks)


def outcome_of_best(scores: Scores, places: npt.NDArray[np.int64], positives: PlacesPerQuery, n_places: int) -> Outcome:
    """Rank the right places of each query among its best places alone: all others count as no candidates.

    `places` (n_queries, n) holds each place once for a query, `scores` (n_queries, n) its scores; -inf: no candidate.
    """
    right = np.array([np.isin(*row) for row in zip(places, positives, strict=True)], bool).reshape(scores.shape)
    among = _judge_block(scores, np.flatnonzero(right))
    return replace(
        among,
        above=np.where(among.tied > 0, among.above, n_places),
        n_positives=np.array([len(np.unique(row)) for row in positives], np.int64),
        n_places=n_places,
    )


def concatenate(outcomes: Sequence[Outcome]) -> Outcome:
    """Join the outcomes of consecutive blocks of queries over one map; at least one."""
    columns = [field.name for field in fields(Outcome) if field.name != "n_places"]
    joined = {name: np.concatenate([getattr(part, name) for part in outcomes]) for name in columns}
    return Outcome(**joined, n_places=outcomes[0].n_places)


def choose_best_places(scores: Scores, depth: int) -> npt.NDArray[np.int64]:
    """Return the `depth` best places of each query in ascending order, (n_queries, depth); of equals the lower ones."""
    worst = np.partition(scores, -depth, axis=1)[:, -depth, None]
    chosen = scores >= worst
    cells = np.flatnonzero(chosen)
    if len(cells) > len(scores) * depth:  # some equal the worst: counting them takes longer than all the rest
        crowded = np.bincount(cells // scores.shape[1], minlength=len(scores)) > depth
        better, equal = scores[crowded] > worst[crowded], scores[crowded] == worst[crowded]
        room = depth - np.count_nonzero(better, axis=1, keepdims=True)
        chosen[crowded] = better | (equal & (np.cumsum(equal, axis=1) <= room))
        cells = np.flatnonzero(chosen)
    return np.asarray(cells.reshape(len(scores), depth) % scores.shape[1])


def rank_places(scores: Scores, depth: int) -> tuple[npt.NDArray[np.int32], Scores]:
    """Return the `depth` best places of each query, or all if they are fewer, best first, and their scores.

    Both are (n_queries, depth); of equals the lower places come first.
    """
    depth, rows = min(depth, scores.shape[1]), max(1, _RANKED_CELLS // scores.shape[1])
    parts = [choose_best_places(scores[first : first + rows], depth) for first in range(0, len(scores), rows)]
    best = np.concatenate(parts) if parts else np.empty((0, depth), np.int64)
    values = np.take_along_axis(scores, best, axis=1)
    order = np.argsort(-values, axis=1, kind="stable")
    return np.take_along_axis(best, order, axis=1).astype(np.int32), np.take_along_axis(values, order, axis=1)


def require_scores(scores: Scores, first_query: int = 0) -> Scores:
    """Return `scores` (n_queries, n_places) as float32; raises BadInput if one is no real number, NaN or +inf.

    `first_query` is the number of the first row in the whole traverse, for the message.
    """
    if np.ndim(scores) != 2 or np.shape(scores)[1] == 0:
        raise ValueError(f"scores must be (n_queries, n_places) with a place or more, not {np.shape(scores)}")
    scores = np.asarray(scores)
    if scores.dtype.kind not in "biuf":
        raise BadInput(
            f"the scores of query {first_query} and of those after it are of type {scores.dtype}: "
            "a method must give real numbers, best as float32"
        )
    with np.errstate(over="ignore"):  # what does not fit into float32 becomes infinite and is refused below
        scores = np.asarray(scores, dtype=np.float32)
    best = scores.max(axis=1)  # NaN wins every maximum
    for value, refused in (("NaN", np.isnan(best)), ("+inf", np.isposinf(best))):
        if refused.any():
            raise BadInput(
                f"the scores of {np.count_nonzero(refused)} of {len(best)} queries hold {value} "
                f"(the first is query {first_query + np.argmax(refused)}): a method must give finite scores, "
                "or -inf for a place that is no candidate"
            )
    return scores


def find_right_cells(shape: tuple[int, ...], positives: PlacesPerQuery) -> npt.NDArray[np.int64]:
    """Return the right cells of a score matrix of `shape`: positions in the flattened matrix, ascending, each once.

    Raises ValueError if the number of queries differs and BadInput if a place does not exist.
    """
    n_queries, n_places = shape
    if len(positives) != n_queries:
        raise ValueError(f"scores of {n_queries} queries came with positives of {len(positives)}: give one for each")
    columns = [np.asarray(row, dtype=np.int64) for row in positives]
    queries = np.repeat(np.arange(n_queries), [len(row) for row in columns])
    flat = np.concatenate([np.empty(0, np.int64), *columns])
    outside = (flat < 0) | (flat >= n_places)
    if outside.any():
        first = int(np.argmax(outside))
        raise BadInput(
            f"the positives of query {queries[first]} name place {flat[first]}, but places run from 0 to {n_places - 1}"
        )
    return np.unique(queries * n_places + flat)


def _judge_block(scores: Scores, right: npt.NDArray[np.int64]) -> Outcome:
    n_queries, n_places = scores.shape
    rows, columns = np.divmod(right, n_places)
    right_scores = scores[rows, columns]
    best = scores.max(axis=1)
    best_right = np.full(n_queries, -np.inf, np.float32)
    np.maximum.at(best_right, rows, right_scores)
    retrievable = best_right > -np.inf

    def right_at(score: npt.NDArray[np.float32]) -> Counts:
        there = (right_scores == score[rows]) & (right_scores > -np.inf)
        return np.bincount(rows[there], minlength=n_queries)

    return Outcome(
        best_score=best,
        top_tied=np.where(best > -np.inf, np.count_nonzero(scores == best[:, None], axis=1), 0),
        top_tied_correct=right_at(best),
        above=np.where(retrievable, np.count_nonzero(scores > best_right[:, None], axis=1), n_places),
        tied=np.where(retrievable, np.count_nonzero(scores == best_right[:, None], axis=1), 0),
        tied_correct=right_at(best_right),
        n_positives=np.bincount(rows, minlength=n_queries),
        n_places=n_places,
    )
