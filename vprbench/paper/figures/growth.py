"""Time against the number of places, with the exponent of its growth: Figure 2C of the paper."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from vprbench.errors import BadInput
from vprbench.metrics.growth import Power, fit_power
from vprbench.paper.figures.captions import describe_machines, describe_runs, join_facts, list_names
from vprbench.paper.figures.style import (
    DOUBLE_MM,
    GREY,
    Drawn,
    Look,
    legend_above,
    looks,
    new,
    plain_log,
    styled,
    wrapped,
)
from vprbench.paper.growth import GrowthSamples
from vprbench.paper.selection import Series
from vprbench.runs.stream import list_stops
from vprbench.text import plural

_CLAIMS = {"VPRTempo": "O(n) training, O(log n) query"}  # by the paper
_SECONDS = ("seconds", "low", "high")
_MS = 1e3  # milliseconds of a second
_HEIGHT_MM = 74.0  # without the legend
_LINE_MM = 4.2  # of the legend
_LETTERS = 52  # of a line of it


@dataclass(frozen=True)
class _Step:
    """The times of one step of a row, and the power fitted to them."""

    times: pd.DataFrame  # `places`, `seconds`, `low`, `high` and `disturbed`, a line a run
    power: Power | None  # None: too few sizes


@dataclass(frozen=True)
class _Fitted:
    """One row with the powers fitted to its times."""

    samples: GrowthSamples
    training: _Step
    query: _Step


@styled
def growth(rows: Sequence[GrowthSamples]) -> Drawn:
    """Draw training time (left) and the time of a query (right) against the number of places, with fitted powers.

    Raises BadInput if there is no row.
    """
    if not rows:
        raise BadInput("no run with different numbers of places is stored: there is no growth to draw")
    figure, (left, right) = new(DOUBLE_MM, _HEIGHT_MM, 1, 2)
    looked = looks([row.name for row in rows])
    fitted = list(map(_fitted, rows))
    for row in fitted:
        name, look = row.samples.name, looked[row.samples.name]
        for axes, step, of, unit in ((left, row.training, "training", 1), (right, row.query, "encode and match", _MS)):
            _draw_points(axes, step.times, unit, look, _label(of if len(rows) == 1 else name, step.power))
            _draw_power(axes, step, unit, look)
    left.set(xlabel="Places", ylabel="Training time (s)", title="Training")
    right.set(xlabel="Places", ylabel="Time of a query (ms)", title="Query")
    lines = _finish(left, pd.concat([row.training.times for row in fitted]), 1, "nothing was trained")
    lines = max(lines, _finish(right, pd.concat([row.query.times for row in fitted]), _MS, "nothing was timed"))
    figure.set_figheight((_HEIGHT_MM + lines * _LINE_MM) / 25.4)
    table = pd.concat([row.table for row in rows])
    places = sorted({*table["places"]})
    hollow = [f"{row.samples.name} at {' and '.join(sizes)} places" for row in fitted if (sizes := _disturbed(row))]
    claims = [f"{row.name} {_CLAIMS[row.name]}" for row in rows if row.name in _CLAIMS]
    n_aside = sum(row.n_aside for row in rows)
    caption = join_facts(
        f"Time against places on {', '.join(dict.fromkeys(table['dataset']))}: {len(places)} maps of {places[0]:,} to "
        f"{places[-1]:,} places. Left: training without waiting for images. Right: one query from memory, encode and "
        "match; median and its 95 % interval. Lines: powers fitted to the logarithms of the medians over seeds.",
        list_names("Hollow points, for a disturbed machine or too few laps", hollow),
        list_names("Claims of the paper", claims),
        describe_machines(rows),
        f"Not drawn: {plural(n_aside, 'run')} of other code or conditions." if n_aside else "",
    )
    return Drawn(figure, caption)


@styled
def growing_map(series: Sequence[Series]) -> Drawn:
    """Draw recall at 1 (left) and the time of a new place (right) over the places of a map that grew one by one.

    Of several seeds the first that did. Raises BadInput if no run did.
    """
    grown = {one.name: run for one in series for run in reversed(one.runs) if run.stream}
    if not grown:
        raise BadInput("no map grew while it was asked: give a run stream=true")
    figure, (left, right) = new(DOUBLE_MM, _HEIGHT_MM, 1, 2)
    for name, look in looks([*grown]).items():
        stops = list_stops(grown[name])
        places = [stop["places"] for stop in stops]
        style: dict[str, Any] = {"color": look.colour, "marker": look.marker}
        for of, dash, label in (("", "-", name), ("_of_first", ":", f"{name}, of the first {places[0]:,}")):
            shares = np.array([stop[f"recall_at_1{of}"] for stop in stops], np.float64)  # NaN where nothing was asked
            left.plot(places, 100 * shares, linestyle=dash, label=label, **style)
        right.plot(places[1:], [_MS * stop["seconds_a_place"] for stop in stops[1:]], **style)
    left.set(xlabel="Places in the map", ylabel="Recall at 1 (%)", ylim=(0, 102))
    right.set(xlabel="Places in the map", ylabel="Time of a new place (ms)", yscale="log")
    legend_above(figure, left.get_legend_handles_labels()[0])
    caption = (
        "Left: recall at 1 of a map that grows place by place, over queries whose right place it holds (dotted: over "
        "those of its first fit). Right: median time of a new place, its images in memory. "
    )
    drawn = [one for one in series if one.name in grown]
    return Drawn(figure, caption + describe_runs(drawn, "the first is drawn", of_times=True))


def _fitted(row: GrowthSamples) -> _Fitted:
    columns = ["query_seconds", "query_low", "query_high"]
    return _Fitted(row, _step(row.table, ["fit_compute_seconds", None, None]), _step(row.table, columns))


def _step(table: pd.DataFrame, columns: Sequence[str | None]) -> _Step:
    """Return the times of one step from the columns of their seconds and interval, which a single time has none of."""
    named = zip(_SECONDS, columns, strict=True)
    times = table[["places", "disturbed"]].assign(**{to: table[of] if of else None for to, of in named})
    times = times.dropna(subset="seconds")
    try:
        return _Step(times, fit_power(times["places"].tolist(), times["seconds"].tolist()))
    except BadInput:  # too few sizes
        return _Step(times, None)


def _label(name: str, power: Power | None) -> str:
    """Return the legend's text for the points of a row or a step."""
    return name if power is None else f"{name}, exponent {power.exponent:.2f} [{power.low:.2f}, {power.high:.2f}]"


