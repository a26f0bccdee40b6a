from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import figure_runs
import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.colors import to_hex

from vprbench.paper.figures.growth import growth
from vprbench.paper.growth import GrowthSamples, samples
from vprbench.paper.plan import Row
from vprbench.run.note import Note
from vprbench.run.record import Run

SIZES = (100, 300, 1000, 3000, 9000, 27000)
TEMPO = Row("VPRTempo", "vprtempo", boundary="match")
SAD = Row("SAD", "sad", boundary="match", training="none")


def grown(row: Row, runs: Sequence[Run] | None = None) -> GrowthSamples:
    """Return samples of a training of 0.4 s + 4 ms a place and a match of 1 ms a unit of ln places, nearly exact."""
    wobble = (1.01, 0.99, 1.01, 0.99, 1.01, 0.99)
    made = [
        figure_runs.sized(n, (0.4 + 0.004 * n) * w, 0.001 * np.log(n) * w, encode_seconds=0.002)
        for n, w in zip(SIZES, wobble, strict=True)
    ]
    return samples(row, made if runs is None else runs, ())


def labels(axes: Axes) -> list[str]:
    legend = axes.get_legend()
    return [text.get_text() for text in legend.get_texts()] if legend else []


def test_points_stand_at_places_and_seconds_of_training_and_milliseconds_of_a_query() -> None:
    left, right = growth([grown(TEMPO)]).figure.axes
    points = left.containers[0].lines[0]
    assert list(points.get_xdata()) == list(SIZES)
    assert points.get_ydata()[:2] == pytest.approx([0.8 * 1.01, 1.6 * 0.99])
    assert right.containers[0].lines[0].get_ydata()[0] == pytest.approx(np.log(100) * 1.01 + 2)
    for axes in (left, right):
        assert (axes.get_xscale(), axes.get_yscale()) == ("log", "log")
        drawn = np.concatenate([container.lines[0].get_ydata() for container in axes.containers])
        assert axes.get_ylim()[0] < drawn.min() <= drawn.max() < axes.get_ylim()[1]


def test_the_best_law_is_thick_and_named_and_the_others_say_how_much_worse_they_are() -> None:
    left, right = growth([grown(TEMPO)]).figure.axes
    for axes, best in ((left, "linear"), (right, "logarithmic")):
        widths = {
            line.get_label().split(",")[0]: line.get_linewidth() for line in axes.lines if "AICc" in line.get_label()
        }
        assert set(widths) == {"constant", "logarithmic", "linear"}
        assert max(widths, key=lambda law: widths[law]) == best
        assert f"{best}, lowest AICc" in labels(axes)
        assert sum("AICc higher by" in label for label in labels(axes)) == 2


def test_the_exponent_stands_in_the_legend_with_its_interval() -> None:
    exact = [figure_runs.sized(n, 0.01 * n, 1e-6 * n**0.5, encode_seconds=1e-6 * n**0.5) for n in SIZES]
    left, right = growth([grown(TEMPO, exact)]).figure.axes
    assert labels(left)[0] == "training, exponent 1.00 [1.00, 1.00]"
    assert labels(right)[0] == "encode and match, exponent 0.50 [0.50, 0.50]"
    left, _ = growth([grown(TEMPO, exact[:3])]).figure.axes  # too few sizes for laws
    assert labels(left) == ["training"]


def test_a_method_that_trains_nothing_has_query_times_alone() -> None:
    runs = [figure_runs.sized(n, None, 1e-6 * n) for n in SIZES]
    left, right = growth([grown(SAD, runs)]).figure.axes
    assert [text.get_text() for text in left.texts] == ["nothing was trained"]
    assert len(right.containers) == 1


def test_several_rows_show_their_best_laws_alone_under_their_names() -> None:
    left, _ = growth([grown(TEMPO), grown(Row("other", "other"))]).figure.axes
    named = [label.split(",")[0] for label in labels(left)]
    assert named == ["VPRTempo: training", "other: training", "VPRTempo: linear", "other: linear"]


def test_several_seeds_are_several_points_and_the_law_is_that_of_their_median() -> None:
    runs = [figure_runs.sized(n, n / 100 * (1, 2, 9)[seed], 0.001, seed=seed) for n in SIZES for seed in range(3)]
    left, _ = growth([grown(TEMPO, runs)]).figure.axes
    assert list(left.containers[0].lines[0].get_ydata()[:3]) == pytest.approx([1, 2, 9])
    (line,) = (line for line in left.lines if line.get_label() == "linear, lowest AICc")
    assert (line.get_xdata()[0], line.get_xdata()[-1]) == pytest.approx((100, 27000))
    assert (line.get_ydata()[0], line.get_ydata()[-1]) == pytest.approx((2, 540))


def test_disturbed_sizes_are_hollow_and_named() -> None:
    noisy = Note("noisy", "noisy: two carts passed")
    runs = [replace(r, notes=(noisy,) * (r.outcome.n_places in (300, 9000))) for r in grown(TEMPO).runs]
    for axes in growth([grown(TEMPO, runs)]).figure.axes:
        hollow = [points.lines[0] for points in axes.containers if to_hex(points.lines[0].get_mfc()) == "#ffffff"]
        assert {tuple(line.get_xdata()) for line in hollow} == {(300, 9000)}


def test_the_bar_of_a_query_is_the_interval_of_its_median() -> None:
    run = figure_runs.sized(100, 1.0, 0.001, spread=0.5)  # 101 laps: ranks 41 and 61 of the ordered ones
    laps = np.sort(1e3 * run.timing.streaming.total_seconds)
    _, right = growth([grown(TEMPO, [run])]).figure.axes
    ((_, low), (_, high)) = right.containers[0].lines[2][0].get_segments()[0]
    assert (low, high) == pytest.approx((laps[40], laps[60]))
