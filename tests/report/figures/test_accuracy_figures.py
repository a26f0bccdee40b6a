"""Curves of accuracy hold the numbers worked by hand, with bands as wide as chance makes them."""

import numpy as np
import pandas as pd
import pytest
from figure_runs import run, series
from little import a_run, answered

from vprbench.report.figures import accuracy
from vprbench.report.figures.accuracy import draw_precision_recall, draw_recall_at_n, draw_recall_at_tolerance
from vprbench.runs.sequences import parse_views


def panel(drawn):
    (axes,) = drawn.figure.axes
    return axes


def named_lines(drawn):
    """The lines that the legend names."""
    return [line for line in panel(drawn).lines if not line.get_label().startswith("_")]


def points(line):
    return [(x, y) for x, y in line.get_xydata().tolist()]


def band(drawn):
    """The lowest and highest edge of the only band, by x."""
    (edges,) = panel(drawn).collections
    table = pd.DataFrame(np.asarray(edges.get_paths()[0].vertices)).groupby(0)[1].agg(["min", "max"])
    return {x: (low, high) for x, low, high in table.itertuples()}


def answers(best, right):
    """A run over ten places whose best match of each query scores so much and is right or not."""
    scores = np.zeros((len(best), 10), np.float32)
    scores[range(len(best)), np.where(right, 0, 5)] = best
    return answered(scores, [[0]] * len(best))


# `a_run` answers right, right, wrong, wrong with falling scores; its right places stand 1st, 1st, 3rd and 8th of
# ten, and its wrong answers lie 7 and 4 places from them.


def test_precision_and_recall_of_four_queries_are_those_worked_by_hand():
    (line,) = named_lines(draw_precision_recall([series("SAD", a_run())]))
    assert points(line) == [(0, 1), (0.25, 1), (0.5, 1), (0.5, pytest.approx(2 / 3)), (0.5, 0.5)]
    assert line.get_drawstyle() == "steps-pre"  # a step has the height of its right end
    assert line.get_label() == "SAD, AP 0.500"
    alone = answered(np.eye(100, 10) / np.arange(1, 101)[:, None], [[0], *[[]] * 99])  # too few queries for a band
    assert points(named_lines(draw_precision_recall([series("SAD", alone)]))[0])[1] == (1, 1)


def test_the_curve_of_several_seeds_is_their_mean_as_far_as_all_reach():
    first = answers([0.9, 0.8, 0.7, 0.6], [True, True, False, True])  # precision 1, 1, 3/4 at recall 1/4, 1/2, 3/4
    second = answers([0.9, 0.8, 0.7, 0.6], [False, True, True, False])  # precision 1/2, 2/3 at recall 1/4, 1/2
    drawn = draw_precision_recall([series("VPRTempo", first, second)])
    (mean,) = named_lines(drawn)
    assert points(mean) == [(0, 1), (0.25, pytest.approx(3 / 4)), (0.5, pytest.approx(5 / 6))]
    assert [points(line)[-1] for line in panel(drawn).lines if line is not mean] == [(0.75, 0.75), (0.5, 0.5)]
    # AP (1 + 1 + 3/4) / 4 = 0.6875 and (1/2 + 2/3) / 4 = 0.2917: mean 0.4896, standard deviation 0.2799
    assert mean.get_label() == "VPRTempo, AP 0.490 ± 0.280"
    assert len(panel(drawn).collections) == 0  # no band of queries


def test_the_band_of_one_run_holds_its_curve_and_ends_before_it():
    """The share of right answers is 60 % of 400 queries: some resamples have fewer."""
    drawn = draw_precision_recall([series("SAD", run("sad", share=0.6, n_queries=400))])
    recall, precision = np.array(points(named_lines(drawn)[0])).T
    edges = band(drawn)
    assert 0.5 < max(edges) < recall[-1] == pytest.approx(0.6)
    for x, (low, high) in edges.items():
        assert low - 1e-9 <= precision[np.argmax(recall >= x - 1e-12)] <= high + 1e-9
    without_an_error = band(draw_precision_recall([series("SAD", run("sad", share=1.0))]))
    assert (max(without_an_error), {*without_an_error.values()}) == (1, {(1, 1)})


