"""Training time and query rate of each row beside published ones."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import mean, median
from textwrap import fill
from typing import Any, Literal, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke

from vprbench.report.figures import style
from vprbench.report.figures.captions import choose_runs, describe_runs
from vprbench.report.figures.style import Drawing, choose_looks, new_figure, use_style
from vprbench.report.plan import PlannedColumn, Published, Row
from vprbench.report.selection import MethodRuns
from vprbench.report.table.best import compute_rate, list_laps
from vprbench.runs.record import Run
from vprbench.text import format_three_digits

_BAR = 0.38  # of the distance between rows
_LETTERS = 22  # of a line of a row's name
_ROOM = 5.0  # times the shortest and the longest bar, for the numbers beside them
_HATCH = "//////"  # of published bars
_LABELS = {"train": "Training time (s)", "query": "Queries per second, encode and match"}
_PUBLISHED = {"train": "published", "query": "published, of one step alone"}
_WORDS: dict[str, Any] = {"color": style.GREY, "style": "italic", "fontsize": 7, "va": "center"}
_LINES: dict[str, Any] = {  # seen on a dark bar too
    "color": "black",
    "solid_capstyle": "butt",
    "path_effects": [withStroke(linewidth=3, foreground="white")],
}

Quantity = Literal["train", "query"]  # as published numbers are named, before the device


class _Bar(NamedTuple):
    """The number of one row on one kind of device, the ends of its line, and the wall time of training; 0: none."""

    value: float
    low: float
    high: float
    wall: float = 0.0


@use_style
def draw_training_time(
    series: Sequence[MethodRuns], rows: Sequence[Row], column: PlannedColumn, published: Published | None = None
) -> Drawing:
    """Draw the seconds of training of each row, measured above published, a panel for each kind of device with runs.

    A bar is the time without waiting for images, a tick the wall time. Raises BadInput if there is no run.
    """
    series = choose_runs(series, lambda _: True, f"is of {column.title}")
    figure = _draw_bars("train", series, rows, column, published)
    quoted = ", ".join(row.name for row in rows if row.training == "pretrained")
    caption = (
        f"Training time on {column.title}. Bars: without waiting for images to be read; ticks and brackets: with it. "
        f"{_describe_published(published, column, f'; quoted there: {quoted}' if quoted else '')}"
        f"{describe_runs(series, 'median, and a line from lowest to highest', of_times=True)}"
    )
    return Drawing(figure, caption)


@use_style
def draw_query_rate(
    series: Sequence[MethodRuns], rows: Sequence[Row], column: PlannedColumn, published: Published | None = None
) -> Drawing:
    """Draw the queries per second of each row, measured above published, a panel for each kind of device with runs.

    A measured bar is of encode and match together. Raises BadInput if no run was timed.
    """
    series = choose_runs(series, lambda run: run.timing, f"of {column.title} was timed: run with timing=quick")
    figure = _draw_bars("query", series, rows, column, published)
    steps = ", ".join(f"{row.name} {row.boundary}" for row in rows if row.boundary)
    caption = (
        f"Queries per second on {column.title}, one query from memory, encode and match: 1 / median. "
        f"{_describe_published(published, column, f'; of one step: {steps}')}"
        "Line over a bar of one seed: the middle 80 % of its queries. "
        f"{describe_runs(series, 'mean, and a line from lowest to highest', of_times=True)}"
    )
    return Drawing(figure, caption)


def _describe_published(published: Published | None, column: PlannedColumn, more: str) -> str:
    """Return a sentence on the published bars, and a space; empty where there are none."""
    if published is None or column.published is None:
        return ""
    real = f" on {column.published}, for which this dataset stands in" if column.stand_in_for else ""
    return f"Hatched bars: {published.source}{real}, measured on {published.cpu} and {published.gpu}{more}. "


def _draw_bars(
    quantity: Quantity,
    series: Sequence[MethodRuns],
    rows: Sequence[Row],
    column: PlannedColumn,
    published: Published | None,
) -> Figure:
    """Draw a bar or a word for each row, and below it the published bar; all panels share the axis."""
    devices: dict[str, dict[str, Sequence[Run]]] = {}
    for one in series:
        device = "cpu" if one.runs[0].config["device"] == "cpu" else "gpu"
        devices.setdefault(device, {})[one.name] = one.runs
    width = style.SINGLE_MM if len(devices) == 1 else style.DOUBLE_MM
    figure, panels = new_figure(width, 19 + 9 * len(rows), 1, len(devices))
    looks = choose_looks(row.name for row in rows)
    ends: list[float] = []
    numbers = published.numbers if published else {}
    for axes, (device, runs) in zip(panels, devices.items(), strict=True):
        for place, row in enumerate(rows):
            bar = _MEASURES[quantity](row, runs.get(row.name, ()))
            if isinstance(bar, str):
                axes.text(0.02, place - _BAR / 2, bar, transform=axes.get_yaxis_transform(), **_WORDS)
            else:
                _draw_measured(axes, place - _BAR / 2, bar, looks[row.name].colour)
                ends += [bar.low, bar.high, bar.wall]
            printed = numbers.get((row.name, column.published or ""), {}).get(f"{quantity}_{device}")
            if printed:
                value = printed * (60 if quantity == "train" else 1)  # minutes and hertz
                axes.barh(place + _BAR / 2, value, _BAR, linewidth=0.8, **{**looks[row.name].of_bar, "hatch": _HATCH})
                _write_number(axes, value, place + _BAR / 2, format_three_digits(value), style.GREY)
                ends.append(value)
        axes.set(xlabel=_LABELS[quantity], ylim=(len(rows) - 0.4, -0.6), title=device.upper())
        axes.set_yticks(range(len(rows)), [fill(row.name, _LETTERS) for row in rows] if axes is panels[0] else [])
        axes.tick_params(axis="y", length=0)
    for axes in panels:
        style.scale_log(axes, "x", ends or [1.0], _ROOM)
    keys: list[Any] = [Patch(color=style.GREY, label="measured here")]
    if any(bar.get_hatch() for axes in panels for bar in axes.patches):
        keys.append(Patch(facecolor="white", edgecolor=style.GREY, hatch=_HATCH, label=_PUBLISHED[quantity]))
    if quantity == "train":
        keys.append(Line2D([], [], color="black", marker="|", ls="none", markersize=8, label="with reading the images"))
    style.add_legend(figure, keys, column.title)
    return figure


def _measure_training(row: Row, runs: Sequence[Run]) -> _Bar | str:
    """Return the bar of a row, or the words in its place."""
    if not row.learns_here:
        return "no training" if row.training == "none" else "comes trained"
    seconds = [run.fit_compute_seconds for run in runs if run.fit_compute_seconds is not None]
    if not seconds:
        return "network loaded" if any(run.network is not None for run in runs) else "no run"
    wall = median(run.fit_seconds for run in runs if run.fit_seconds is not None)
    return _Bar(median(seconds), min(seconds), max(seconds), wall)


def _measure_rate(row: Row, runs: Sequence[Run]) -> _Bar | str:
    """Return the bar of a row, or the words in its place."""
    rates = list(map(compute_rate, runs))
    if len(rates) == 1:
        low, high = 1 / np.quantile(list_laps(runs[0]), [0.9, 0.1])
        return _Bar(rates[0], float(low), float(high))
    return _Bar(mean(rates), min(rates), max(rates)) if rates else "no run"


_MEASURES = {"train": _measure_training, "query": _measure_rate}


def _draw_measured(axes: Axes, place: float, bar: _Bar, colour: str) -> None:
    axes.barh(place, bar.value, _BAR, color=colour, edgecolor="black", linewidth=0.5)
    if bar.low < bar.high:
        axes.plot([bar.low, bar.high], [place, place], linewidth=1.0, **_LINES)
    if bar.wall:
        axes.plot([bar.wall, bar.wall], [place - _BAR / 2, place + _BAR / 2], linewidth=1.8, **_LINES)
    text = format_three_digits(bar.value) + (f" ({format_three_digits(bar.wall)})" if bar.wall > bar.high else "")
    _write_number(axes, max(bar.wall, bar.high), place, text, "black")


def _write_number(axes: Axes, x: float, y: float, text: str, colour: str) -> None:
    axes.annotate(text, (x, y), (4, 0), textcoords="offset points", va="center", fontsize=7, color=colour)
