"""Training time and query rate of each row beside what the paper printed: Figures 2A and 2B of the paper."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from statistics import mean, median
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from vprbench.errors import BadInput
from vprbench.paper.figures.captions import describe_runs, join_facts, split_timed
from vprbench.paper.figures.style import (
    DOUBLE_MM,
    GREY,
    SINGLE_MM,
    Drawn,
    Look,
    looks,
    new,
    plain_log,
    styled,
    wrapped,
)
from vprbench.paper.plan import PlannedColumn, Row
from vprbench.paper.published import PAPER, PAPER_CPU, PAPER_GPU, published
from vprbench.paper.selection import Series
from vprbench.paper.table import best
from vprbench.runs.record import Run
from vprbench.text import format_three_digits

_PUBLISHED, _QUOTED = "//////", "......"  # hatches
_BAR = 0.38  # of the distance between rows
_LETTERS = 22  # of a line of a row's name


@dataclass(frozen=True)
class _Bar:
    """What was measured of one row on one kind of device, or the word that stands in its place."""

    value: float | None = None
    low: float | None = None
    high: float | None = None
    more: float | None = None  # where the tick stands: of training with reading the images
    word: str = ""


@dataclass(frozen=True)
class _Panel:
    """One kind of device."""

    title: str
    measured: Mapping[str, _Bar]  # by row
    published: Mapping[str, float]  # those that the paper has


@styled
def training_time(
    cpu: Sequence[Series],
    gpu: Sequence[Series],
    rows: Sequence[Row],
    column: PlannedColumn,
    marks: Mapping[tuple[str, str], str],
) -> Drawn:
    """Draw the minutes of training of each row, measured above published, a panel for each kind of device with runs.

    A bar is the time without waiting for images, a tick the wall time. `marks` are the words of the table's cells, by
    row and quantity, which stand in the place of a missing bar. Raises BadInput if nothing is stored.
    """
    quantities: tuple[str, str] = ("train_cpu", "train_gpu")
    panels = _panels(cpu, gpu, rows, column, quantities, marks, _minutes)
    quoted = [row.name for row in rows if row.training == "pretrained"]
    figure = _draw(panels, rows, "Training time (min)", _keys(panels, quoted), quoted)
    printed = _describe_published(column, panels, f"; quoted there: {', '.join(quoted)}" if quoted else "")
    caption = join_facts(
        f"Training time on {column.title}. Bars: without waiting for images to be read; ticks and brackets: with it.",
        printed,
        describe_runs([*cpu, *gpu], "median, and a line from lowest to highest", of_times=True),
    )
    return Drawn(figure, caption)


@styled
def query_rate(
    cpu: Sequence[Series],
    gpu: Sequence[Series],
    rows: Sequence[Row],
    column: PlannedColumn,
    marks: Mapping[tuple[str, str], str],
) -> Drawn:
    """Draw the queries per second of each row, measured above published, a panel for each kind of device with runs.

    A measured bar is of encode and match together. `marks` and what is raised are those of `training_time`; a run that
    was not timed counts as none.
    """
    quantities: tuple[str, str] = ("query_cpu", "query_gpu")
    (cpu, _), (gpu, _) = split_timed(cpu), split_timed(gpu)
    panels = _panels(cpu, gpu, rows, column, quantities, marks, _hertz)
    figure = _draw(panels, rows, "Queries per second, encode and match", _keys(panels, (), ", of one step alone"), ())
    printed = {name for panel in panels for name in panel.published}
    steps = [f"{row.name} {row.boundary}" for row in rows if row.boundary and row.name in printed]
    caption = join_facts(
        f"Queries per second on {column.title}, one query from memory, encode and match: 1 / median.",
        _describe_published(column, panels, f"; of one step: {', '.join(steps)}"),
        "Line over a bar of one seed: the middle 80 % of its queries.",
        describe_runs([*cpu, *gpu], "mean, and a line from lowest to highest", of_times=True),
    )
    return Drawn(figure, caption)


def _describe_published(column: PlannedColumn, panels: Sequence[_Panel], more: str) -> str:
    """Return a sentence on the paper's bars, where there are any."""
    if not any(panel.published for panel in panels):
        return ""
    real = f" on {column.published}, for which this dataset stands in" if column.stand_in_for else ""
    return f"Hatched bars: {PAPER}{real}, measured on {PAPER_CPU} and {PAPER_GPU}{more}."


def _minutes(row: Row, runs: Sequence[Run], word: str) -> _Bar:
    if not row.learns_here:
        return _Bar(word="no training" if row.training == "none" else "comes trained")
    minutes = [run.fit_compute_seconds / 60 for run in runs if run.fit_compute_seconds is not None]
    if not minutes:
        return _Bar(word="network loaded" if any(run.network is not None for run in runs) else word)
    wall = median(run.fit_seconds / 60 for run in runs if run.fit_seconds is not None)
    return _Bar(median(minutes), min(minutes), max(minutes), wall)


def _hertz(row: Row, runs: Sequence[Run], word: str) -> _Bar:
    if not runs:
        return _Bar(word=word)
    rates = list(map(best.compute_rate, runs))
    low, high = min(rates), max(rates)
    if len(runs) == 1:
        low, high = (1 / float(np.quantile(best.list_laps(runs[0]), share)) for share in (0.9, 0.1))
    return _Bar(mean(rates), low, high)


