"""Training time and query rate of each row beside what the paper printed: Figures 2A and 2B of the paper."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from statistics import mean, median
from textwrap import fill
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke

from vprbench.errors import BadInput
from vprbench.report.figures import style
from vprbench.report.figures.captions import describe_runs, join_facts, split_timed
from vprbench.report.figures.style import Drawing, Look, choose_looks, new_figure, use_style
from vprbench.report.plan import PlannedColumn, Row
from vprbench.report.published import PAPER, PAPER_CPU, PAPER_GPU, published
from vprbench.report.selection import Series
from vprbench.report.table import best
from vprbench.runs.record import Run
from vprbench.text import format_three_digits

_BAR = 0.38  # of the distance between rows
_LETTERS = 22  # of a line of a row's name
_ROOM = 5.0  # times the shortest and the longest bar, for the numbers beside them
_PUBLISHED, _QUOTED = "//////", "......"  # hatches
_WORDS: dict[str, Any] = {"color": style.GREY, "style": "italic", "fontsize": 7, "va": "center"}

_READING = "with reading the images"
_LINES: dict[str, Any] = {  # seen on a dark bar too
    "color": "black",
    "solid_capstyle": "butt",
    "path_effects": [withStroke(linewidth=3, foreground="white")],
}

Marks = Mapping[tuple[str, str], str]  # the words of the table's cells, by row and quantity


class _Bar(NamedTuple):
    """What was measured of one row on one kind of device."""

    value: float
    low: float
    high: float
    wall: float = 0.0  # of training, with reading the images; 0: none


class _Quantity(NamedTuple):
    """What the bars of a figure show."""

    name: str  # in the paper's table and in marks, before the device
    label: str
    published: str  # the legend's text for the paper's bars
    unit: float  # of the paper's numbers
    measure: Callable[[Row, Sequence[Run], str], _Bar | str]  # a word where no run has the number


@use_style
def draw_training_time(
    cpu: Sequence[Series], gpu: Sequence[Series], rows: Sequence[Row], column: PlannedColumn, marks: Marks
) -> Drawing:
    """Draw the seconds of training of each row, measured above published, a panel for each kind of device with runs.

    A bar is the time without waiting for images, a tick the wall time. `marks` stand in the place of missing bars.
    Raises BadInput if nothing is stored.
    """
    quantity = _Quantity("train", "Training time (s)", "published", 60.0, _measure_training)
    quoted = ", ".join(row.name for row in rows if row.training == "pretrained")
    caption = join_facts(
        f"Training time on {column.title}. Bars: without waiting for images to be read; ticks and brackets: with it.",
        _describe_published(rows, column, f"; quoted there: {quoted}" if quoted else ""),
        describe_runs([*cpu, *gpu], "median, and a line from lowest to highest", of_times=True),
    )
    return Drawing(_draw(quantity, cpu, gpu, rows, column, marks), caption)


@use_style
def draw_query_rate(
    cpu: Sequence[Series], gpu: Sequence[Series], rows: Sequence[Row], column: PlannedColumn, marks: Marks
) -> Drawing:
    """Draw the queries per second of each row, measured above published, a panel for each kind of device with runs.

    A measured bar is of encode and match together. `marks` and what is raised are those of `draw_training_time`; a run
    that was not timed counts as none.
    """
    cpu, gpu = split_timed(cpu)[0], split_timed(gpu)[0]
    label = "Queries per second, encode and match"
    quantity = _Quantity("query", label, "published, of one step alone", 1.0, _measure_rate)
    steps = ", ".join(f"{row.name} {row.boundary}" for row in rows if row.boundary)
    caption = join_facts(
        f"Queries per second on {column.title}, one query from memory, encode and match: 1 / median.",
        _describe_published(rows, column, f"; of one step: {steps}"),
        "Line over a bar of one seed: the middle 80 % of its queries.",
        describe_runs([*cpu, *gpu], "mean, and a line from lowest to highest", of_times=True),
    )
    return Drawing(_draw(quantity, cpu, gpu, rows, column, marks), caption)


def _describe_published(rows: Sequence[Row], column: PlannedColumn, more: str) -> str:
    """Return a sentence on the paper's bars; empty where it has none of these rows."""
    if not any((row.name, column.published) in published() for row in rows):
        return ""
    real = f" on {column.published}, for which this dataset stands in" if column.stand_in_for else ""
    return f"Hatched bars: {PAPER}{real}, measured on {PAPER_CPU} and {PAPER_GPU}{more}."


