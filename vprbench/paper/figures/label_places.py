"""Names beside the points of a scatter plot, where they cover neither points nor lines nor one another."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from matplotlib.axes import Axes
from matplotlib.transforms import Bbox

from vprbench.metrics.intervals import Interval
from vprbench.paper.figures.style import GREY

_SIZE = 7  # of the type, in points
_MARKER = 3.0  # half of a marker's width, in points
_DIRECTIONS = ((1, 0), (-1, 0), (1, 1), (-1, 1), (1, -1), (-1, -1), (0, 1), (0, -1))  # right first
_DISTANCES = (5.0, 10.0, 18.0, 28.0, 40.0, 55.0)  # from the point, in points
_BESIDE = 10.0  # up to here no line leads to the point
_NOTHING = 1e-6  # square pixels


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
    taken = [box for label in labels for box in _drawn(axes, label, pixels)]
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
        taken.append(box)
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


def _drawn(axes: Axes, label: Label, pixels: float) -> Iterator[Bbox]:
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
