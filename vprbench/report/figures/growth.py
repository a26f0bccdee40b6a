"""Time against the number of places, with the exponent of its growth."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from vprbench.errors import BadInput
from vprbench.metrics.growth import fit_power
from vprbench.report.figures import style
from vprbench.report.figures.captions import choose_runs, describe_machines, describe_timed_runs
from vprbench.report.figures.style import Drawing, Look, choose_looks, new_figure, use_style
from vprbench.report.selection import MethodRuns, format_plain_values, get_sort_key, list_conditions
from vprbench.report.table.best import list_laps
from vprbench.runs.frame import tabulate_with_records
from vprbench.runs.record import Run

_TRAINING = ("fit_compute_seconds",) * 3  # columns of the samples: time, low and high; one fit has no interval
_QUERY = ("query_seconds", "query_low", "query_high")
_PER_SIZE = {"places", "query_places", "first_query_place", "reference_places", "held_out_places"}  # of a protocol
_MS = 1e3  # milliseconds of a second
_HEIGHT_MM = 74.0  # without the legend


@use_style
def draw_growth(rows: Sequence[MethodRuns], claim: str = "") -> Drawing:
    """Draw training time (left) and the time of a query (right) against the number of places, with fitted powers.

    A row has the runs of maps of different sizes, of which those count that share conditions with the newest. A panel
    without times is not shown. `claim` is a published sentence for the caption. Raises BadInput if there is no row.
    """
    if not rows:
        raise BadInput("no run with different numbers of places is stored: there is no growth to draw")
    figure, (left, right) = new_figure(style.DOUBLE_MM, _HEIGHT_MM, 1, 2, grid=True)
    left.set(xlabel="Places", ylabel="Training time (s)", title="Training")
    right.set(xlabel="Places", ylabel="Time of a query (ms)", title="Query")
    tables = {row.name: tabulate_growth(row.runs) for row in rows}
    table = pd.concat(tables.values())
    labels = {row.name: row.name for row in rows}
    looks = choose_looks(labels)
    for axes, step, columns, unit in ((left, "training", _TRAINING, 1.0), (right, "query", _QUERY, _MS)):
        times = table.dropna(subset=columns[0])
        if times.empty:
            axes.set_visible(False)
            continue
        for row in rows:
            labels[row.name] += _draw_times(axes, tables[row.name], columns, unit, looks[row.name], step)
        style.scale_log(axes, "x", times["places"])
        style.scale_log(axes, "y", unit * times[columns[0]].astype(float))
    style.add_legend(figure, [Line2D([], [], **looks[name].of_line, label=label) for name, label in labels.items()])
    places = sorted({*table["places"]})
    caption = (
        f"Time against places on {', '.join(dict.fromkeys(table['dataset']))}: {len(places)} maps of {places[0]:,} to "
        f"{places[-1]:,} places. Left: training without waiting for images. Right: one query from memory, encode and "
        "match; median and its 95 % interval. Lines: powers fitted to the logarithms of the medians over seeds, "
        "their exponents in the legend. Hollow: disturbed machine or too few laps. "
        f"{claim}{describe_machines(table['record'])}"
    )
    return Drawing(figure, caption)


@use_style
def draw_growing_map(series: Sequence[MethodRuns]) -> Drawing:
    """Draw recall at 1 (left) and the time of a new place (right) over the places of a map that grew one by one.

    Of several seeds the first that did. Raises BadInput if no run did.
    """
    series = choose_runs(series, lambda run: run.stream, "has a map that grew place by place: run with stream=true")
    looks = choose_looks(row.name for row in series)
    figure, (left, right) = new_figure(style.DOUBLE_MM, _HEIGHT_MM, 1, 2)
    for row in series:
        stops = pd.DataFrame(row.runs[0].stream)
        solid, dotted = ({**looks[row.name].of_line, "linestyle": dash} for dash in "-:")
        percent = 100 * stops[["recall_at_1", "recall_at_1_of_first"]].astype(float)  # NaN without queries
        left.plot(stops["places"], percent["recall_at_1"], label=row.name, **solid)
        label = f"{row.name}, of the first {stops['places'][0]:,}"
        left.plot(stops["places"], percent["recall_at_1_of_first"], label=label, **dotted)
        right.plot(stops["places"][1:], _MS * stops["seconds_a_place"][1:].astype(float), **solid)
    left.set(xlabel="Places in the map", ylabel="Recall at 1 (%)", ylim=(0, 102))
    right.set(xlabel="Places in the map", ylabel="Time of a new place (ms)", yscale="log")
    style.add_legend(figure)
    caption = (
        "Left: recall at 1 of a map that grows place by place, over queries whose right place it holds (dotted: over "
        "those of its first fit). Right: median time of a new place, its images in memory. Of several seeds the first. "
        f"{describe_timed_runs(series)}"
    )
    return Drawing(figure, caption)


def tabulate_growth(runs: Sequence[Run]) -> pd.DataFrame:
    """Return the frame of the runs of one row that share code, arguments, machine and protocol with the newest.

    It ascends by places and seed, and has the runs as `record` and the times of a query: `query_seconds`, `query_low`
    and `query_high`, encode and match together, their median and its 95 % interval.
    """
    newest = _format_conditions(max(runs, key=get_sort_key))
    alike = [run for run in sorted(runs, key=get_sort_key) if _format_conditions(run) == newest]
    kept = {(run.outcome.n_places, run.config["seed"]): run for run in alike}
    ordered = [kept[size] for size in sorted(kept)]
    times = pd.DataFrame(map(_list_times, ordered), columns=[*_QUERY], dtype=object)
    return tabulate_with_records(ordered).join(times)


def compute_median_interval(values: npt.NDArray[np.float64]) -> tuple[float, float] | None:
    """Return the 95 % interval of the median of `values` (n,) from their order; None for fewer than six.

    With k the largest number for which Binomial(n, 1/2) lies below k with a chance of at most 2.5 %, it runs from the
    k-th lowest to the k-th highest value. It assumes nothing about the distribution, only independent values.
    """
    from scipy.stats import binom  # takes long to import

    k = int(binom.ppf(0.025, len(values), 0.5))
    ordered = np.sort(values)
    return (float(ordered[k - 1]), float(ordered[-k])) if k else None


def _list_times(run: Run) -> tuple[float | None, ...]:
    if run.timing is None:
        return (None, None, None)
    return (float(np.median(list_laps(run))), *(compute_median_interval(list_laps(run)) or (None, None)))


def _format_conditions(run: Run) -> str:
    """Return the conditions that must be equal for times to compare, as text."""
    protocol = {name: value for name, value in run.protocol.items() if name not in _PER_SIZE}
    return format_plain_values(
        [list_conditions(run), run.config.get("timing"), run.config["device"], run.dataset, protocol]
    )


def _draw_times(axes: Axes, table: pd.DataFrame, columns: Sequence[str], unit: float, look: Look, step: str) -> str:
    """Draw the times of a row with their intervals, the disturbed ones hollow, and the power fitted to them.

    Returns its exponent as the end of a label; empty, with no line drawn, where there are too few sizes.
    """
    known = table.dropna(subset=columns[0]).astype(dict.fromkeys(columns, float))
    for disturbed, drawn in known.groupby("disturbed"):
        seconds, low, high = (unit * drawn[name].fillna(drawn[columns[0]]) for name in columns)
        points = {**look.of_points, "markerfacecolor": "white" if disturbed else look.colour}
        axes.errorbar(drawn["places"], seconds, [seconds - low, high - seconds], zorder=3, **points)
    try:
        power = fit_power(known["places"].tolist(), known[columns[0]].tolist())
    except BadInput:
        return ""
    places = np.array([known["places"].min(), known["places"].max()])
    axes.plot(places, unit * power.at(places), color=look.colour, linewidth=1.8, zorder=2)
    return f", {step} exponent {power.exponent:.2f} [{power.low:.2f}, {power.high:.2f}]"
