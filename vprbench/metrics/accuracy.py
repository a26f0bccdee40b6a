"""Accuracy of place recognition: recall at N and the three precision-recall curves, as pure functions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from vprbench.api.arrays import Scores
from vprbench.errors import BadInput
from vprbench.metrics.ranking import Counts, Outcome, PlacesPerQuery, find_right_cells, require_scores

Values = npt.NDArray[np.float64]
Ties = Literal["expected", "pessimistic", "optimistic"]


@dataclass(frozen=True)
class Recall:
    """Recall at N, 0 to 1, under the three ways to break ties."""

    expected: float  # ties broken at random
    pessimistic: float  # right places last
    optimistic: float  # right places first
    n_queries: int  # the denominator

    @property
    def hangs_on_ties(self) -> bool:
        """Whether the way to break ties moves the recall by more than half a point."""
        queries = round((self.optimistic - self.pessimistic) * self.n_queries)  # whole, so free of rounding
        return 200 * queries > self.n_queries


def compute_recall(outcome: Outcome, n: int, denominator: Literal["all", "answerable"] = "all") -> Recall | None:
    """Return the share of queries with a right place among the best `n`; None if none has a right place.

    The field uses two denominators: all queries (VPR-methods-evaluation, VPR-Bench and others) and the
    answerable ones (VPR_Tutorial, VPRTempo). More than there are places is as good as all of them. Raises
    BadInput below 1.
    """
    n_answerable = int(np.count_nonzero(outcome.answerable))
    n_queries = len(outcome) if denominator == "all" else n_answerable
    if not n_answerable:
        return None
    ways: tuple[Ties, ...] = ("expected", "pessimistic", "optimistic")
    expected, pessimistic, optimistic = (float(count_hits(outcome, n, ties).sum()) / n_queries for ties in ways)
    return Recall(expected, pessimistic, optimistic, n_queries)


def count_hits(outcome: Outcome, n: int, ties: Ties = "expected") -> Values:
    """Return per query, (n_queries,), the chance that a right place is among its best `n`.

    With a places above the best right one, t tied with it and g of those right, r = n - a slots are left for
    the tie, and a random order puts a right one there with 1 - C(t - g, r) / C(t, r). The pessimistic and the
    optimistic order give 0 or 1. Raises BadInput for `n` below 1.
    """
    if n < 1:
        raise BadInput(f"recall at {n} is not defined: ask for the best 1 or more places")
    slots = min(n, outcome.n_places) - outcome.above
    wrong = outcome.tied - outcome.tied_correct
    if ties == "optimistic":
        return (slots > 0).astype(np.float64)
    if ties == "pessimistic":
        return (slots > wrong).astype(np.float64)
    hits = (slots >= outcome.tied).astype(np.float64) * (slots > 0)
    cut = (slots > 0) & (slots < outcome.tied)
    hits[cut] = 1 - _compute_chance_of_only_wrong(outcome.tied[cut], outcome.tied_correct[cut], slots[cut])
    return hits


def _compute_chance_of_only_wrong(tied: Counts, correct: Counts, slots: Counts) -> Values:
    """Return C(tied - correct, slots) / C(tied, slots) as a product of few factors.

    The ratio is the same with `correct` and `slots` exchanged, so the smaller one is the number of factors.
    If there are too few wrong places a factor is 0.
    """
    fewer, more = np.minimum(correct, slots), np.maximum(correct, slots)
    chance = np.ones(len(tied))
    for drawn in range(int(fewer.max(initial=0))):
        going = drawn < fewer
        chance[going] *= (tied - more - drawn)[going] / (tied - drawn)[going]
    return chance


@dataclass(frozen=True)
class PRCurve:
    """Precision and recall, each (n_points,) and 0 to 1, from the highest threshold to the lowest.

    Each point keeps all that scores at least its threshold, so tied scores enter together. The first point is
    the convention recall 0, precision 1, threshold +inf.
    """

    precision: Values
    recall: Values
    threshold: Values


def compute_pr_curve(outcome: Outcome, kind: Literal["A", "B"]) -> PRCurve | None:
    """Return the curve of the best match of each query; None if its recall has no denominator.

    A match counts as retrieved where its score reaches the threshold. A wrong one is a false positive, also
    that of a query without a right place: a good method would have kept silent. A query without any candidate
    retrieves nothing. If several places share the highest score, the match counts as right by the share of
    right ones among them, which is its chance under random tie-breaking. What is retrieved does not depend on
    ties, so precision and A's recall are exact expected values; B's recall is a ratio of two expected values.

    Recall divides by the answerable queries (A: VPR_Tutorial, VPRTempo's paper) or by the correct best
    matches (B: VPR-Bench, VPRTempo since 7d9ccef). Hence recall_A = R@1 recall_B, R@1 over the answerable
    queries.
    """
    best, right = _find_best_matches(outcome)
    groups = _group_scores(best, best, right)
    total = np.count_nonzero(outcome.answerable) if kind == "A" else groups[2].max(initial=0)
    return _make_curve(groups, float(total)) if total else None


def pr_curve_multi(scores: Scores, positives: PlacesPerQuery) -> PRCurve | None:
    """Return curve C, over all pairs of a query and a place (VPR_Tutorial, multi); None without a right pair.

    The arguments are those of `ranking.outcome`, and so is what is raised. Pairs that are no candidates are never
    retrieved. Needs about 50 bytes of memory per pair.
    """
    scores = require_scores(scores)
    right_cells = find_right_cells(scores.shape, positives)
    if not len(right_cells):
        return None
    pairs = scores.ravel()
    right_scores = pairs[right_cells]  # those of -inf lie below every threshold
    groups = _group_scores(pairs[pairs > -np.inf], right_scores, np.ones(len(right_scores)))
    return _make_curve(groups, float(len(right_scores)))


def _find_best_matches(outcome: Outcome) -> tuple[npt.NDArray[np.float32], Values]:
    """Return the score of each best match and its chance to be right, where something is retrieved."""
    retrieved = outcome.top_tied > 0
    return outcome.best_score[retrieved], outcome.top_tied_correct[retrieved] / outcome.top_tied[retrieved]


def _group_scores(
    scores: npt.NDArray[np.float32], right_scores: npt.NDArray[np.float32], chances: Values
) -> tuple[npt.NDArray[np.float32], Counts, Values]:
    """Return the distinct scores in falling order, how many reach each, and how many right ones.

    `chances` weighs each of the right scores. Only these are sorted with their indices, which takes long.
    """
    falling = np.sort(scores)[::-1]
    last = np.flatnonzero(falling != np.append(falling[1:], np.float32(-np.inf)))  # ends of tied groups
    order = np.argsort(right_scores)
    n_below = np.searchsorted(right_scores[order], falling[last])
    best_first = np.concatenate([[0.0], np.cumsum(chances[order][::-1])])
    return falling[last], last + 1, best_first[len(order) - n_below]


def _make_curve(groups: tuple[npt.NDArray[np.float32], Counts, Values], total: float) -> PRCurve:
    threshold, kept, correct = groups
    return PRCurve(
        precision=np.concatenate([[1.0], correct / kept]),
        recall=np.concatenate([[0.0], correct / total]),
        threshold=np.concatenate([[np.inf], threshold]),
    )


def average_precision(curve: PRCurve) -> float:
    """Return the area under the curve as the step sum of (R_i - R_(i-1)) P_i: the primary area."""
    return float(np.sum(np.diff(curve.recall) * curve.precision[1:]))


def auc(curve: PRCurve) -> float:
    """Return the area under the curve by trapezoids, kept to compare with VPR-Bench and VPR_Tutorial."""
    return float(np.trapezoid(curve.precision, curve.recall))


def recall_at_full_precision(outcome: Outcome) -> float | None:
    """Return R@100P, the share of the answerable queries answered before the first error; None if none is answerable.

    Answers come in order of falling score. Those that tie with an error do not count, and neither does a
    query whose best place ties with a wrong one.
    """
    n_answerable = int(np.count_nonzero(outcome.answerable))
    return _count_before_first_error(outcome) / n_answerable if n_answerable else None


def precision_at_full_recall(outcome: Outcome) -> float | None:
    """Return P@100R, the share of right answers where every query is answered that has a candidate (VPRSNN, VPRTempo).

    None if no query has a right place or none retrieves anything.
    """
    _, right = _find_best_matches(outcome)
    return float(right.mean()) if len(right) and outcome.answerable.any() else None


def extended_precision(outcome: Outcome) -> float | None:
    """Return EP = (P_R0 + R_P100) / 2; None if no query has a right place or none retrieves anything.

    P_R0 is the precision at the highest threshold and R_P100 the share of the correct best matches that score
    above the first error, 0 if P_R0 is below 1 (Ferrarini et al. 2020; VPR-Bench). Fragile: a single
    wrong, most confident query takes it from above 0.5 to 0.
    """
    best, right = _find_best_matches(outcome)
    if not len(best) or not outcome.answerable.any():
        return None
    precision_at_first = float(right[best == best.max()].mean())
    if precision_at_first < 1:
        return precision_at_first / 2
    return (1 + _count_before_first_error(outcome) / float(right.sum())) / 2


def _count_before_first_error(outcome: Outcome) -> int:
    best, right = _find_best_matches(outcome)
    return int(np.count_nonzero(best > best[right < 1].max(initial=-np.inf)))


def auc_roc(outcome: Outcome) -> float | None:
    """Return the chance that a correct best match scores above a wrong one, ties one half; None without both.

    A query whose best place is tied counts as correct and as wrong by the shares among the tied places.
    """
    best, right = _find_best_matches(outcome)
    _, kept, correct = _group_scores(best, best, right)
    if not len(kept) or not 0 < correct[-1] < kept[-1]:
        return None
    wrong = kept - correct
    area = np.trapezoid(np.append(0, correct), np.append(0, wrong))
    return float(area / (correct[-1] * wrong[-1]))


def f1_max(outcome: Outcome) -> float | None:
    """Return the highest harmonic mean of precision and recall on curve A; None if that is undefined."""
    curve = compute_pr_curve(outcome, "A")
    if curve is None:
        return None
    both = curve.precision + curve.recall
    return float(np.max(2 * curve.precision * curve.recall / np.where(both > 0, both, 1)))


_FAR = np.iinfo(np.int64).max  # of a query without a right place


def count_hits_within(
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
    (n_places,), without these along the map.
    """
    best = top_scores[:, :1]
    tied = (top_scores == best) & (best > -np.inf)
    rows, columns = np.nonzero(tied)
    places = top_places[rows, columns].astype(np.int64)
    if place_numbers is not None:
        places, positives = place_numbers[places], [place_numbers[right] for right in positives]
    distances = _measure_distances(rows, places, positives)
    n_tied = np.maximum(tied.sum(axis=1), 1)
    return np.stack([np.bincount(rows[distances <= k], minlength=len(tied)) / n_tied for k in tolerances])


def _measure_distances(
    queries: npt.NDArray[np.int64], places: npt.NDArray[np.int64], positives: PlacesPerQuery
) -> npt.NDArray[np.int64]:
    """Return how many places each of `places` lies from the nearest right place of its query."""
    distances = np.full(len(places), _FAR)
    ends = np.searchsorted(queries, np.arange(len(positives) + 1))  # queries ascend
    for right, start, end in zip(positives, ends[:-1], ends[1:], strict=True):
        if len(right) and end > start:
            distances[start:end] = np.abs(places[start:end, None] - right).min(axis=1)
    return distances
