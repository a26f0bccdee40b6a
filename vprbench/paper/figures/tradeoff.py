"""What accuracy costs: R@1 against query rate and against memory, with the methods that no other one beats in both."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from statistics import mean

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.transforms import Bbox

from vprbench.errors import BadInput
from vprbench.metrics.intervals import Interval
from vprbench.paper.figures.captions import (
    INTERVALS,
    describe_runs,
    join_facts,
    list_names,
    require_one_dataset,
    split_timed,
)
from vprbench.paper.figures.style import DOUBLE_MM, GREY, SINGLE_MM, Drawn, legend_above, looks, new, plain_log, styled
from vprbench.paper.selection import Series
from vprbench.paper.table import best as contests
from vprbench.runs.recall_intervals import recall_interval
from vprbench.runs.record import Run

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

    Rows that were not timed are left out. Raises BadInput for no timed rows, for rows on different data and if no query
    has a right place.
    """
    kept, untimed = split_timed(series)
    if not kept and untimed:
        raise BadInput("the figure of accuracy against query rate has no timed runs to draw: run with timing=quick")
    points = _points(kept, "accuracy against query rate", contests.compute_rate)
    figure, (axes,) = new(SINGLE_MM, _HEIGHT_MM)
    best = _draw(axes, points, "Queries per second, encode and match", lower_is_better=False)
    _legend_if_crowded(figure)
    caption = join_facts(
        "R@1 against queries per second, one query from memory, encode and match; up and right is better.",
        list_names("Not timed", untimed),
        _describe_front(best, kept),
    )
    return Drawn(figure, caption)


@styled
def against_memory(series: Sequence[Series]) -> Drawn:
    """Draw R@1 against the peak memory, and against the bytes that a place of the map takes if runs hold them.

    Left and up is better. Raises BadInput for no rows, for rows on different data and if no query has a right place.
    """
    peak = _points(series, "accuracy against memory", lambda run: run.peak_memory_bytes / _MB)
    kept = [one for one in series if all((run.search or {}).get("bytes_per_place") for run in one.runs)]
    maps = _points(kept, "accuracy against map size", lambda run: (run.search or {})["bytes_per_place"]) if kept else []
    figure, all_axes = new(DOUBLE_MM if maps else SINGLE_MM, _HEIGHT_MM, 1, 2 if maps else 1)
    best = _draw(all_axes[0], peak, "Peak memory (MB)", lower_is_better=True)
    if maps:
        _draw(all_axes[1], maps, "Map (bytes per place)", lower_is_better=True)
    _legend_if_crowded(figure)
    on_gpu = [one.name for one in series if any(run.config["device"] != "cpu" for run in one.runs)]
    caption = join_facts(
        "R@1 against the peak main memory of the whole process, libraries included; up and left is better.",
        list_names("On a GPU, whose memory is not in it", on_gpu),
        "Right: bytes of the map per place, of rows that keep descriptors." if maps else "",
        _describe_front(best, series),
    )
    return Drawn(figure, caption)


def _describe_front(best: Sequence[str], series: Sequence[Series]) -> str:
    """Return the facts that both figures share; `best` names the rows of the front."""
    ending = describe_runs(series, "means, the bar is of mean hits", of_times=True)
    return f"Grey steps: Pareto front ({', '.join(best)}). Bars: {INTERVALS}. {ending}"


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
    require_one_dataset(series, figure)
    return [_point(one, mean(map(cost, one.runs)), figure) for one in series]


def _point(one: Series, cost: float, figure: str) -> _Point:
    interval = recall_interval(one.runs)
    if interval is None:
        raise BadInput(
            f"the figure of {figure} has nothing to draw: no query of {one.runs[0].dataset} has a right place"
        )
    recall = 100 * (contests.average_recall(one.runs) or 0.0)
    return _Point(one.name, cost, recall, Interval(100 * interval.low, 100 * interval.high))


def _draw(axes: Axes, points: Sequence[_Point], label: str, lower_is_better: bool) -> list[str]:
    """Draw points and their front; returns the names on the front."""
    plain_log(axes, "x", [point.cost for point in points], 3, 3)
    lowest, highest = min(point.interval.low for point in points), max(point.interval.high for point in points)
    room = 0.08 * (highest - lowest)
    axes.set(xlabel=label, ylabel="R@1 (%)", ylim=(max(lowest - room, 0), min(highest + room, 100)))
    sign = 1 if lower_is_better else -1
    best = front([sign * point.cost for point in points], [point.recall for point in points])
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
            linestyle="none",
            label=name,
        )
    axes.grid(True)
    place_labels(axes, [Label(each.name, each.cost, each.recall, each.interval) for each in points], steps)
    return [points[i].name for i in best]