def _panels(
    cpu: Sequence[Series],
    gpu: Sequence[Series],
    rows: Sequence[Row],
    column: PlannedColumn,
    quantities: tuple[str, str],
    marks: Mapping[tuple[str, str], str],
    measure: Callable[[Row, Sequence[Run], str], _Bar],
) -> list[_Panel]:
    if not cpu and not gpu:
        raise BadInput(f"no run on {column.title} is stored that has these times: there is no speed to draw")
    printed = published()
    panels = []
    for title, series, quantity in zip(("CPU", "GPU"), (cpu, gpu), quantities, strict=True):
        runs = {one.name: one.runs for one in series}
        theirs = {row.name: printed.get((row.name, column.published or ""), {}).get(quantity) for row in rows}
        if runs:
            words = {row.name: marks.get((row.name, quantity), "not run") for row in rows}
            measured = {row.name: measure(row, runs.get(row.name, ()), words[row.name]) for row in rows}
            panels.append(_Panel(title, measured, {name: value for name, value in theirs.items() if value}))
    return panels


def _draw(
    panels: Sequence[_Panel], rows: Sequence[Row], label: str, keys: Sequence[Patch | Line2D], quoted: Sequence[str]
) -> Figure:
    width_mm, key_rows = (SINGLE_MM, len(keys)) if len(panels) == 1 else (DOUBLE_MM, 1)
    figure, all_axes = new(width_mm, 19 + 9 * len(rows) + 4.2 * key_rows, 1, len(panels))
    drawn = looks([row.name for row in rows])
    measured = [bar for panel in panels for bar in panel.measured.values()]
    ends = [end for bar in measured for end in (bar.value, bar.low, bar.high, bar.more) if end]
    ends += [printed for panel in panels for printed in panel.published.values()]
    span = max(ends, default=1) / min(ends, default=1)
    for axes, panel in zip(all_axes, panels, strict=True):
        plain_log(axes, "x", ends or [1], below=2.5, above=1.6 * span**0.3)
        for i, row in enumerate(rows):
            _draw_measured(axes, i - _BAR / 2, panel.measured[row.name], drawn[row.name])
            if row.name in panel.published:
                hatch = _QUOTED if row.name in quoted else _PUBLISHED
                _draw_published(axes, i + _BAR / 2, panel.published[row.name], drawn[row.name], hatch)
        axes.set(xlabel=label, ylim=(len(rows) - 0.4, -0.6), yticks=range(len(rows)), title=panel.title)
        axes.set_yticklabels([wrapped(row.name, _LETTERS) for row in rows] if axes is all_axes[0] else [])
        axes.tick_params(axis="y", length=0)
    figure.legend(handles=keys, loc="outside lower left", ncols=-(-len(keys) // key_rows))
    return figure


def _draw_measured(axes: Axes, at: float, bar: _Bar, look: Look) -> None:
    start = axes.get_xlim()[0]
    if bar.value is None:
        _write(axes, start, at, bar.word, color=GREY, style="italic")
        return
    axes.barh(at, bar.value - start, _BAR, start, color=look.colour, edgecolor="black", linewidth=0.5)
    low, high = bar.low or bar.value, bar.high or bar.value
    lines = [([low, high], [at, at], 1.0)] if low < high else []
    if bar.more is not None:
        lines.append(([bar.more] * 2, [at - _BAR / 2, at + _BAR / 2], 1.8))
    for x, y, width in lines:
        axes.plot(x, y, color="white", linewidth=width + 1.4, solid_capstyle="butt")  # to be seen on a dark bar
        axes.plot(x, y, color="black", linewidth=width, solid_capstyle="butt")
    beyond = bar.more if bar.more is not None and bar.more > high else None
    _write(
        axes,
        beyond or high,
        at,
        format_three_digits(bar.value) + (f" ({format_three_digits(beyond)})" if beyond else ""),
    )


def _draw_published(axes: Axes, at: float, printed: float, look: Look, hatch: str) -> None:
    start = axes.get_xlim()[0]
    axes.barh(at, printed - start, _BAR, start, color="white", edgecolor=look.colour, hatch=hatch, linewidth=0.8)
    _write(axes, printed, at, format_three_digits(printed), color=GREY)


def _write(axes: Axes, x: float, y: float, text: str, **looking: Any) -> None:
    axes.annotate(text, (x, y), (4, 0), textcoords="offset points", va="center", fontsize=7, **looking)


def _keys(panels: Sequence[_Panel], quoted: Sequence[str], of_what: str = "") -> list[Patch | Line2D]:
    """Return what the legend shows: only what is drawn."""
    printed = {name for panel in panels for name in panel.published}
    keys: list[Patch | Line2D] = [Patch(facecolor=GREY, edgecolor="black", linewidth=0.5, label="measured here")]
    if printed - set(quoted):
        keys.append(Patch(facecolor="white", edgecolor=GREY, hatch=_PUBLISHED, label=f"published{of_what}"))
    if printed & set(quoted):
        keys.append(Patch(facecolor="white", edgecolor=GREY, hatch=_QUOTED, label="published, quoted there"))
    if _has_ticks(panels):
        mark = Line2D([], [], color="black", marker="|", linestyle="none", markersize=8, markeredgewidth=1.6)
        mark.set_label("with reading the images")
        keys.append(mark)
    return keys


def _has_ticks(panels: Sequence[_Panel]) -> bool:
    return any(bar.more is not None for panel in panels for bar in panel.measured.values())
