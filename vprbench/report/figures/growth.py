"""Time against the number of places, with the exponent of its growth: Figure 2C of the paper."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from vprbench.errors import BadInput
from vprbench.metrics.growth import fit_power
from vprbench.report.figures import style
from vprbench.report.figures.captions import describe_machines, describe_runs, join_facts, list_names
from vprbench.report.figures.style import Drawing, Look, choose_looks, new_figure, use_style
from vprbench.report.growth import GrowthSamples
from vprbench.report.selection import Series
from vprbench.text import plural

_CLAIMS = {"VPRTempo": "O(n) training, O(log n) query"}  # by the paper
_SECONDS = ("seconds", "low", "high")
_TRAINING = ("fit_compute_seconds",)  # columns of the samples; one fit has no interval
_QUERY = ("query_seconds", "query_low", "query_high")
_MS = 1e3  # milliseconds of a second
_HEIGHT_MM = 74.0  # without the legend


@use_style
def draw_growth(rows: Sequence[GrowthSamples]) -> Drawing:
    """Draw training time (left) and the time of a query (right) against the number of places, with fitted powers.

    Raises BadInput if there is no row.
    """
    if not rows:
        raise BadInput("no run with different numbers of places is stored: there is no growth to draw")
    figure, (left, right) = new_figure(style.DOUBLE_MM, _HEIGHT_MM, 1, 2)
    looks = choose_looks(row.name for row in rows)
    labels = {row.name: row.name for row in rows}
    panels = (
        (left, "training", _TRAINING, 1.0, "nothing was trained"),
        (right, "query", _QUERY, _MS, "nothing was timed"),
    )
    for axes, step, columns, unit, nothing in panels:
        times = {row.name: _times(row, columns) for row in rows}
        for name, of_row in times.items():
            labels[name] += _draw_times(axes, of_row, unit, looks[name], step)
        _finish(axes, pd.concat(times.values()), unit, nothing)
    keys = [Line2D([], [], **looks[name].of_line, label=label) for name, label in labels.items()]
    style.add_legend(figure, keys)
    left.set(xlabel="Places", ylabel="Training time (s)", title="Training")
    right.set(xlabel="Places", ylabel="Time of a query (ms)", title="Query")
    table = pd.concat([row.table for row in rows])
    places = sorted({*table["places"]})
    claims = [f"{row.name} {_CLAIMS[row.name]}" for row in rows if row.name in _CLAIMS]
    n_aside = sum(row.n_aside for row in rows)
    caption = join_facts(
        f"Time against places on {', '.join(dict.fromkeys(table['dataset']))}: {len(places)} maps of {places[0]:,} to "
        f"{places[-1]:,} places. Left: training without waiting for images. Right: one query from memory, encode and "
        "match; median and its 95 % interval. Lines: powers fitted to the logarithms of the medians over seeds, "
        "their exponents in the legend. Hollow: disturbed machine or too few laps.",
        list_names("Claims of the paper", claims),
        describe_machines(run for row in rows for run in row.runs),
        f"Not drawn: {plural(n_aside, 'run')} of other code or conditions." if n_aside else "",
    )
    return Drawing(figure, caption)


@use_style
def draw_growing_map(series: Sequence[Series]) -> Drawing:
    """Draw recall at 1 (left) and the time of a new place (right) over the places of a map that grew one by one.

    Of several seeds the first that did. Raises BadInput if no run did.
    """
    grown = {row.name: run for row in series for run in reversed(row.runs) if run.stream}
    if not grown:
        raise BadInput("no map grew while it was asked: give a run stream=true")
    figure, (left, right) = new_figure(style.DOUBLE_MM, _HEIGHT_MM, 1, 2)
    for name, look in choose_looks(grown).items():
        stops = grown[name].stream or []
        places = [stop["places"] for stop in stops]
        of_all, of_first = (
            100 * np.array([stop[recall] for stop in stops], np.float64)  # NaN where nothing was asked
            for recall in ("recall_at_1", "recall_at_1_of_first")
        )
        left.plot(places, of_all, label=name, **{**look.of_points, "linestyle": "-"})
        left.plot(places, of_first, label=f"{name}, of the first {places[0]:,}", **{**look.of_points, "linestyle": ":"})
        seconds = [stop["seconds_a_place"] for stop in stops[1:]]
        right.plot(places[1:], _MS * np.array(seconds), **{**look.of_points, "linestyle": "-"})
    left.set(xlabel="Places in the map", ylabel="Recall at 1 (%)", ylim=(0, 102))
    right.set(xlabel="Places in the map", ylabel="Time of a new place (ms)", yscale="log")
    style.add_legend(figure, left.get_legend_handles_labels()[0])
    ending = describe_runs([row for row in series if row.name in grown], "the first is drawn", of_times=True)
    caption = (
        "Left: recall at 1 of a map that grows place by place, over queries whose right place it holds (dotted: over "
        f"those of its first fit). Right: median time of a new place, its images in memory. {ending}"
    )
    return Drawing(figure, caption)


def _times(row: GrowthSamples, columns: Sequence[str]) -> pd.DataFrame:
    """Return `places`, `seconds`, `low`, `high` and `disturbed` of the runs that have such a time, a line a run."""
    known = row.table.dropna(subset=columns[0])
    seconds, *ends = (known[name].astype(float) for name in columns)
    low, high = (end.fillna(seconds) for end in ends or (seconds, seconds))
    times = {"places": known["places"], "seconds": seconds, "low": low, "high": high, "disturbed": known["disturbed"]}
    return pd.DataFrame(times)


def _draw_times(axes: Axes, times: pd.DataFrame, unit: float, look: Look, step: str) -> str:
    """Draw times with their intervals, the disturbed ones hollow, and the power fitted to them.

    Returns its exponent as the end of a label; empty, with no line drawn, where there are too few sizes.
    """
    for disturbed, drawn in times.groupby("disturbed"):
        seconds, low, high = (unit * drawn[name] for name in _SECONDS)
        ends = [seconds - low, high - seconds]
        inside = "white" if disturbed else look.colour
        axes.errorbar(drawn["places"], seconds, ends, markerfacecolor=inside, zorder=3, **look.of_points)
    try:
        power = fit_power(times["places"].tolist(), times["seconds"].tolist())
    except BadInput:
        return ""
    places = np.array([times["places"].min(), times["places"].max()])
    axes.plot(places, unit * power.at(places), color=look.colour, linewidth=1.8, zorder=2)
    return f", {step} exponent {power.exponent:.2f} [{power.low:.2f}, {power.high:.2f}]"


def _finish(axes: Axes, times: pd.DataFrame, unit: float, nothing: str) -> None:
    """Scale the axes around the times; without any, the panel says so."""
    if times.empty:
        axes.text(0.5, 0.5, nothing, transform=axes.transAxes, ha="center", color=style.GREY, style="italic")
        axes.set(xticks=[], yticks=[])
        return
    style.scale_log(axes, "x", times["places"])
    style.scale_log(axes, "y", unit * times["seconds"])
    axes.grid(True)
