"""What accuracy costs: R@1 against query rate and against memory, with the methods that no other one beats in both."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from statistics import mean
from typing import NamedTuple

from matplotlib.axes import Axes

from vprbench.errors import BadInput
from vprbench.metrics.intervals import Interval
from vprbench.report.figures import style
from vprbench.report.figures.captions import (
    INTERVALS,
    describe_runs,
    join_facts,
    list_names,
    require_answerable,
    split_timed,
)
from vprbench.report.figures.style import Drawing, choose_looks, new_figure, use_style
from vprbench.report.selection import Series
from vprbench.report.table.best import average_recall, compute_rate
from vprbench.runs.recall_intervals import recall_interval
from vprbench.runs.record import Run

_HEIGHT_MM = 60.0  # of a panel, without the legend
_ROOM = 3.0  # times the costs, to either side
_MB = 1e6


class _Point(NamedTuple):
    """One row: R@1 in % with its interval, and what it takes."""

    name: str
    cost: float
    recall: float
    interval: Interval


@use_style
def draw_rate_tradeoff(series: Sequence[Series]) -> Drawing:
    """Draw R@1 against queries per second, encode and match together: up and right is better.

    Rows that were not timed are left out. Raises BadInput for no timed rows, for rows on different data and if no query
    has a right place.
    """
    kept, untimed = split_timed(series)
    if not kept and untimed:
        raise BadInput("the figure of accuracy against query rate has no timed runs to draw: run with timing=quick")
    points = _points(kept, "accuracy against query rate", compute_rate)
    figure, (axes,) = new_figure(style.SINGLE_MM, _HEIGHT_MM)
    best = _draw(axes, points, "Queries per second, encode and match", lower_is_better=False)
    style.add_legend(figure, axes.get_legend_handles_labels()[0], kept[0].runs[0].dataset)
    caption = join_facts(
        "R@1 against queries per second, one query from memory, encode and match; up and right is better.",
        list_names("Not timed", untimed),
        _describe_front(best, kept),
    )
    return Drawing(figure, caption)


@use_style
def draw_memory_tradeoff(series: Sequence[Series]) -> Drawing:
    """Draw R@1 against the peak memory, and below against the bytes that a place of the map takes if runs hold them.

    Left and up is better. Raises BadInput for no rows, for rows on different data and if no query has a right place.
    """
    peak = _points(series, "accuracy against memory", lambda run: run.peak_memory_bytes / _MB)
    kept = [row for row in series if all((run.search or {}).get("bytes_per_place") for run in row.runs)]
    n_panels = 1 + bool(kept)
    figure, panels = new_figure(style.SINGLE_MM, _HEIGHT_MM * n_panels, n_panels)
    best = _draw(panels[0], peak, "Peak memory (MB)", lower_is_better=True)
    if kept:
        maps = _points(kept, "accuracy against map size", lambda run: (run.search or {})["bytes_per_place"])
        _draw(panels[1], maps, "Map (bytes per place)", lower_is_better=True)
    style.add_legend(figure, panels[0].get_legend_handles_labels()[0], series[0].runs[0].dataset)
    on_gpu = [row.name for row in series if any(run.config["device"] != "cpu" for run in row.runs)]
    caption = join_facts(
        "R@1 against the peak main memory of the whole process, libraries included; up and left is better.",
        list_names("On a GPU, whose memory is not in it", on_gpu),
        "Below: bytes of the map per place, of rows that keep descriptors." if kept else "",
        _describe_front(best, series),
    )
    return Drawing(figure, caption)


def find_front(costs: Sequence[float], gains: Sequence[float]) -> list[int]:
    """Return which points no other one beats, the cheapest first: at no more cost at least as good, and better in one.

    Of equal points all are returned.
    """
    order = sorted(range(len(costs)), key=lambda i: (costs[i], -gains[i]))
    kept: list[int] = []
    for i in order:
        if not kept or gains[i] > gains[kept[-1]] or (costs[i], gains[i]) == (costs[kept[-1]], gains[kept[-1]]):
            kept.append(i)
    return kept


def _describe_front(best: Sequence[str], series: Sequence[Series]) -> str:
    ending = describe_runs(series, "means, the bar is of mean hits", of_times=True)
    return f"Grey steps: Pareto front ({', '.join(best)}). Bars: {INTERVALS}. {ending}"


def _points(series: Sequence[Series], figure: str, measure_cost: Callable[[Run], float]) -> list[_Point]:
    dataset = require_answerable(series, figure).dataset
    points = []
    for row in series:
        interval, recall = recall_interval(row.runs), average_recall(row.runs)
        if interval is None or recall is None:
            raise BadInput(f"{dataset} has too few queries for an interval: there is no figure of {figure}")
        in_percent = Interval(100 * interval.low, 100 * interval.high)
        points.append(_Point(row.name, mean(map(measure_cost, row.runs)), 100 * recall, in_percent))
    return points


def _draw(axes: Axes, points: Sequence[_Point], label: str, lower_is_better: bool) -> list[str]:
    """Draw points and their front; returns the names on the front."""
    style.scale_log(axes, "x", [point.cost for point in points], _ROOM)
    lowest, highest = min(point.interval.low for point in points), max(point.interval.high for point in points)
    room = 0.08 * (highest - lowest)
    axes.set(xlabel=label, ylabel="R@1 (%)", ylim=(max(lowest - room, 0), min(highest + room, 100)))
    sign = 1 if lower_is_better else -1
    best = [points[i] for i in find_front([sign * each.cost for each in points], [each.recall for each in points])]
    end = axes.get_xlim()[1 if lower_is_better else 0]
    costs, recalls = [*(point.cost for point in best), end], [*(point.recall for point in best), best[-1].recall]
    axes.step(costs, recalls, where="post", color=style.GREY, linewidth=0.9, marker="", zorder=1)
    looks = choose_looks(point.name for point in points)
    for point in points:
        low, high = max(point.recall - point.interval.low, 0), max(point.interval.high - point.recall, 0)  # rounding
        kind = looks[point.name].of_points
        axes.errorbar(point.cost, point.recall, [[low], [high]], label=point.name, elinewidth=0.9, **kind)
    axes.grid(True)
    return [point.name for point in best]
