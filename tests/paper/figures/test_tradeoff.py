from __future__ import annotations

from collections.abc import Callable
from itertools import product

import figure_runs
import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.transforms import Bbox
from stored_runs import answers

from vprbench.metrics.intervals import share_interval
from vprbench.paper.figures.style import Drawn
from vprbench.paper.figures.tradeoff import against_memory, against_rate, front
from vprbench.paper.selection import Series

METHODS = ("VPRTempo", "VPRTempo, public code", "SAD", "NetVLAD", "CosPlace", "MixVPR")


def method(name: str, share: float, hz: float = 100.0, megabytes: float = 500.0, kept: int | None = None) -> Series:
    """Return a row of one run on 400 queries whose encode and match take equally long."""
    run = figure_runs.run(
        name,
        share,
        n_queries=400,
        n_places=450,
        encode_seconds=0.5 / hz,
        match_seconds=0.5 / hz,
        peak_memory_bytes=int(megabytes * 1e6),
        bytes_per_place=kept,
    )
    return figure_runs.series(name, run)


def points(axes: Axes) -> list[tuple[float, float]]:
    lines = [container.lines[0] for container in axes.containers]
    return [(float(line.get_xdata()[0]), float(line.get_ydata()[0])) for line in lines]


def steps(axes: Axes) -> list[tuple[float, float]]:
    """Return the corners of the front: the only line with more than one of them."""
    (line,) = (line for line in axes.lines if len(line.get_xdata()) > 1)
    return [(float(x), float(y)) for x, y in zip(line.get_xdata(), line.get_ydata(), strict=True)]


def marker_boxes(axes: Axes) -> list[Bbox]:
    where = axes.transData.transform(points(axes))
    half = 2 * axes.get_figure().dpi / 72  # markers are 4 points wide
    return [Bbox.from_extents(x - half, y - half, x + half, y + half) for x, y in where]


def label_boxes(figure: Figure, axes: Axes) -> list[Bbox]:
    """Return the boxes of the names, without the lines that lead to their points."""
    figure.draw_without_rendering()
    return [Text.get_window_extent(text) for text in axes.texts]


def crowded() -> list[Series]:
    return [method(name, 0.5 + 0.01 * i, 1000 - 20 * i, 400 + 3 * i, 4096 + i) for i, name in enumerate(METHODS)]


def spread() -> list[Series]:
    costs = (1000, 900, 5, 0.5, 40, 30)
    return [
        method(name, share, hz, 10000 / hz**0.5, 4096)
        for name, share, hz in zip(METHODS, (0.9, 0.88, 0.4, 0.3, 0.6, 0.62), costs, strict=True)
    ]


def alike() -> list[Series]:
    return [method(name, 0.5, 100, 500, 4096) for name in METHODS]


def test_points_stand_at_the_total_rate_and_the_recall_in_percent() -> None:
    (axes,) = against_rate([method("SAD", 0.5, 80), method("GCL", 0, 2), method("C", 1, 4)]).figure.axes
    assert points(axes) == [pytest.approx((80, 50)), pytest.approx((2, 0)), pytest.approx((4, 100))]
    assert axes.get_ylim() == (0, 100)


@pytest.mark.parametrize(
    ("hits", "kind"), [([1] * 400, "independent"), (np.repeat([1, 0, 1, 1, 0, 0, 1, 0, 1, 1], 20).tolist(), "blocks")]
)
def test_the_bar_is_the_interval_of_the_hits(hits: list[int], kind: str) -> None:
    expected = share_interval(np.array(hits))
    assert expected is not None
    assert expected.kind == kind
    run = figure_runs.run("SAD", n_queries=len(hits), n_places=450, outcome=answers(hits, 450))
    (axes,) = against_rate([figure_runs.series("SAD", run)]).figure.axes
    ((_, low), (_, high)) = axes.containers[0].lines[2][0].get_segments()[0]
    assert (low, high) == pytest.approx((100 * expected.low, 100 * expected.high))


