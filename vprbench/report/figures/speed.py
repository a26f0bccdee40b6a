"""Training time and query rate of each row beside published ones."""

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

from vprbench.report.figures import style
from vprbench.report.figures.captions import choose_runs, describe_timed_runs
from vprbench.report.figures.style import Drawing, choose_looks, new_figure, use_style
from vprbench.report.plan import PlannedColumn, Row
from vprbench.report.published import Published
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
    printed = {key: 60 * minutes for key, minutes in _list_published(published, column, "train").items()}
    figure = _draw_bars(series, rows, _measure_training, printed, "Training time (s)", column.title)
    quoted = ", ".join(row.name for row in rows if row.training == "pretrained")
    caption = (
        f"Training time on {column.title}. Bars: without waiting for images to be read; ticks and brackets: with it. "
        "Of several seeds the median, and a line from lowest to highest. "
        f"{_describe_published(published, column, f'quoted there: {quoted}')}{describe_timed_runs(series)}"
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
    printed = _list_published(published, column, "query")
    figure = _draw_bars(series, rows, _measure_rate, printed, "Queries per second, encode and match", column.title)
    steps = ", ".join(f"{row.name} {row.boundary}" for row in rows if row.boundary)
    caption = (
        f"Queries per second on {column.title}, one query from memory, encode and match: 1 / median. Lines over bars: "
        "the middle 80 % of queries; of several seeds, whose mean is the bar, from lowest to highest. "
        f"{_describe_published(published, column, f'of one step: {steps}')}{describe_timed_runs(series)}"
    )
    return Drawing(figure, caption)


def _list_published(published: Published | None, column: PlannedColumn, quantity: str) -> dict[tuple[str, str], float]:
    """Return the published numbers of a quantity, "train" or "query", by row and device, "cpu" or "gpu"."""
    return {
        (row, device): value
        for (row, dataset), numbers in (published.numbers if published else {}).items()
        for device in ("cpu", "gpu")
        if dataset == column.published and (value := numbers.get(f"{quantity}_{device}"))
    }


def _describe_published(published: Published | None, column: PlannedColumn, more: str) -> str:
    """Return a sentence on the published bars, and a space; empty where there are none."""
    if published is None or column.published is None:
        return ""
    real = f" on {column.published}, for which this dataset stands in" if column.stand_in_for else ""
    return f"Hatched bars: {published.source}{real}, measured on {published.cpu} and {published.gpu}; {more}. "


def _draw_bars(
    series: Sequence[MethodRuns],
    rows: Sequence[Row],
    measure: Callable[[Row, Sequence[Run]], _Bar | None],
    printed: Mapping[tuple[str, str], float],
    label: str,
    title: str,
) -> Figure:
    """Draw a bar for each row, and below it the published bar; a panel for each kind of device, on the same axis."""
    devices: dict[str, dict[str, Sequence[Run]]] = {}
    for one in series:
        device = "cpu" if one.runs[0].config["device"] == "cpu" else "gpu"
        devices.setdefault(device, {})[one.name] = one.runs
    width = style.SINGLE_MM if len(devices) == 1 else style.DOUBLE_MM
    figure, panels = new_figure(width, 19 + 9 * len(rows), 1, len(devices), sharex=True, sharey=True)
    looks = choose_looks(row.name for row in rows)
    keys: dict[str, Any] = {"measured here": Patch(color=style.GREY)}
    ends: list[float] = []
    for axes, (device, runs) in zip(panels, devices.items(), strict=True):
        for place, row in enumerate(rows):
            if bar := measure(row, runs.get(row.name, ())):
                _draw_measured(axes, place - _BAR / 2, bar, looks[row.name].colour)
                ends += [bar.low, bar.high, bar.wall]
                if bar.wall:
                    keys["with reading the images"] = Line2D([], [], color="black", marker="|", ls="none", markersize=8)
            else:
                axes.text(0.02, place - _BAR / 2, "none", transform=axes.get_yaxis_transform(), color=style.GREY)
            if value := printed.get((row.name, device)):
                hatched = {**looks[row.name].of_bar, "hatch": _HATCH}
                axes.barh(place + _BAR / 2, value, _BAR, linewidth=0.8, **hatched)
                _write_number(axes, value, place + _BAR / 2, format_three_digits(value), style.GREY)
                ends.append(value)
                keys["published"] = Patch(facecolor="white", edgecolor=style.GREY, hatch=_HATCH)
        axes.set(xlabel=label, ylim=(len(rows) - 0.4, -0.6), title=device.upper())
    panels[0].set_yticks(range(len(rows)), [fill(row.name, _LETTERS) for row in rows])
    for axes in panels:
        axes.tick_params(axis="y", length=0)
        style.scale_log(axes, "x", ends or [1.0], _ROOM)
    for name, key in keys.items():
        key.set_label(name)
    style.add_legend(figure, [*keys.values()], title)
    return figure


def _measure_training(row: Row, runs: Sequence[Run]) -> _Bar | None:
    """Return the bar of a row; None for a row that trained nothing here."""
    compute = [run.fit_compute_seconds for run in runs if run.fit_compute_seconds is not None]
    if not row.learns_here or not compute:
        return None
    wall = median(run.fit_seconds for run in runs if run.fit_seconds is not None)
    return _Bar(median(compute), min(compute), max(compute), wall)


def _measure_rate(row: Row, runs: Sequence[Run]) -> _Bar | None:
    """Return the bar of a row; None for a row without a run."""
    rates = list(map(compute_rate, runs))
    if len(rates) == 1:
        low, high = 1 / np.quantile(list_laps(runs[0]), [0.9, 0.1])
        return _Bar(rates[0], float(low), float(high))
    return _Bar(mean(rates), min(rates), max(rates)) if rates else None


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
