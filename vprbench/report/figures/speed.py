"""Training time and query rate of each row beside published ones."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import mean, median
from textwrap import fill
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke

from vprbench.report.figures import style
from vprbench.report.figures.captions import choose_runs, describe_timed_runs
from vprbench.report.figures.style import Drawing, choose_looks, new_figure, use_style
from vprbench.report.plan import Column, Published, Row
from vprbench.report.selection import MethodRuns
from vprbench.report.table.best import compute_rate, list_laps
from vprbench.runs.record import Run
from vprbench.text import format_three_digits

_BAR = 0.38  # of the distance between rows
_LETTERS = 22  # of a line of a row's name
_ROOM = 5.0  # times the shortest and the longest bar, for the numbers beside them
_HATCH = "//////"  # of published bars
_LINES: dict[str, Any] = {  # seen on a dark bar too
    "color": "black",
    "solid_capstyle": "butt",
    "path_effects": [withStroke(linewidth=3, foreground="white")],
}


Bar = tuple[float, float, float, float]  # its end, the ends of the line over it, and the wall time of training; 0: none


@use_style
def draw_training_time(
    series: Sequence[MethodRuns], rows: Sequence[Row], column: Column, published: Published | None = None
) -> Drawing:
    """Draw the seconds of training of each row, measured above published, a panel for each kind of device with runs.

    A bar is the time without waiting for images, a tick the wall time. Raises BadInput if there is no run.
    """
    series = choose_runs(series, lambda _: True, f"is of {column.title}")
    figure = _draw_bars("train", series, rows, column, published)
    quoted = ", ".join(row.name for row in rows if row.training == "pretrained")
    caption = (
        f"Training time on {column.title}. Bars: without waiting for images to be read; ticks and brackets: with it. "
        "Of several seeds the median, and a line from lowest to highest. "
        f"{_describe_published(published, column, f'quoted there: {quoted}')}{describe_timed_runs(series)}"
    )
    return Drawing(figure, caption)


@use_style
def draw_query_rate(
    series: Sequence[MethodRuns], rows: Sequence[Row], column: Column, published: Published | None = None
) -> Drawing:
    """Draw the queries per second of each row, measured above published, a panel for each kind of device with runs.

    A measured bar is of encode and match together. Raises BadInput if no run was timed.
    """
    series = choose_runs(series, lambda run: run.timing, f"of {column.title} was timed: run with timing=quick")
    figure = _draw_bars("query", series, rows, column, published)
    steps = ", ".join(f"{row.name} {row.boundary}" for row in rows if row.boundary)
    caption = (
        f"Queries per second on {column.title}, one query from memory, encode and match: 1 / median. Lines over bars: "
        "the middle 80 % of queries; of several seeds, whose mean is the bar, from lowest to highest. "
        f"{_describe_published(published, column, f'of one step: {steps}')}{describe_timed_runs(series)}"
    )
    return Drawing(figure, caption)


def _describe_published(published: Published | None, column: Column, more: str) -> str:
    """Return a sentence on the published bars, and a space; empty where there are none."""
    if published is None or column.published is None:
        return ""
    real = f" on {column.published}, for which this dataset stands in" if column.stand_in_for else ""
    return f"Hatched bars: {published.source}{real}, measured on {published.cpu} and {published.gpu}; {more}. "


def _draw_bars(
    quantity: Literal["train", "query"],
    series: Sequence[MethodRuns],
    rows: Sequence[Row],
    column: Column,
    published: Published | None,
) -> Figure:
    """Draw a bar for each row, and below it the published bar; a panel for each kind of device, on the same axis."""
    devices: dict[str, dict[str, Sequence[Run]]] = {}
    for one in series:
        device = "cpu" if one.runs[0].config["device"] == "cpu" else "gpu"
        devices.setdefault(device, {})[one.name] = one.runs
    width = style.SINGLE_MM if len(devices) == 1 else style.DOUBLE_MM
    figure, panels = new_figure(width, 19 + 9 * len(rows), 1, len(devices), sharex=True, sharey=True)
    looks = choose_looks(row.name for row in rows)
    label, measure, unit, hatched = _QUANTITIES[quantity]
    numbers = published.numbers if published else {}
    keys: dict[str, Any] = {"measured here": Patch(color=style.GREY)}
    ends: list[float] = []
    for axes, (device, runs) in zip(panels, devices.items(), strict=True):
        for place, row in enumerate(rows):
            look, y = looks[row.name], place - _BAR / 2
            if (value := measure(row, runs.get(row.name, ()))) is None:
                axes.text(0.02, y, "none", va="center", transform=axes.get_yaxis_transform(), color=style.GREY)
            else:
                middle, low, high, wall = value
                axes.barh(y, middle, _BAR, color=look.colour, edgecolor="black", linewidth=0.5)
                if low < high:
                    axes.plot([low, high], [y, y], linewidth=1.0, **_LINES)
                text = format_three_digits(middle)
                if wall:
                    axes.plot([wall, wall], [y - _BAR / 2, y + _BAR / 2], linewidth=1.8, **_LINES)
                    keys["with reading the images"] = Line2D([], [], color="black", marker="|", ls="none", markersize=8)
                    text += f" ({format_three_digits(wall)})" * (wall > high)
                ends += [low, high, wall]
                _write_number(axes, max(wall, high), y, text, "black")
            if printed := numbers.get((row.name, column.published or ""), {}).get(f"{quantity}_{device}"):
                axes.barh(y + _BAR, unit * printed, _BAR, linewidth=0.8, **{**look.of_bar, "hatch": _HATCH})
                _write_number(axes, unit * printed, y + _BAR, format_three_digits(unit * printed), style.GREY)
                ends.append(unit * printed)
                keys[hatched] = Patch(facecolor="white", edgecolor=style.GREY, hatch=_HATCH)
        axes.set(xlabel=label, ylim=(len(rows) - 0.4, -0.6), title=device.upper())
        axes.set_yticks(range(len(rows)), [fill(row.name, _LETTERS) for row in rows])
        axes.tick_params(axis="y", length=0)
    style.scale_log(panels[0], "x", ends or [1.0], _ROOM)
    for name, key in keys.items():
        key.set_label(name)
    style.add_legend(figure, [*keys.values()], column.title)
    return figure


def _measure_training(row: Row, runs: Sequence[Run]) -> Bar | None:
    """Return the seconds of a row; None for a row that trained nothing here."""
    fits = [run for run in runs if run.fit_compute_seconds is not None]
    if not row.learns_here or not fits:
        return None
    compute = [run.fit_compute_seconds or 0.0 for run in fits]
    return median(compute), min(compute), max(compute), median(run.fit_seconds or 0.0 for run in fits)


def _measure_rate(row: Row, runs: Sequence[Run]) -> Bar | None:
    """Return the queries per second of a row; None for a row without a run."""
    rates = list(map(compute_rate, runs))
    if len(rates) == 1:
        slow, fast = np.quantile(list_laps(runs[0]), [0.9, 0.1])
        return rates[0], 1 / float(slow), 1 / float(fast), 0.0
    return (mean(rates), min(rates), max(rates), 0.0) if rates else None


def _write_number(axes: Axes, x: float, y: float, text: str, colour: str) -> None:
    axes.annotate(text, (x, y), (4, 0), textcoords="offset points", va="center", fontsize=7, color=colour)


_QUANTITIES = {  # by the names that published numbers have: axis, measure, published unit in that of the axis, key
    "train": ("Training time (s)", _measure_training, 60, "published"),
    "query": ("Queries per second, encode and match", _measure_rate, 1, "published, of one step alone"),
}
