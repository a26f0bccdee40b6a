"""Scores of sequences: what neighbouring queries say together, in sums along a journey or by a filter over places."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from vprbench.api.arrays import Scores

Stretches = npt.NDArray[np.int64]  # per query or place the number of its unbroken part of the journey, ascending
Doubles = npt.NDArray[np.float64]
Gaps = Literal["break", "bridge"]  # of the journey: nothing reaches beyond one, or as if there were none

_BLOCK_CELLS = 1 << 19  # scores summed together: stays near the processor's cache
_FLAT = 1e-10  # of a query's variance; the rounding of less is no contrast


@dataclass(frozen=True)
class Sequences:
    """How the scores of neighbouring queries become one score; raises ValueError for what cannot be.

    The identity in sums of 2, 4, 6 or 10 queries is QVPR's (VPRSNN `ens_seq`, LENS), velocities and contrast are those
    of SeqSLAM (Milford and Wyeth 2012; its code searches 0.8 to 1.2 and normalises over 10 places).
    """

    length: int
    window: Literal["causal", "centred", "lens"] = "causal"  # it ends with the query, has it in the middle, or as LENS
    velocities: tuple[float, ...] = (1.0,)  # places a query, as multiples of the usual step; the best one counts
    contrast: int = 0  # neighbouring places that scores are normalised over; 0: none
    incomplete: Literal["left_out", "shortened"] = "left_out"  # queries without a full window: with what there is
    gaps: Gaps = "break"  # where frames of the journey are missing

    def __post_init__(self) -> None:
        """Check what no type tells."""
        if self.length < 1:
            raise ValueError(f"length={self.length}: give 1 or more queries")
        if not self.velocities or not all(0 < v < math.inf for v in self.velocities):
            raise ValueError(f"velocities={list(self.velocities)}: give multiples above 0, as in [0.8,1,1.2]")
        if self.contrast < 0 or self.contrast == 1:
            raise ValueError(f"contrast={self.contrast}: give 2 or more neighbouring places, or 0 for none")
        others = (self.velocities, self.contrast, self.incomplete, self.gaps)
        if self.window == "lens" and others != ((1.0,), 0, "left_out", "break"):
            raise ValueError("window=lens is a whole protocol, which has no other option: give the length alone")

    @property
    def steps(self) -> range:
        """The queries of a window, counted from the query: (-3, -2, -1, 0) of 4; centred (-2, -1, 0, 1); lens -1..2."""
        after = {"causal": 1, "centred": (self.length + 1) // 2, "lens": self.length // 2 + 1}[self.window]
        return range(after - self.length, after)


@dataclass(frozen=True)
class Filter:
    """A Bayes filter over the places: a hidden Markov model; raises ValueError for what cannot be.

    The topological filter of Xu, Sünderhauf and Milford (2021, Probabilistic visual place recognition for hierarchical
    localization; mingu6/ProbFiltersVPR, with moves of -2 to 10): from one query to the next every move from `back` to
    `ahead` places is equally likely. The likelihood of a place is exp(score * scale); `ratio` is by how much it grows
    over the middle 95 % of the first query's scores.
    """

    back: int = 0
    ahead: int = 2
    ratio: float = 5.0
    gaps: Gaps = "break"

    def __post_init__(self) -> None:
        """Check what no type tells."""
        if self.back > self.ahead:
            raise ValueError(f"back={self.back} is beyond ahead={self.ahead}: give moves in places, as in -2 and 10")
        if not 1 < self.ratio < math.inf:
            raise ValueError(f"ratio={self.ratio}: give more than 1")


def stretches(n: int, breaks: npt.ArrayLike | None) -> Stretches:
    """Return the number of the unbroken part that each of `n` frames is in; a break is the first frame of a part."""
    starts = np.zeros(n, np.int64)
    if breaks is not None:
        starts[np.asarray(breaks, np.int64)] = 1
    return np.cumsum(starts)


def sequence_scores(
    scores: Scores, options: Sequences, queries: Stretches, places: Stretches, step: float = 1.0
) -> tuple[Scores, npt.NDArray[np.int64]]:
    """Return the mean score over the window of each query and place, and how many queries each window has.

    The window of query q and place p at velocity v holds the scores (q + k, p + round(k v step)) of all steps k, and
    never goes beyond a part of the journey, be it the query's or the place's: `queries` (n_queries,) and `places`
    (n_places,) number these. A query uses those of its steps that it has; a place that lacks one of them is no
    candidate (-inf), nor is one with a -inf in its window. Of several velocities the highest mean counts. `step` is the
    places from one query to the next at velocity 1. Scores float32 (n_queries, n_places), counts (n_queries,).
    """
    n_queries, n_places = scores.shape
    found = np.empty((n_queries, n_places), np.float32)
    counts = np.zeros(n_queries, np.int64)
    for k in options.steps:
        counts += _find_reached(queries, np.arange(n_queries), k)
    moves = {tuple(math.floor(k * velocity * step + 0.5) for k in options.steps) for velocity in options.velocities}
    rows = max(1, _BLOCK_CELLS // n_places)
    for first in range(0, n_queries, rows):
        block = np.arange(first, min(first + rows, n_queries))
        sums = [
            _sum_windows(scores, dict(zip(options.steps, of_one, strict=True)), queries, places, block)
            for of_one in moves
        ]
        found[block] = np.maximum.reduce(sums) / counts[block, None]
    return found, counts


def _find_reached(stretch: Stretches, frames: npt.NDArray[np.int64], shift: int) -> npt.NDArray[np.bool_]:
    """Tell of which frames the one `shift` further on is there and in the same part of the journey."""
    there = frames + shift
    inside = (there >= 0) & (there < len(stretch))
    return np.asarray(inside & (stretch[np.where(inside, there, 0)] == stretch[frames]))


def _sum_windows(
    scores: Scores,
    moves: Mapping[int, int],
    queries: Stretches,
    places: Stretches,
    block: npt.NDArray[np.int64],
) -> Doubles:
    """Return the sums over the windows of a block of queries, (n_block, n_places).

    `moves` says for each step, in queries, how many places it goes.
    """
    n_places, start = scores.shape[1], max(0, int(block[0]) + min(moves))
    around = scores[start : int(block[-1]) + max(moves) + 1].astype(np.float64)
    sums = np.zeros((len(block), n_places))
    for step, move in moves.items():
        reached = _find_reached(queries, block, step)
        rows = np.flatnonzero(reached)
        left, right = max(0, -move), min(n_places, n_places - move)
        if len(rows) and left < right:
            within = slice(rows[0], rows[-1] + 1)
            theirs = slice(block[0] + rows[0] + step - start, block[0] + rows[-1] + 1 + step - start)
            part, more = sums[within, left:right], around[theirs, left + move : right + move]
            np.add(part, more, out=part, where=True if len(rows) == len(part) else reached[within, None])
        lacking = np.flatnonzero(~_find_reached(places, np.arange(n_places), move))
        sums[np.ix_(rows, lacking)] = -np.inf
    return sums


def local_contrast(scores: Scores, width: int, places: Stretches) -> Scores:
    """Return scores (n_queries, n_places) less the mean over neighbouring places, over their standard deviation.

    SeqSLAM's local contrast enhancement, as OpenSeqSLAM has it: `width` // 2 places to either side and the place
    itself, cut at the ends, and here where the journey is broken; the sample deviation (n - 1). Where the neighbours
    are all alike it is 0; a place that is no candidate (-inf) is no neighbour either.
    """
    n_queries, n_places = scores.shape
    numbers, half = np.arange(n_places), width // 2
    low = np.maximum(np.searchsorted(places, places, side="left"), numbers - half)
    high = np.minimum(np.searchsorted(places, places, side="right"), numbers + half + 1)
    found = np.empty((n_queries, n_places), np.float32)
    rows = max(1, _BLOCK_CELLS // n_places)
    for first in range(0, n_queries, rows):
        block = scores[first : first + rows].astype(np.float64)
        known = block > -np.inf
        n_known = np.maximum(known.sum(axis=1, keepdims=True), 1)
        block -= np.where(known, block, 0).sum(axis=1, keepdims=True) / n_known
        values = np.where(known, block, 0)
        count, total, squares = (_sum_ranges(each, low, high) for each in (known.astype(np.float64), values, values**2))
        count = np.maximum(count, 1)
        variance = (squares - total**2 / count) / np.maximum(count - 1, 1)
        flat = variance <= _FLAT * (values**2).sum(axis=1, keepdims=True) / n_known
        contrast = np.where(flat, 0, (values - total / count) / np.sqrt(np.where(flat, 1, variance)))
        found[first : first + rows] = np.where(known, contrast, -np.inf)
    return found


def _sum_ranges(values: Doubles, low: npt.NDArray[np.int64], high: npt.NDArray[np.int64]) -> Doubles:
    """Return the sums of each row from place `low` to the place before `high`, (n_rows, n_places)."""
    sums = np.zeros((values.shape[0], values.shape[1] + 1))
    np.cumsum(values, axis=1, out=sums[:, 1:])
    return np.asarray(sums[:, high] - sums[:, low])


def filter_scores(scores: Scores, options: Filter, queries: Stretches) -> Scores:
    """Return the logarithm of the belief in each place after each query, (n_queries, n_places).

    Nothing of later queries is used. The belief starts anew, equal for all places, with each part of the journey, of
    which `queries` (n_queries,) are the numbers, and where no place is possible any more. A place whose score is
    -inf, or that cannot be reached, is no candidate (-inf).
    """
    found = np.empty(scores.shape, np.float32)
    scale, belief = 0.0, np.empty(0)
    for query, row in enumerate(scores):
        known = row > -np.inf
        values = row[known].astype(np.float64)
        if scale == 0 and len(values):
            low, high = np.quantile(values, [0.025, 0.975])
            scale = math.log(options.ratio) / float(high - low) if high > low else 0.0
        likelihood = np.zeros(len(row))
        likelihood[known] = np.exp(scale * (values - values.max(initial=-np.inf)))
        joined = query > 0 and queries[query] == queries[query - 1]
        moved = _move_belief(belief, options.back, options.ahead) * likelihood if joined else likelihood
        belief = moved if moved.any() else likelihood
        belief = belief / max(float(belief.sum()), np.finfo(np.float64).tiny)
        with np.errstate(divide="ignore"):
            found[query] = np.log(belief)
    return found


def _move_belief(belief: Doubles, back: int, ahead: int) -> Doubles:
    """Return the belief after a move of `back` to `ahead` places, all equally likely; what leaves the map is lost."""
    n = len(belief)
    found = np.zeros(n)
    for move in range(max(back, -n), min(ahead, n) + 1):
        found[max(move, 0) : n + min(move, 0)] += belief[max(-move, 0) : n - max(move, 0)]
    return found