def test_several_seeds_are_one_point_at_their_means() -> None:
    runs = [
        figure_runs.run("vprtempo", share, seed=i, peak_memory_bytes=10**8 * (i + 1))
        for i, share in enumerate((0.5, 0.7))
    ]
    drawn = against_memory([figure_runs.series("VPRTempo", *runs)])
    assert points(drawn.figure.axes[0]) == [pytest.approx((150, 60))]


def test_the_front_is_that_of_a_slow_search_over_all_pairs() -> None:
    """A point is on it unless another is at least as good in both and better in one; the cheapest comes first."""
    grid = list(product(range(3), repeat=2))
    for chosen in ([grid[i] for i in order] for order in product(range(9), repeat=4)):
        costs, gains = zip(*chosen, strict=True)
        better = [
            i
            for i, (cost, gain) in enumerate(chosen)
            if not any(c <= cost and g >= gain and (c, g) != (cost, gain) for c, g in chosen)
        ]
        found = front(costs, gains)
        assert sorted(found) == better
        assert sorted(costs[i] for i in found) == [costs[i] for i in found]


def test_the_steps_run_from_the_fastest_to_the_slow_end_of_the_rates() -> None:
    series = [method("A", 0.25, 100), method("B", 0.5, 10), method("C", 0.75, 1), method("D", 0.25, 50)]
    (axes,) = against_rate(series).figure.axes
    corners = [(100, 25), (10, 25), (10, 50), (1, 50), (1, 75), (axes.get_xlim()[0], 75)]
    assert steps(axes) == [pytest.approx(corner) for corner in corners]
    (axes,) = against_memory([method("A", 0.25, megabytes=100), method("B", 0.5, megabytes=1000)]).figure.axes
    corners = [(100, 25), (1000, 25), (1000, 50), (axes.get_xlim()[1], 50)]
    assert steps(axes) == [pytest.approx(corner) for corner in corners]


def test_the_map_has_a_panel_of_its_own_for_the_rows_that_keep_descriptors() -> None:
    drawn = against_memory([method("SAD", 0.5, kept=784), method("VPRTempo", 0.6), method("GCL", 0.3, kept=8192)])
    _, right = drawn.figure.axes
    assert points(right) == [pytest.approx((784, 50)), pytest.approx((8192, 30))]


@pytest.mark.parametrize("series", [crowded(), spread(), alike()], ids=["crowded", "spread", "alike"])
@pytest.mark.parametrize("draw", [against_rate, against_memory])
def test_names_of_six_methods_cover_neither_one_another_nor_points_and_stay_inside(
    series: list[Series], draw: Callable[[list[Series]], Drawn]
) -> None:
    figure = draw(series).figure
    for axes in figure.axes:
        names, markers = label_boxes(figure, axes), marker_boxes(axes)
        assert [text.get_text() for text in axes.texts] == list(METHODS)
        assert not any(one.overlaps(other) for i, one in enumerate(names) for other in names[:i])
        assert not any(name.overlaps(marker) for name in names for marker in markers)
        assert all(axes.bbox.x0 <= box.x0 and box.x1 <= axes.bbox.x1 for box in names)


def test_names_stand_in_a_legend_where_a_panel_has_no_room_for_them() -> None:
    many = [method(f"a method of a long name, {i}", 0.5, 100, 500) for i in range(16)]
    for figure in (against_rate(many).figure, against_memory(many).figure):
        assert not any(axes.texts for axes in figure.axes)
        (legend,) = figure.legends
        assert [text.get_text() for text in legend.get_texts()] == [one.name for one in many]


def test_a_row_that_was_not_timed_is_left_out_by_name() -> None:
    untimed = figure_runs.series("GCL", figure_runs.run("gcl", timing=None))
    drawn = against_rate([figure_runs.series("SAD", figure_runs.run("sad")), untimed])
    assert len(points(drawn.figure.axes[0])) == 1
    assert "Left out, for it was not timed: GCL." in drawn.caption
