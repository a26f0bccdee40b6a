"""Figures of what accuracy costs: points, bars and fronts stand at the numbers of the runs; the legend names them."""

from dataclasses import replace
from itertools import product

import figure_runs
import numpy as np
import pytest
from figure_runs import series
from matplotlib.colors import to_hex
from stored_runs import PAPER, PUBLISHED, answers

from vprbench.metrics.intervals import share_interval
from vprbench.report.figures.growth import compute_median_interval, draw_growing_map, draw_growth, tabulate_growth
from vprbench.report.figures.speed import draw_query_rate, draw_training_time
from vprbench.report.figures.tradeoff import draw_memory_tradeoff, draw_rate_tradeoff, find_front
from vprbench.runs.notes import Note

approx = pytest.approx
ROWS = [*PAPER.rows.values()]
NORDLAND, WINTER = PAPER.columns["nordland"], PAPER.columns["railway_winter"]


def legend(drawn):
    return [text.get_text() for each in drawn.figure.legends for text in each.get_texts()]


def bar_ends(axes):
    """Return the ends of the upright bar of the first point."""
    return axes.containers[0].lines[2][0].get_segments()[0][:, 1].tolist()


def method(name, share, hz=100.0, megabytes=500.0, kept=None):
    """Return a row of one run on 400 queries whose encode and match take equally long."""
    times = {"encode_seconds": 0.5 / hz, "match_seconds": 0.5 / hz}
    costs = {"peak_memory_bytes": int(megabytes * 1e6), "bytes_per_place": kept}
    return series(name, figure_runs.run(name, share, n_queries=400, n_places=450, **times, **costs))


def points(axes):
    lines = [container.lines[0] for container in axes.containers]
    return [(float(line.get_xdata()[0]), float(line.get_ydata()[0])) for line in lines]


def test_points_stand_at_the_total_rate_and_the_recall_with_its_interval_and_untimed_rows_are_left_out():
    untimed = series("Untimed", replace(method("GCL", 0.5).runs[0], timing=None))
    hits = np.repeat([1, 0, 1, 1, 0, 0, 1, 0, 1, 1], 20)
    slow = figure_runs.run("S", n_queries=200, n_places=450, outcome=answers(hits.tolist(), 450))
    drawn = draw_rate_tradeoff([series("SAD", slow), method("GCL", 0, 80), method("C", 1, 4), untimed])
    (axes,) = drawn.figure.axes
    assert points(axes) == [approx((500, 60)), approx((80, 0)), approx((4, 100))]
    assert bar_ends(axes) == approx([100 * share_interval(hits).low, 100 * share_interval(hits).high])
    assert "Not timed: Untimed." in drawn.caption
    assert legend(drawn) == ["SAD", "GCL", "C"]


def test_the_front_is_that_of_a_slow_search_over_all_pairs():
    """A point is on it unless another is at least as good in both and better in one; the cheapest comes first."""
    grid = list(product(range(3), repeat=2))
    for chosen in product(grid, repeat=3):
        costs, gains = np.array(chosen).T
        beaten = [(costs <= c) & (gains >= g) & ((costs != c) | (gains != g)) for c, g in chosen]
        found = find_front(costs, gains)
        assert sorted(found) == [*np.flatnonzero(~np.any(beaten, axis=1))]
        assert sorted(costs[i] for i in found) == [costs[i] for i in found]


def test_memory_is_the_mean_of_the_seeds_and_the_map_has_a_panel_for_the_rows_that_keep_descriptors():
    seeds = [figure_runs.run("t", 0.5 + 0.2 * i, seed=i, peak_memory_bytes=10**8 * (i + 1)) for i in (0, 1)]
    (axes,) = draw_memory_tradeoff([series("VPRTempo", *seeds)]).figure.axes
    assert points(axes) == [approx((150, 60))]
    drawn = draw_memory_tradeoff([method("A", 0.5, kept=784), method("B", 0.6), method("C", 0.3, kept=8192)])
    above, below = drawn.figure.axes
    assert points(below) == [approx((784, 50)), approx((8192, 30))]
    colours = [[container.lines[0].get_color() for container in axes.containers] for axes in (above, below)]
    assert colours[1] == colours[0][::2]  # a row looks the same in both panels


def tempo(*minutes, device="cpu"):
    """Return VPRTempo with a run for each number of minutes of training; the n-th matches in n ms and encodes in 1."""
    times = [{"fit_seconds": 60 * each, "match_seconds": 0.001 * i} for i, each in enumerate(minutes, 1)]
    runs = [figure_runs.run("vprtempo", seed=i, device=device, **each) for i, each in enumerate(times, 1)]
    return series("VPRTempo", *runs)


def bars(axes, hatched):
    """Return the number at the end of each bar, by the row at which it stands."""
    found = [bar for bar in axes.patches if bool(bar.get_hatch()) == hatched]
    return {round(bar.get_y() + bar.get_height() / 2): bar.get_x() + bar.get_width() for bar in found}