def _legend_if_crowded(figure: Figure) -> None:
    """Name the points in a legend, and nowhere else, if a panel has no room for all names."""
    if all(axes.texts for axes in figure.axes):
        return
    for text in [text for axes in figure.axes for text in axes.texts]:
        text.remove()
    legend_above(figure, figure.axes[0].get_legend_handles_labels()[0])


_SIZE = 7  # of the type, in points
_MARKER = 3.0  # half of a marker's width, in points
_DIRECTIONS = ((1, 0), (-1, 0), (1, 1), (-1, 1), (1, -1), (-1, -1), (0, 1), (0, -1))  # right first
_DISTANCES = (5.0, 10.0, 18.0, 28.0, 40.0, 55.0)  # from the point, in points
_BESIDE = 10.0  # up to here no line leads to the point
_NOTHING = 1e-6  # square pixels
_GAP = 3.0  # between two names side by side, in points


@dataclass(frozen=True)
class Label:
    """A name, the point that it belongs to, and the ends of the point's upright bar."""

    text: str
    x: float
    y: float
    bar: Interval


def place_labels(axes: Axes, labels: Sequence[Label], steps: Sequence[tuple[float, float]] = ()) -> bool:
    """Write each label at the nearest free place around its point; a thin line leads to one that stands far off.

    `steps` are the corners of a line that labels keep off, whose parts run along the axes. Call it when all else is
    drawn and the limits of the axes are set. Returns False, with nothing written, if no place is free for a label.
    """
    figure = axes.get_figure(root=True)
    assert figure is not None  # axes are made by style.new, on a figure
    figure.draw_without_rendering()  # settles where the axes stand
    pixels = figure.dpi / 72  # of a point
    taken = [box for label in labels for box in _boxes_of_point(axes, label, pixels)]
    taken += _parts(axes, steps, pixels)
    places: list[tuple[Label, float, tuple[float, float]]] = []
    for label in labels:
        written = axes.annotate(label.text, (label.x, label.y), fontsize=_SIZE)
        size = written.get_window_extent()
        written.remove()
        x, y = axes.transData.transform((label.x, label.y))
        candidates = _candidates(x, y, size.width, size.height, pixels)
        free = (each for each in candidates if _covered(each[2], taken) + _outside(each[2], axes.bbox) < _NOTHING)
        found = next(free, None)
        if found is None:
            return False
        distance, corner, box = found
        taken.append(box.padded(_GAP * pixels, 0))
        places.append((label, distance, ((corner[0] - x) / pixels, (corner[1] - y) / pixels)))
    for label, distance, offset in places:
        axes.annotate(
            label.text,
            (label.x, label.y),
            offset,
            textcoords="offset points",
            fontsize=_SIZE,
            in_layout=False,
            arrowprops={"arrowstyle": "-", "color": GREY, "linewidth": 0.5} if distance > _BESIDE else None,
        )
    return True


def _boxes_of_point(axes: Axes, label: Label, pixels: float) -> Iterator[Bbox]:
    """Yield the boxes of a point and of its bar."""
    (x, y), (_, low), (_, high) = axes.transData.transform(
        [(label.x, label.y), (label.x, label.bar.low), (label.x, label.bar.high)]
    )
    half = _MARKER * pixels
    yield Bbox.from_extents(x - half, y - half, x + half, y + half)
    yield Bbox.from_extents(x - half / 2, low, x + half / 2, high)


def _parts(axes: Axes, steps: Sequence[tuple[float, float]], pixels: float) -> Iterator[Bbox]:
    """Yield the boxes of the parts of a line."""
    for start, end in pairwise(map(axes.transData.transform, steps)):
        yield Bbox([np.minimum(start, end), np.maximum(start, end)]).padded(pixels)


def _candidates(
    x: float, y: float, width: float, height: float, pixels: float
) -> Iterator[tuple[float, tuple[float, float], Bbox]]:
    """Yield distance, lower left corner and box of each place for a label, the nearest first."""
    for distance in _DISTANCES:
        for right, up in _DIRECTIONS:
            left = x + right * distance * pixels - width * (1 - right) / 2
            bottom = y + up * distance * pixels - height * (1 - up) / 2
            yield distance, (left, bottom), Bbox.from_bounds(left, bottom, width, height)


def _covered(box: Bbox, taken: Sequence[Bbox]) -> float:
    overlaps = (Bbox.intersection(box, other) for other in taken)
    return sum(overlap.width * overlap.height for overlap in overlaps if overlap is not None)


def _outside(box: Bbox, inside: Bbox) -> float:
    within = Bbox.intersection(box, inside)
    return box.width * box.height - (within.width * within.height if within is not None else 0)