def test_the_band_of_independent_queries_is_as_wide_as_95_percent_of_their_waiting_times():
    """One in two is right, so r n right ones take 2 r n answers, give or take the root of 2 r n (negative binomial)."""
    random, n = np.random.default_rng(0), 800
    made = answers(random.random(n).tolist(), (random.random(n) < 0.5).tolist())
    edges = band(draw_precision_recall([series("SAD", made)]))
    ratios = [(high - low) / (0.5 / (2 * x * n) ** 0.5) for x, (low, high) in edges.items() if 0.1 < x < 0.4]
    assert np.mean(ratios) == pytest.approx(2 * 1.96, rel=0.12)


def test_recalls_are_those_worked_by_hand_with_wilsons_interval_and_count_ties_by_their_expected_value():
    drawn = draw_recall_at_n([series("SAD", a_run())])
    (line,) = named_lines(drawn)
    assert points(line) == list(zip(range(1, 11), [50, 50, 75, 75, 75, 75, 75, 100, 100, 100], strict=True))
    edges = band(drawn)
    assert edges[1] == pytest.approx((15.00, 85.00), abs=0.01)  # Wilson's interval of 2 of 4
    assert edges[10] == pytest.approx((51.01, 100), abs=0.01)  # and of 4 of 4
    (line,) = named_lines(draw_recall_at_tolerance([series("SAD", a_run())]))
    assert points(line) == list(zip(range(11), [50] * 4 + [75] * 3 + [100] * 4, strict=True))
    made = answered(np.zeros((8, 50), np.float32), [[query] for query in range(8)])  # 50 places tie, one is right
    (line,) = named_lines(draw_recall_at_n([series("SAD", made)]))
    assert points(line) == [(n, pytest.approx(2 * n)) for n in range(1, 26)]


def test_tolerances_begin_at_that_of_the_protocol_in_places_and_otherwise_count_from_it():
    for protocol, first in (({"tolerance_places": 2}, 2), ({"tolerance_metres": 5.0}, 0), ({"radius_metres": 5.0}, 0)):
        (line,) = named_lines(draw_recall_at_tolerance([series("SAD", a_run(protocol=protocol))]))
        assert [x for x, _ in points(line)] == list(range(first, first + 11))
        assert points(line)[0][1] == 50


@pytest.mark.parametrize("draw", [draw_recall_at_n, draw_recall_at_tolerance])
def test_several_seeds_are_thin_lines_around_their_mean_with_the_interval_of_the_mean_hits(draw):
    drawn = draw([series("VPRTempo", *(run(share=share, seed=i) for i, share in enumerate((0.25, 0.55, 0.7))))])
    (mean,) = named_lines(drawn)
    x, y = points(mean)[0]
    assert y == pytest.approx(50)
    assert band(drawn)[x] == pytest.approx((35.20, 64.80), abs=0.01)  # Wilson's interval of 20 of 40
    assert [points(line)[0][1] for line in panel(drawn).lines if line is not mean] == pytest.approx([25, 55, 70])


def test_sequences_have_their_recall_at_each_length_and_the_caption_counts_the_queries():
    noisy = np.random.default_rng(0).normal(size=(3, 30, 30)) + np.eye(30)
    runs = [answered(scores, [[i] for i in range(30)]) for scores in noisy]
    views = {view(runs[0]).view.window: [view(made) for made in runs] for view in parse_views([1, 2, 5])}
    seen = [[series("first", *runs[:2]), series("second", runs[2])] for runs in views.values()]
    drawn = accuracy.draw_recall_at_length(seen[::-1])
    first, second = (dict(points(line)) for line in panel(drawn).lines)
    for length, runs in views.items():
        recalls = [100 * np.mean(made.scores.argmax(1) == np.concatenate(made.positives)) for made in runs]
        assert (first[length], second[length]) == pytest.approx((np.mean(recalls[:2]), recalls[2]))
    assert "30 at 1, 29 at 2, 26 at 5" in drawn.caption
