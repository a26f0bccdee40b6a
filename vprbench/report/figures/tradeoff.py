"""What accuracy costs: R@1 against query rate and against memory, with the methods that no other one beats in both."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from statistics import mean

import numpy as np
from matplotlib.axes import Axes

from vprbench.report.figures import style
from vprbench.report.figures.captions import (
    INTERVALS,
    choose_answerable,
    choose_runs,
    describe_timed_runs,
    list_names,
)
from vprbench.report.figures.style import Drawing, Look, choose_looks, new_figure, use_style
from vprbench.report.selection import MethodRuns
from vprbench.report.table.best import average_recall, compute_rate
from vprbench.runs.recall_intervals import estimate_recall_interval
from vprbench.runs.record import Run

_HEIGHT_MM = 60.0  # of a panel, without the legend
_ROOM = 3.0  # times the costs, to either side
_FRONT = f"Grey steps: Pareto front. Bars: {INTERVALS}, of several seeds of their mean hits."


@use_style
def draw_rate_tradeoff(series: Sequence[MethodRuns]) -> Drawing:
    """Draw R@1 against queries per second, encode and match together: up and right is better.

    Rows that were not timed are left out. Raises BadInput for no timed rows and if no query has a right place.
    """
    timed = choose_runs(choose_answerable(series), lambda run: run.timing, "was timed: run with timing=quick")
    untimed = [row.name for row in series if not any(run.timing for run in row.runs)]
    figure, (axes,) = new_figure(style.SINGLE_MM, _HEIGHT_MM, grid=True)
    looks = choose_looks(row.name for row in series)
    _draw_points(axes, timed, looks, compute_rate, "Queries per second, encode and match", lower_is_better=False)
    style.add_legend(figure, title=timed[0].runs[0].dataset)
    caption = (
        "R@1 against queries per second, one query from memory, encode and match; up and right is better. "
        f"{_FRONT}{list_names('Not timed', untimed)} {describe_timed_runs(timed)}"
    )
    return Drawing(figure, caption)


@use_style
def draw_memory_tradeoff(series: Sequence[MethodRuns]) -> Drawing:
    """Draw R@1 against the peak memory, and below against the bytes that a place of the map takes if runs hold them.

    Left and up is better. Raises BadInput if no query has a right place.
    """
    series = choose_answerable(series)
    maps = [row for row in series if all(map(_measure_map, row.runs))]
    n_panels = 1 + bool(maps)
    figure, panels = new_figure(style.SINGLE_MM, _HEIGHT_MM * n_panels, n_panels, grid=True)
    looks = choose_looks(row.name for row in series)
    _draw_points(panels[0], series, looks, lambda run: run.peak_memory_bytes / 1e6, "Peak memory (MB)")
    if maps:
        _draw_points(panels[1], maps, looks, _measure_map, "Map (bytes per place)")
    style.add_legend(figure, title=series[0].runs[0].dataset)
    on_gpu = [row.name for row in series if any(run.config["device"] != "cpu" for run in row.runs)]
    caption = (
        "R@1 against the peak main memory of the whole process, libraries included, and against the bytes of a place "
        f"in the map where descriptors are kept; up and left is better. {_FRONT}"
        f"{list_names('On a GPU, whose memory is not in it', on_gpu)} {describe_timed_runs(series)}"
    )
    return Drawing(figure, caption)


def find_front(costs: Sequence[float], gains: Sequence[float]) -> list[int]:
    """Return which points no other one beats, the cheapest first: at no more cost at least as good, and better in one.

    Of equal points all are returned.
    """
    points = list(zip(costs, gains, strict=True))
    beaten = {(c, g) for c, g in points if any(a <= c and b >= g and (a, b) != (c, g) for a, b in points)}
    return [i for i in sorted(range(len(points)), key=lambda i: points[i]) if points[i] not in beaten]


def _measure_map(run: Run) -> float:
    """Return the bytes of the map per place; 0 for a method that keeps no descriptors."""
    return float((run.search or {}).get("bytes_per_place") or 0)


def _draw_points(
    axes: Axes,
    series: Sequence[MethodRuns],
    looks: Mapping[str, Look],
    measure: Callable[[Run], float],
    label: str,
    lower_is_better: bool = True,
) -> None:
    """Draw R@1 with its interval over a cost of each row, and their front."""
    costs = [mean(map(measure, row.runs)) for row in series]
    recalls = [100 * (average_recall(row.runs) or 0.0) for row in series]
    for row, cost, recall in zip(series, costs, recalls, strict=True):
        interval = estimate_recall_interval(row.runs)
        ends = np.array([interval.low, interval.high] if interval else [np.nan, np.nan])
        bars = np.abs(100 * ends[:, None] - recall)
        axes.errorbar(cost, recall, bars, label=row.name, elinewidth=0.9, **looks[row.name].of_points)
    style.scale_log(axes, "x", costs, _ROOM)
    low, high = axes.get_ylim()
    axes.set(xlabel=label, ylabel="R@1 (%)", ylim=(max(low, 0), min(high, 100)))
    front = find_front([cost if lower_is_better else -cost for cost in costs], recalls)
    corners = [*(costs[i] for i in front), axes.get_xlim()[lower_is_better]]
    steps = [*(recalls[i] for i in front), recalls[front[-1]]]
    axes.step(corners, steps, where="post", color=style.GREY, linewidth=0.9, marker="", zorder=1)
