"""What accuracy costs: R@1 against query rate and against memory, with the methods that no other one beats in both."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import mean

from matplotlib.axes import Axes

from vprbench.errors import BadInput
from vprbench.metrics.intervals import Interval
from vprbench.paper.figures.label_places import Label, place_labels
from vprbench.paper.figures.log_axis import plain_log
from vprbench.paper.figures.measured_on import caption, closing, listed, tuned_sentence
from vprbench.paper.figures.same_data import one_dataset
from vprbench.paper.figures.style import DOUBLE_MM, GREY, SINGLE_MM, Drawn, looks, new, styled
from vprbench.paper.selection import Series
from vprbench.paper.table import best as contests
from vprbench.run.recall_intervals import METHOD, recall_interval
from vprbench.run.record import Run

_HEIGHT_MM = 68.0
_MB = 1e6


@dataclass(frozen=True)
class _Point:
    """One method: R@1 in %, and what it takes."""

    name: str
    cost: float
    recall: float
    interval: Interval


@styled
def against_rate(series: Sequence[Series]) -> Drawn:
    """Draw R@1 against queries per second, encode and match together: up and right is better.

    Raises BadInput for no rows, for rows on different data and where no query has a right place.
    """
    points = _points(series, "accuracy against query rate", lambda run: contests.rate(run, None))
    figure, (axes,) = new(SINGLE_MM, _HEIGHT_MM)
    _draw(axes, points, "Queries per second, encode and match", lower_is_better=False)
    return Drawn(
        figure,
        caption(
            "R@1 against queries per second, one query at a time from memory, encode and match together; "
            "right and up is better, the rates are on a logarithmic axis.",
            _front_sentence(points, lower_is_better=False),
            *_closing(series),
        ),
    )


@styled
def against_memory(series: Sequence[Series]) -> Drawn:
    """Draw R@1 against the peak memory, and against the bytes that a place of the map takes where runs hold them.

    Left and up is better. Raises BadInput for no rows, for rows on different data and where no query has a right place.
    """
    peak = _points(series, "accuracy against memory", lambda run: run.peak_memory_bytes / _MB)
    kept = [one for one in series if all((run.search or {}).get("bytes_per_place") for run in one.runs)]
    maps = _points(kept, "accuracy against map size", lambda run: (run.search or {})["bytes_per_place"]) if kept else []
    figure, all_axes = new(DOUBLE_MM if maps else SINGLE_MM, _HEIGHT_MM, 1, 2 if maps else 1)
    _draw(all_axes[0], peak, "Peak memory (MB)", lower_is_better=True)
    if maps:
        _draw(all_axes[1], maps, "Map (bytes per place)", lower_is_better=True)
    return Drawn(
        figure,
        caption(
            "R@1 against memory, which is on a logarithmic axis; left and up is better.",
            "Peak memory is the most main memory that the whole process held, libraries and harness included.",
            _on_gpu(series),
            _front_sentence(peak, lower_is_better=True),
            f"On the right, what the map keeps of a place, of {listed(point.name for point in maps)}: the other rows "
            "keep no descriptors."
            if maps
            else "",
            *_closing(series),
        ),
    )


def front(costs: Sequence[float], gains: Sequence[float]) -> list[int]:
    """Return which points no other one beats, the cheapest first: at no more cost at least as good, and better in one.

    Of equal points all are returned.
    """
    order = sorted(range(len(costs)), key=lambda i: (costs[i], -gains[i]))
    kept: list[int] = []
    for i in order:
        if not kept or gains[i] > gains[kept[-1]] or (costs[i], gains[i]) == (costs[kept[-1]], gains[kept[-1]]):
            kept.append(i)
    return kept


def _points(series: Sequence[Series], figure: str, cost: Callable[[Run], float]) -> list[_Point]:
    one_dataset(series, figure)
    return [_point(one, mean(map(cost, one.runs)), figure) for one in series]


def _point(one: Series, cost: float, figure: str) -> _Point:
    interval = recall_interval(one.runs)
    if interval is None:
        raise BadInput(
            f"the figure of {figure} has nothing to draw: no query of {one.runs[0].dataset} has a right place"
        )
    recall = 100 * (contests.mean_recall(one.runs) or 0.0)
    return _Point(one.name, cost, recall, Interval(100 * interval.low, 100 * interval.high))


def _draw(axes: Axes, points: Sequence[_Point], label: str, lower_is_better: bool) -> None:
    plain_log(axes, "x", [point.cost for point in points], 3, 3)
    lowest, highest = min(point.interval.low for point in points), max(point.interval.high for point in points)
    room = 0.08 * (highest - lowest)
    axes.set(xlabel=label, ylabel="R@1 (%)", ylim=(max(lowest - room, 0), min(highest + room, 100)))
    best = front(*_costs_and_gains(points, lower_is_better))
    steps = [(points[best[0]].cost, points[best[0]].recall)]
    for i in best[1:]:
        steps += [(points[i].cost, steps[-1][1]), (points[i].cost, points[i].recall)]
    steps.append((axes.get_xlim()[1 if lower_is_better else 0], steps[-1][1]))
    axes.plot(*zip(*steps, strict=True), color=GREY, linewidth=0.9, zorder=1)
    for name, look in looks([point.name for point in points]).items():
        point = next(each for each in points if each.name == name)
        axes.errorbar(
            point.cost,
            point.recall,
            [[max(point.recall - point.interval.low, 0)], [max(point.interval.high - point.recall, 0)]],  # rounding
            color=look.colour,
            marker=look.marker,
            elinewidth=0.9,
        )
    axes.grid(True)
    place_labels(axes, [Label(each.name, each.cost, each.recall, each.interval) for each in points], steps)


def _costs_and_gains(points: Sequence[_Point], lower_is_better: bool) -> tuple[list[float], list[float]]:
    sign = 1 if lower_is_better else -1
    return [sign * point.cost for point in points], [point.recall for point in points]


def _front_sentence(points: Sequence[_Point], lower_is_better: bool) -> str:
    best = front(*_costs_and_gains(points, lower_is_better))
    names = [points[i].name for i in best]
    return f"The grey steps are the Pareto front: no other row beats {listed(names)} in both."


def _on_gpu(series: Sequence[Series]) -> str:
    """Say that the memory of a GPU is not counted, where rows ran on one."""
    names = [one.name for one in series if any(run.config["device"] != "cpu" for run in one.runs)]
    return f"{listed(names)} ran on a GPU, whose own memory is not in it." if names else ""


def _closing(series: Sequence[Series]) -> tuple[str, ...]:
    return (
        f"Bars are 95 % intervals of R@1: {METHOD}.",
        *closing(series, "means over the seeds, the bar is that of the mean hits"),
        tuned_sentence(series),
    )
