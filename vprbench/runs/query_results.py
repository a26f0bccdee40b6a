"""Judged answers of a run, one for each query, as the page and `Result` show them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from vprbench.metrics.accuracy import count_hits
from vprbench.metrics.ranking import Counts
from vprbench.runs.record import Run

SHOWN = 3  # best places of a query
SHOWN_UNJUDGED = 5  # the same without a ground truth
FIRST_PAGE = 10  # queries that a page opens with
NOWHERE = -1  # in the place of a place
RIGHT, WRONG, TIED, UNANSWERABLE, UNJUDGED = "rwtun"
EXACT, AT_MOST, AT_LEAST, UNDEFINED = "=<>?"


@dataclass(frozen=True)
class Answers:
    """The answers of a run, judged.

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


def judge_answers(run: Run) -> Answers:
    """Judge the answers of a run by its ground truth."""
    outcome, n_shown = run.outcome, SHOWN if run.is_judged else SHOWN_UNJUDGED
    places, scores = _find_best_places(run, n_shown)
    right_places, right_scores, margins, bounds = map(
        np.array, zip(*(_find_margin(run, query) for query in range(len(outcome))), strict=True)
    )
    verdicts = np.where(count_hits(outcome, 1, "optimistic") > 0, TIED, WRONG)
    verdicts[count_hits(outcome, 1, "pessimistic") > 0] = RIGHT
    verdicts[~outcome.answerable] = UNANSWERABLE
    if not run.is_judged:
        verdicts[:], margins = UNJUDGED, scores[:, 0] - scores[:, 1]
        bounds = np.where(np.isnan(margins), UNDEFINED, EXACT)
    return Answers(
        verdicts="".join(verdicts),
        places=places,
        scores=scores,
        right_places=right_places,
        right_scores=right_scores,
        ranks=np.where(outcome.tied > 0, outcome.above + 1, 0),
        equals=outcome.tied - outcome.tied_correct,
        margins=margins,
        bounds="".join(bounds),
    )


def _find_margin(run: Run, query: int) -> tuple[int, float, float, str]:
    """Return the best right place of a query, its score, the margin and its bound, as `Answers` has them.

    They come from all scores if the run keeps them, or else from those of the best places: all others score no more.
    """
    outcome, positives = run.outcome, run.positives[query]
    if not len(positives):
        return NOWHERE, np.nan, np.nan, UNDEFINED
    places, scores = run.top_places[query], run.top_scores[query]
    if run.scores is not None:
        places, scores = np.arange(outcome.n_places), run.scores[query]
    is_right, lowest = np.isin(places, positives), float(scores[-1])
    right, wrong = (float(scores[side].max(initial=-np.inf)) for side in (is_right, ~is_right))
    best = places[is_right & (scores == right)]
    place, bound = int(best[0] if len(best) else positives[len(positives) // 2]), EXACT
    if not outcome.top_tied[query]:
        return place, np.nan, np.nan, UNDEFINED
    if right == -np.inf and outcome.tied[query]:
        right, bound = lowest, AT_MOST
    elif wrong == -np.inf and len(scores) < outcome.n_places and lowest > -np.inf:
        wrong, bound = lowest, AT_LEAST
    return place, right if np.isfinite(right) else np.nan, right - wrong, bound


def _find_best_places(run: Run, n: int) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float64]]:
    """Return the `n` best places and their scores, (n_queries, n) each, of equals the wrong ones first."""
    right = np.array([np.isin(*row) for row in zip(run.top_places, run.positives, strict=True)])
    order = np.lexsort((right, -run.top_scores), axis=1)[:, :n]
    places = np.full((len(order), n), NOWHERE)
    scores = np.full((len(order), n), np.nan)
    places[:, : order.shape[1]] = np.take_along_axis(run.top_places, order, axis=1)
    scores[:, : order.shape[1]] = np.take_along_axis(run.top_scores, order, axis=1)
    places[scores == -np.inf] = NOWHERE
    scores[scores == -np.inf] = np.nan
    return places, scores


def order_by_interest(answers: Answers) -> Iterator[tuple[int, set[int]]]:
    """Yield the queries of a run with the places shown beside each: those that a page opens with, then wrong answers.

    A page opens with the wrong answers of the lowest margins, without a ground truth with the lowest margins of all.
    Otherwise queries come in an order that is the same for all runs, from all over the journey.
    """
    wrong = np.isin([*answers.verdicts], (WRONG, TIED, UNJUDGED))
    by_margin = np.argsort(np.where(wrong, answers.margins, np.nan), kind="stable")  # NaN comes last
    first = [query for query in by_margin[:FIRST_PAGE].tolist() if wrong[query]]
    order = np.random.default_rng(0).permutation(len(answers.verdicts)).tolist()
    order.sort(key=lambda query: answers.verdicts[query] == RIGHT)
    for query in dict.fromkeys([*first, *order]):
        yield query, {*answers.places[query].tolist(), int(answers.right_places[query])} - {NOWHERE}