def black_lines(axes):
    """Return where lines over bars begin and end."""
    return [list(line.get_xdata()) for line in axes.lines if line.get_color() == "black"]


def test_training_bars_end_at_the_seconds_without_waiting_for_images_and_a_tick_with_it_beside_the_published():
    netvlad = series("NetVLAD", figure_runs.run("netvlad", fit_seconds=6000.0))  # comes trained
    drawn = draw_training_time([tempo(3.0), netvlad], ROWS, NORDLAND, PUBLISHED)
    (axes,) = drawn.figure.axes
    assert bars(axes, hatched=False) == {4: approx(180)}
    assert bars(axes, hatched=True) == {1: approx(907200), 2: approx(21600), 3: approx(21600), 4: approx(3600)}
    assert [x[0] == x[1] for x in black_lines(axes)] == [True]  # the tick alone: one seed has no spread
    assert legend(drawn) == ["measured here", "published", "with reading the images"]
    assert "quoted there: NetVLAD, GCL." in drawn.caption
    times = ({"fit_seconds": 540.0 + 120 * i, "fit_compute_seconds": 60.0 * i} for i in (1, 2, 4))
    runs = [figure_runs.run("t", seed=i, **each) for i, each in enumerate(times)]
    (axes,) = draw_training_time([series("VPRTempo", *runs)], ROWS, NORDLAND, PUBLISHED).figure.axes
    assert bars(axes, hatched=False)[4] == approx(120)
    assert black_lines(axes) == [approx([60, 240]), approx([780, 780])]
    assert "120 (780)" in [text.get_text() for text in axes.texts]


def test_rates_are_of_encode_and_match_together_with_the_middle_four_fifths_of_laps_beside_the_paper_s():
    run = figure_runs.run("vprtempo", match_seconds=0.001, spread=0.2)
    laps = sorted(run.timing.streaming.total_seconds)  # 101 laps: the quantiles 0.1 and 0.9 are laps 11 and 91
    one, several = series("VPRTempo", run), tempo(1.0, 1.0)  # of two seeds: 500 and 333 Hz
    for given, column, line, bar in (
        (one, NORDLAND, [1 / laps[90], 1 / laps[10]], 500),
        (several, WINTER, [1000 / 3, 500], 1250 / 3),
    ):
        drawn = draw_query_rate([given], ROWS, column, PUBLISHED)
        (axes,) = drawn.figure.axes
        told = (PUBLISHED.source, column.published, "i7-9700K", "VPRSNN match, VPRTempo match.")
        assert all(text in drawn.caption for text in told)
        assert black_lines(axes)[0] == approx(line)
        assert bars(axes, hatched=False) == {4: approx(bar)}
        rates = [10, 0.5, 2, 2, 353] if column == NORDLAND else [185, 0.5, 0.4, 2, 1670]
        assert [bars(axes, hatched=True)[i] for i in range(5)] == approx(rates)


def test_a_gpu_gets_a_panel_of_its_own_and_a_column_that_the_paper_does_not_have_measured_bars_alone():
    cpu, gpu = draw_query_rate([tempo(3.0), tempo(0.1, device="cuda")], ROWS, NORDLAND, PUBLISHED).figure.axes
    assert (cpu.get_title(loc="left"), gpu.get_title(loc="left")) == ("CPU", "GPU")
    assert cpu.get_xlim() == gpu.get_xlim()
    assert bars(gpu, hatched=True)[4] == approx(1634)
    assert 3 not in bars(gpu, hatched=True)  # the paper has no GPU code of VPRSNN
    drawn = draw_query_rate([tempo(3.0)], ROWS, replace(PAPER.columns["railway"], published=None), PUBLISHED)
    assert (bars(drawn.figure.axes[0], hatched=True), legend(drawn)) == ({}, ["measured here"])
    assert "i7-9700K" not in drawn.caption


SIZES = (100, 300, 1000, 3000, 9000, 27000)


def grown(runs):
    return draw_growth([series("VPRTempo", *runs)])


def slope(axes):
    """Return the ends of the fitted line, (2, 2): places and seconds."""
    return next(line.get_xydata() for line in axes.lines if len(line.get_xydata()) == 2)


def test_points_stand_at_places_seconds_and_milliseconds_and_a_line_is_the_fitted_power():
    runs = [figure_runs.sized(n, 0.01 * n, 1e-6 * n**0.5, encode_seconds=1e-6 * n**0.5) for n in SIZES]
    drawn = grown(runs)
    left, right = drawn.figure.axes
    training, query = (axes.containers[0].lines[0].get_xydata()[0] for axes in (left, right))
    assert (training.tolist(), query.tolist()) == (approx([100, 1]), approx([100, 0.02]))
    assert legend(drawn) == ["VPRTempo, training exponent 1.00 [1.00, 1.00], query exponent 0.50 [0.50, 0.50]"]
    assert slope(left) == approx(np.array([[100, 1], [27000, 270]]))
    untimed = grown([replace(run, timing=None) for run in runs[:2]])
    assert legend(untimed) == ["VPRTempo"]  # too few sizes
    assert [axes.get_visible() for axes in untimed.figure.axes] == [True, False]