def _measure_training(row: Row, runs: Sequence[Run], mark: str) -> _Bar | str:
    if not row.learns_here:
        return "no training" if row.training == "none" else "comes trained"
    seconds = [run.fit_compute_seconds for run in runs if run.fit_compute_seconds is not None]
    if not seconds:
        return "network loaded" if any(run.network is not None for run in runs) else mark
    wall = median(run.fit_seconds for run in runs if run.fit_seconds is not None)
    return _Bar(median(seconds), min(seconds), max(seconds), wall)


def _measure_rate(row: Row, runs: Sequence[Run], mark: str) -> _Bar | str:
    if not runs:
        return mark
    rates = list(map(best.compute_rate, runs))
    low, high = min(rates), max(rates)
    if len(runs) == 1:
        low, high = (1 / float(np.quantile(best.list_laps(runs[0]), share)) for share in (0.9, 0.1))
    return _Bar(mean(rates), low, high)


def _draw(
    quantity: _Quantity,
    cpu: Sequence[Series],
    gpu: Sequence[Series],
    rows: Sequence[Row],
    column: PlannedColumn,
    marks: Marks,
) -> Figure:
    devices = {name: {one.name: one.runs for one in shown} for name, shown in (("cpu", cpu), ("gpu", gpu)) if shown}
    if not devices:
        raise BadInput(f"no run on {column.title} is stored that has these times: there is no speed to draw")
    width = style.SINGLE_MM if len(devices) == 1 else style.DOUBLE_MM
    figure, panels = new_figure(width, 19 + 9 * len(rows), 1, len(devices))
    looks = choose_looks(row.name for row in rows)
    ends: list[float] = []
    for axes, (device, runs) in zip(panels, devices.items(), strict=True):
        name = f"{quantity.name}_{device}"
        for place, row in enumerate(rows):
            bar = quantity.measure(row, runs.get(row.name, ()), marks.get((row.name, name), "not run"))
            if isinstance(bar, str):
                axes.text(0.02, place - _BAR / 2, bar, transform=axes.get_yaxis_transform(), **_WORDS)
            else:
                _draw_measured(axes, place - _BAR / 2, bar, looks[row.name])
                ends += [bar.low, bar.high, bar.wall]
            if number := published().get((row.name, column.published or ""), {}).get(name):
                hatch = _QUOTED if quantity.name == "train" and row.training == "pretrained" else _PUBLISHED
                printed = quantity.unit * number
                axes.barh(place + _BAR / 2, printed, _BAR, linewidth=0.8, **{**looks[row.name].of_bar, "hatch": hatch})
                _write(axes, printed, place + _BAR / 2, format_three_digits(printed), style.GREY)
                ends.append(printed)
        axes.set(xlabel=quantity.label, ylim=(len(rows) - 0.4, -0.6), title=device.upper())
        axes.set_yticks(range(len(rows)), [fill(row.name, _LETTERS) for row in rows] if axes is panels[0] else [])
        axes.tick_params(axis="y", length=0)
    for axes in panels:
        style.scale_log(axes, "x", ends or [1.0], _ROOM)
    style.add_legend(figure, _list_keys(panels, quantity.published), column.title)
    return figure


def _draw_measured(axes: Axes, place: float, bar: _Bar, look: Look) -> None:
    axes.barh(place, bar.value, _BAR, color=look.colour, edgecolor="black", linewidth=0.5)
    if bar.low < bar.high:
        axes.plot([bar.low, bar.high], [place, place], linewidth=1.0, **_LINES)
    if bar.wall:
        ends = [place - _BAR / 2, place + _BAR / 2]
        axes.plot([bar.wall, bar.wall], ends, linewidth=1.8, label=_READING, **_LINES)
    text = format_three_digits(bar.value) + (f" ({format_three_digits(bar.wall)})" if bar.wall > bar.high else "")
    _write(axes, max(bar.wall, bar.high), place, text)


def _write(axes: Axes, x: float, y: float, text: str, colour: str = "black") -> None:
    axes.annotate(text, (x, y), (4, 0), textcoords="offset points", va="center", fontsize=7, color=colour)


def _list_keys(panels: Sequence[Axes], published_label: str) -> list[Patch | Line2D]:
    """Return the keys of a legend: only of what is drawn."""
    hatches = {bar.get_hatch() for axes in panels for bar in axes.patches}
    keys: list[Patch | Line2D] = [
        Patch(facecolor="white" if hatch else style.GREY, edgecolor=style.GREY, hatch=hatch, label=label)
        for hatch, label in (
            (None, "measured here"),
            (_PUBLISHED, published_label),
            (_QUOTED, "published, quoted there"),
        )
        if hatch in hatches
    ]
    if any(line.get_label() == _READING for axes in panels for line in axes.lines):
        keys.append(Line2D([], [], color="black", marker="|", linestyle="none", markersize=8, label=_READING))
    return keys