def _draw_points(axes: Axes, times: pd.DataFrame, unit: float, look: Look, label: str) -> None:
    """Draw times with their intervals; the disturbed ones are hollow."""
    for disturbed, drawn in times.groupby("disturbed"):
        seconds, low, high = (unit * drawn[name].fillna(drawn["seconds"]).astype(float) for name in _SECONDS)
        axes.errorbar(
            drawn["places"],
            seconds,
            [seconds - low, high - seconds],
            color=look.colour,
            marker=look.marker,
            markerfacecolor="white" if disturbed else look.colour,
            linestyle="none",
            label=label,
            zorder=3,
        )
        label = ""  # once in the legend


def _draw_power(axes: Axes, step: _Step, unit: float, look: Look) -> None:
    """Draw the fitted power over the sizes that were measured; no line without one."""
    if step.power is not None:
        ends = np.array([step.times["places"].min(), step.times["places"].max()])
        axes.plot(ends, unit * step.power.at(ends), color=look.colour, linewidth=1.8, zorder=2)


def _finish(axes: Axes, times: pd.DataFrame, unit: float, nothing: str) -> int:
    """Scale the axes and write the legend below them; returns how many lines it has."""
    if times.empty:
        axes.text(0.5, 0.5, nothing, transform=axes.transAxes, ha="center", color=GREY, style="italic")
        axes.set(xticks=[], yticks=[])
        return 0
    plain_log(axes, "x", times["places"].tolist())
    plain_log(axes, "y", (unit * times["seconds"]).tolist())
    axes.grid(True)
    handles, labels = axes.get_legend_handles_labels()
    texts = [wrapped(label, _LETTERS) for label in labels]
    axes.legend(handles, texts, loc="upper left", bbox_to_anchor=(-0.02, -0.2), borderaxespad=0)
    return sum(1 + text.count("\n") for text in texts)


def _disturbed(row: _Fitted) -> list[str]:
    """Return the sizes whose times were disturbed."""
    times = pd.concat([row.training.times, row.query.times])
    return [f"{n:,}" for n in sorted({*times["places"][times["disturbed"].astype(bool)]})]
