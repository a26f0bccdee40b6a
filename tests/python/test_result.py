"""A result by its numbers, worked by hand: `little.a_run`, whose right places stand 1st, 1st, 3rd and 8th."""

import math

import numpy as np
import pytest
from little import a_run, unanswerable_run

from vprbench.api import BadInput
from vprbench.metrics.catalogue import METRICS
from vprbench.python.result import Result

NAMES = ("a.png", "b.png", "c.png", "d.png")


def result(**changes):
    return Result(a_run(**changes), None, NAMES)


def test_recalls_rates_metrics_and_intervals_wider_for_more_confidence_and_of_differences_on_the_same_queries():
    shown = result()
    assert [shown.recall(n) for n in (1, 3, 8)] == [0.5, 0.75, 1.0]
    assert shown.hz == pytest.approx(80)
    assert list(shown.metrics) == list(METRICS)
    assert shown.metrics["recall_at_5"] == 0.75
    assert math.isnan(shown.metrics["ap_c"])  # the run keeps two of ten places
    usual, wider = shown.interval(), shown.interval(confidence=0.99)
    assert wider.low < usual.low < 0.5 < usual.high < wider.high
    nothing = Result(unanswerable_run(), None, NAMES)
    assert (math.isnan(nothing.recall(1)), nothing.interval()) == (True, None)
    with pytest.raises(BadInput):
        result().interval(result(fingerprint="e" * 64))
    assert result().interval(result()) is None  # four queries are too few


def test_best_places_curves_wider_tolerances_and_scores_are_arrays():
    """The best places of `a_run` are 0, 1, 9 and 7, its right ones 0, 1 and 5, 2, 3."""
    shown = result()
    assert shown.top(1).tolist() == [[0], [1], [9], [7]]
    assert [shown.recall(tolerance=k) for k in (0, 3, 4, 7)] == [0.5, 0.5, 0.75, 1.0]
    curve = shown.pr()
    assert (curve.precision[0], curve.recall[0], curve.recall[-1]) == (1.0, 0.0, 0.5)
    scored = result(scores=np.eye(4, 10, dtype=np.float32))
    assert (scored.similarity().shape, scored.similarity()[2].argmax()) == ((4, 10), 2)
    nothing = Result(unanswerable_run(), None, NAMES)
    refused = [(shown.top, 0), (shown.top, 3), (shown.recall, 3, 1), (shown.recall, 1, -1), (nothing.pr,)]
    refused += [(result(scores=None).similarity,)]
    for function, *arguments in refused:
        with pytest.raises(BadInput):
            function(*arguments)


def test_the_frame_has_a_row_a_query_and_failures_come_by_their_margin():
    run = a_run(scores=np.full((4, 10), 0.1, np.float32))
    for query, (right, wrong) in enumerate([(0.9, 0.1), (0.8, 0.2), (0.5, 0.7), (0.2, 0.6)]):
        run.scores[query, run.positives[query]] = right
        run.scores[query, 9] = wrong
    frame = Result(run, None, NAMES).to_frame()
    told = {"query": [*NAMES], "best_place": [0, 1, 9, 7], "right_places": [[0], [1, 5], [2], [3]]}
    told |= {"rank": [1, 1, 3, 8], "hit": [1, 1, 0, 0]}
    assert {name: frame[name].tolist() for name in told} == told
    np.testing.assert_allclose(frame["margin"][2:], [-0.2, -0.4], atol=1e-6)
    assert Result(run, None, NAMES).failures().index.tolist() == [3, 2]


def test_it_shows_itself_in_few_words_and_draws_and_sequences_and_filters_are_results_of_the_queries_they_keep():
    assert max(len(repr(result())), len(repr(result(dataset="d" * 300)))) <= 100
    assert "little window=5 on journey" in repr(result())
    page = result()._repr_html_()
    assert page.count("<table") == page.count("</table>") == 2
    assert "two carts" in page
    assert result().plot_pr()._repr_png_()[:4] == b"\x89PNG"
    assert len(result().plot_matrix().axes) == 3
    diagonal = {"scores": np.eye(4, 10, dtype=np.float32), "positives": tuple(np.array([place]) for place in range(4))}
    pairs = result(**diagonal).in_sequences(2)
    assert (pairs.queries, pairs.recall()) == (NAMES[1:], 1.0)
    assert pairs.to_frame()["best_place"].tolist() == [1, 2, 3]
    assert pairs.in_sequences(2, window="centred").queries == NAMES[2:]
    assert "sequence 2 causal" in repr(pairs)
    assert result(**diagonal).filter(ahead=1).recall() == 1.0
    with pytest.raises(BadInput, match="windwo"):
        pairs.in_sequences(2, windwo="centred")
    with pytest.raises(BadInput, match="scores=true"):
        result(scores=None).in_sequences(2)