def test_seeds_are_several_points_disturbed_sizes_hollow_and_the_bar_of_a_query_the_interval_of_its_median():
    asked = product(range(3), SIZES)
    runs = [figure_runs.sized(n, n / 100 * (1, 2, 9)[seed], 0.001, seed=seed) for seed, n in asked]
    left, _ = grown(runs).figure.axes
    assert list(left.containers[0].lines[0].get_ydata()[:3]) == approx([1, 2, 9])
    assert slope(left) == approx(np.array([[100, 2], [27000, 540]]))
    noisy = (Note("noisy", "noisy: two carts passed"),)
    runs = [figure_runs.sized(n, 0.01 * n, 0.001, notes=noisy * (n in (300, 9000))) for n in SIZES]
    for axes in grown(runs).figure.axes:
        hollow = [points.lines[0] for points in axes.containers if to_hex(points.lines[0].get_mfc()) == "#ffffff"]
        assert {tuple(line.get_xdata()) for line in hollow} == {(300, 9000)}
    run = figure_runs.sized(100, 1.0, 0.001, spread=0.5)  # 101 laps: ranks 41 and 61 of the ordered ones
    laps = np.sort(1e3 * run.timing.streaming.total_seconds)
    _, right = grown([run]).figure.axes
    assert bar_ends(right) == approx([laps[40], laps[60]])


def test_a_growing_map_has_the_recall_of_all_its_places_and_of_the_first_and_the_milliseconds_of_a_new_one():
    stops = (
        {"places": 2, "recall_at_1": 0.5, "recall_at_1_of_first": 0.5, "seconds_a_place": None},
        {"places": 4, "recall_at_1": 0.75, "recall_at_1_of_first": 1.0, "seconds_a_place": 0.002},
    )
    grown_map = series("SAD", figure_runs.run("sad", n_queries=4), figure_runs.run("sad", n_queries=4, stream=stops))
    drawn = draw_growing_map([grown_map, method("GCL", 0.5)])
    left, right = drawn.figure.axes
    assert [line.get_xydata().tolist() for line in left.lines] == [[[2, 50], [4, 75]], [[2, 50], [4, 100]]]
    assert [line.get_xydata().tolist() for line in right.lines] == [[[4, approx(2)]]]
    assert legend(drawn) == ["SAD", "SAD, of the first 2"]


def test_the_interval_of_a_median_lies_at_the_tabulated_ranks():
    # ranks of the 95 % interval: Conover, Practical Nonparametric Statistics, table of the binomial distribution
    assert compute_median_interval(np.arange(5.0)) is None
    for n_laps, k in ((6, 1), (10, 2), (25, 8), (100, 40)):
        laps = np.random.default_rng(0).permutation(np.arange(1.0, n_laps + 1))
        assert compute_median_interval(laps) == (k, n_laps + 1 - k)


def test_samples_stand_in_the_order_of_places_and_seeds_and_the_newest_run_of_each_counts():
    asked = [(n, seed) for n in (300, 100) for seed in (1, 0)]
    runs = [figure_runs.sized(n, 5.0, 0.001 * n, seed=seed, fit_compute_seconds=n / 100) for n, seed in asked]
    runs.append(figure_runs.sized(100, 9.0, 0.009, seed=0, day="2020-01-01"))
    found = tabulate_growth(runs)
    assert [*zip(found.places, found.seed, strict=True)] == [(100, 0), (100, 1), (300, 0), (300, 1)]
    assert found.fit_compute_seconds.tolist() == [1, 1, 3, 3]
    assert found.query_seconds.iloc[-1] == pytest.approx(0.301)  # 1 ms to encode


def test_runs_with_other_arguments_weights_or_protocol_are_another_growth():
    given, protocol = {"max_module": 1100, "rules": "own"}, {"places": 300, "tolerance_places": 0}
    new = figure_runs.sized(1000, 1.0, 0.001, arguments=given, protocol={**protocol, "places": 1000})

    def older(**changes):
        asked = {"day": "2024-01-01", "arguments": given, "protocol": protocol, **changes}
        return figure_runs.sized(300, 9.0, 0.001, **asked)

    smaller = older(protocol={**protocol, "query_places": 9})
    assert [*tabulate_growth([new, smaller])["record"]] == [smaller, new]
    weights = {**older().config, "files": [{"name": "weights", "sha256": "ab"}]}
    dataset, arguments = {**protocol, "tolerance_places": 2}, {**given, "rules": "reference"}
    for other in older(arguments=arguments), older(protocol=dataset), replace(older(), config=weights):
        assert [*tabulate_growth([new, other])["record"]] == [new]
