"""What the report shows of each query: the best places of a run, judged by its ground truth."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from vprbench.metrics.accuracy import hits_at
from vprbench.metrics.ranking import Counts
from vprbench.runs.record import Run

SHOWN = 3  # best places of a query
SHOWN_UNJUDGED = 5  # the same without a ground truth
NOWHERE = -1  # in the place of a place
RIGHT, WRONG, TIED, UNANSWERABLE, UNJUDGED = "rwtun"
EXACT, AT_MOST, AT_LEAST, UNDEFINED = "=<>?"

_DIGITS = 5  # significant ones of a score on the page


@dataclass(frozen=True)
class Answers:
    """How a run answered each query.

    A margin is the score of the best right place less that of the best wrong place; infinite if the one or the
    other is no candidate, NaN if it is undefined: without a right place, or without any candidate. If a run
    keeps too few of its scores it is only known to be at most or at least so much.

    Without a ground truth every verdict is UNJUDGED, there are no right places, and a margin is the score of the best
    place less that of the second one.
    """

    verdicts: str  # a letter a query; RIGHT: the best place is right and tied with no wrong one
    places: npt.NDArray[np.int64]  # (n_queries, n_shown), best first, of equals the wrong ones first; NOWHERE: no more
    scores: npt.NDArray[np.float64]  # (n_queries, n_shown); NaN if the place is NOWHERE
    right_places: npt.NDArray[np.int64]  # (n_queries,), the best right place, the middle one if none is ranked
    right_scores: npt.NDArray[np.float64]  # (n_queries,); a bound if `bounds` is AT_MOST, NaN if there is none
    ranks: Counts  # (n_queries,), of the best right place, from 1; 0 if none is a candidate
    equals: Counts  # (n_queries,), wrong places with the score of the best right one
    margins: npt.NDArray[np.float64]  # (n_queries,)
    bounds: str  # a letter a query: whether the margin is EXACT, a bound or UNDEFINED


def judged(run: Run) -> Answers:
    """Judge the answers of a run."""
    if not run.is_judged:
        return _unjudged(run)
    outcome = run.outcome
    kinds = np.where(hits_at(outcome, 1, "optimistic") > 0, TIED, WRONG)
    kinds[hits_at(outcome, 1, "pessimistic") > 0] = RIGHT
    kinds[~outcome.answerable] = UNANSWERABLE
    bests = [_best_of_both_kinds(run, query) for query in range(len(outcome))]
    places, scores = _shown(run, SHOWN)
    return Answers(
        verdicts="".join(kinds),
        places=places,
        scores=scores,
        right_places=np.array([best.right_place for best in bests], np.int64),
        right_scores=np.array([_known(best.right) for best in bests]),
        ranks=np.where(outcome.tied > 0, outcome.above + 1, 0),
        equals=outcome.tied - outcome.tied_correct,
        margins=np.array([best.margin for best in bests]),
        bounds="".join(best.bound for best in bests),
    )


def _unjudged(run: Run) -> Answers:
    """Return the answers of a run without a ground truth."""
    places, scores = _shown(run, SHOWN_UNJUDGED)
    nothing, margins = np.full(len(places), np.nan), scores[:, 0] - scores[:, 1]
    return Answers(
        verdicts=UNJUDGED * len(places),
        places=places,
        scores=scores,
        right_places=np.full(len(places), NOWHERE),
        right_scores=nothing,
        ranks=np.zeros(len(places), np.int64),
        equals=np.zeros(len(places), np.int64),
        margins=margins,
        bounds="".join(np.where(np.isnan(margins), UNDEFINED, EXACT)),
    )


@dataclass(frozen=True)
class _Best:
    """The best right and the best wrong score of a query: -inf if there is none, bounds if not all is kept."""

    right_place: int
    right: float
    wrong: float
    bound: str

    @property
    def margin(self) -> float:
        return float("nan") if self.bound == UNDEFINED else self.right - self.wrong


def _best_of_both_kinds(run: Run, query: int) -> _Best:
    """Find the best right and the best wrong place, in all scores if they are kept, or else in the best ones."""
    outcome, positives = run.outcome, run.positives[query]
    if run.scores is not None:
        places, scores = np.arange(outcome.n_places), np.asarray(run.scores[query])
    else:
        places, scores = run.top_places[query], run.top_scores[query]
    is_right = np.isin(places, positives)
    top = float(outcome.best_score[query])
    right = top if outcome.above[query] == 0 else float(scores[is_right].max(initial=-np.inf))
    wrong = (
        top
        if outcome.top_tied_correct[query] < outcome.top_tied[query]
        else float(scores[~is_right].max(initial=-np.inf))
    )
    ranked = places[is_right & (scores == right)]
    place = int((ranked if len(ranked) else positives[len(positives) // 2 :])[0]) if len(positives) else NOWHERE
    if not len(positives) or not outcome.top_tied[query]:
        return _Best(place, -np.inf, wrong, UNDEFINED)
    lowest = float(scores[-1])  # where the best ones alone are kept, all others score no more
    if right == -np.inf and outcome.tied[query]:
        return _Best(place, lowest, wrong, AT_MOST)
    if wrong == -np.inf and len(scores) < outcome.n_places and lowest > -np.inf:
        return _Best(place, right, lowest, AT_LEAST)
    return _Best(place, right, wrong, EXACT)


def _shown(run: Run, n: int) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float64]]:
    """Return the `n` best places and their scores, (n_queries, n) each, of equals the wrong ones first."""
    right = np.array([np.isin(*row) for row in zip(run.top_places, run.positives, strict=True)])
    order = np.lexsort((right, -run.top_scores), axis=1)[:, :n]
    places = np.take_along_axis(run.top_places, order, axis=1).astype(np.int64)
    scores = np.take_along_axis(run.top_scores, order, axis=1).astype(np.float64)
    places[scores == -np.inf] = NOWHERE
    scores[scores == -np.inf] = np.nan
    missing = ((0, 0), (0, n - places.shape[1]))
    return np.pad(places, missing, constant_values=NOWHERE), np.pad(scores, missing, constant_values=np.nan)


def columns(answers: Answers) -> dict[str, Any]:
    """Return the answers of a run as plain values, numbers rounded, small enough for a page; None: there is none.

    An infinite margin is the text "-" or "+", for JSON has no such number.
    """
    infinite = {-np.inf: "-", np.inf: "+"}
    return {
        "verdicts": answers.verdicts,
        "places": answers.places.ravel().tolist(),
        "scores": rounded(answers.scores.ravel()),
        "right": answers.right_places.tolist(),
        "rightScores": rounded(answers.right_scores),
        "ranks": answers.ranks.tolist(),
        "equals": {int(query): int(answers.equals[query]) for query in np.flatnonzero(answers.equals)},
        "margins": [
            infinite.get(margin, short)
            for margin, short in zip(answers.margins.tolist(), rounded(answers.margins), strict=True)
        ],
        "bounds": answers.bounds,
    }


def rounded(values: npt.NDArray[np.float64]) -> list[float | None]:
    """Return values to five significant digits; None if one is not finite."""
    return [float(f"{value:.{_DIGITS}g}") if np.isfinite(value) else None for value in values.tolist()]


def place_ranges(places: npt.NDArray[np.int64]) -> str:
    """Return places as text, neighbours as a range.

    >>> place_ranges(np.array([7, 3, 4, 5]))
    '3-5, 7'
    """
    ordered = np.unique(places)
    parts = np.split(ordered, np.flatnonzero(np.diff(ordered) > 1) + 1) if len(ordered) else []
    return ", ".join(str(part[0]) if len(part) == 1 else f"{part[0]}-{part[-1]}" for part in parts)


def by_interest(answers: Answers) -> Iterator[tuple[int, set[int]]]:
    """Yield the queries of a run with the places shown beside each, those that are not answered right first.

    Otherwise they come in an order that is the same for all runs, from all over the journey.
    """
    order = np.random.default_rng(0).permutation(len(answers.verdicts)).tolist()
    for query in sorted(order, key=lambda query: answers.verdicts[query] == RIGHT):
        yield query, {*answers.places[query].tolist(), int(answers.right_places[query])} - {NOWHERE}


def places_shown(answers: Iterable[Answers]) -> list[int]:
    """Return every place whose frame the answers show, ascending."""
    shown = {place for one in answers for part in (one.places, one.right_places) for place in part.ravel().tolist()}
    return sorted(shown - {NOWHERE})


def _known(score: float) -> float:
    return score if np.isfinite(score) else float("nan")
