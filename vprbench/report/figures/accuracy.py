"""Accuracy: precision-recall curves, recall at N, under a wider ground truth, of sequences and corruptions."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from math import ceil
from statistics import mean
from textwrap import fill
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from vprbench.metrics.accuracy import (
    PRCurve,
    Values,
    average_precision,
    compute_pr_curve,
    count_hits,
    count_hits_within,
)
from vprbench.metrics.catalogue import Metric
from vprbench.metrics.intervals import block_length, share_interval
from vprbench.report.figures import style
from vprbench.report.figures.captions import INTERVALS, choose_answerable, choose_runs, describe_runs
from vprbench.report.figures.style import Drawing, Look, add_legend, choose_looks, new_figure, use_style
from vprbench.report.robustness import Robustness
from vprbench.report.selection import MethodRuns
from vprbench.runs.corruption import KINDS
from vprbench.runs.recall_intervals import order_along_journey
from vprbench.runs.record import Run
from vprbench.runs.rows import describe_sequence
from vprbench.runs.views import get_window_length, select_queries

LARGEST_N = 25
LARGEST_WIDENING = 10  # places to either side

_HEIGHT_MM = 64.0  # without the legend
_RESAMPLES = 500
_GRID_POINTS = 200  # recalls at which resampled curves are compared
_ENDED = 0.05  # of the resampled curves; beyond, only the better ones would be left
_THIN: dict[str, Any] = {"linewidth": 0.4, "alpha": 0.6}  # of a single seed
_SEEDS = "thin lines, their mean is thick"
_LETTERS = 26  # of a line of a row's name
_COLUMNS = 4  # of panels of corruptions
_MOST_BANDS = 3  # more would hide one another


@use_style
def draw_precision_recall(series: Sequence[MethodRuns]) -> Drawing:
    """Draw the precision-recall curves over the answerable queries (curve A).

    The area under a drawn curve, which goes in steps, is its average precision. A single seed has a band from the
    block bootstrap of its queries; several seeds are thin lines around their mean, which ends where the first of
    them does. Raises BadInput if no query has a right place.
    """
    series = choose_answerable(series)
    figure, (axes,) = new_figure(style.SINGLE_MM, _HEIGHT_MM, grid=True)
    looks = choose_looks(row.name for row in series)
    for row in series:
        look = looks[row.name]
        curves = [curve for run in row.runs if (curve := compute_pr_curve(run.outcome, "A"))]
        recall, precision = _average_curves(curves)
        if len(curves) > 1:
            for curve in curves:
                axes.step(curve.recall, curve.precision, color=look.colour, **_THIN)
        else:
            _fill_band(axes, look, *_resample_precision(row.runs[0], float(recall[-1])))
        areas = [average_precision(curve) for curve in curves]
        spread = f" ± {np.std(areas, ddof=1):.3f}" if len(areas) > 1 else ""
        label = f"{row.name}, AP {np.mean(areas):.3f}{spread}"
        axes.step(recall, precision, label=label, markevery=[len(recall) - 1], **look.of_line)
    axes.set(xlabel="Recall", ylabel="Precision", xlim=(0, 1.03), ylim=(0, 1.03))
    add_legend(figure)
    caption = (
        "Precision-recall curves of the best match of each query; recall is over the queries with a right place (curve "
        "A). AP: the area under the steps. Band of a single run: 95 % interval of precision, block bootstrap of "
        f"{_RESAMPLES} resamples. Several seeds: {_SEEDS}; AP ± standard deviation. {describe_runs(series)}"
    )
    return Drawing(figure, caption)


@use_style
def draw_recall_at_n(series: Sequence[MethodRuns]) -> Drawing:
    """Draw recall at N of 1 to 25 best places over all queries; ties as expected values.

    The band is the interval of `share_interval`, of several seeds that of their mean hits. Raises BadInput if no query
    has a right place.
    """
    series = choose_answerable(series)
    numbers = range(1, min(LARGEST_N, series[0].runs[0].outcome.n_places) + 1)
    figure = _draw_recalls(series, numbers, lambda run: np.stack([count_hits(run.outcome, n) for n in numbers]))
    ticks = [n for n in numbers if n == 1 or n % 5 == 0]
    figure.axes[0].set(xlabel="Best places looked at, N", ylabel="Recall at N (%)", xticks=ticks)
    caption = (
        "Recall at N: share of all queries with a right place among the N best; ties count by expected value. "
        f"{_describe_recalls(series)}"
    )
    return Drawing(figure, caption)


@use_style
def draw_recall_at_tolerance(series: Sequence[MethodRuns]) -> Drawing:
    """Draw recall at 1 over all queries with the ground truth widened by 0 to 10 places to either side.

    The axis starts at the tolerance of the protocol in places; where the protocol has another one, it starts at 0 and
    counts the places beyond. Intervals and errors are those of `draw_recall_at_n`; ties count as in `hits_within`.
    """
    series = choose_answerable(series)
    protocol, widenings = series[0].runs[0].protocol, range(LARGEST_WIDENING + 1)
    own = int(protocol.get("tolerance_places", 0))
    others = any(protocol.get(name) for name in ("tolerance_metres", "radius_metres", "tolerance_frames"))

    def hits(run: Run) -> Values:
        return count_hits_within(run.top_places, run.top_scores, run.positives, widenings, run.place_numbers)

    tolerances = range(own, own + len(widenings))
    figure = _draw_recalls(series, tolerances, hits)
    label = "Places beyond the dataset's tolerance" if others else "Tolerance (places to either side)"
    figure.axes[0].set(xlabel=label, ylabel="Recall at 1 (%)", xticks=tolerances[::2])
    caption = (
        f"Recall at 1 over all queries against the distance that counts as right, from the dataset's {own} places on; "
        f"ties count by the share of right places among the stored ones. {_describe_recalls(series)}"
    )
    return Drawing(figure, caption)


@use_style
def draw_recall_at_length(views: Iterable[Sequence[MethodRuns]]) -> Drawing:
    """Draw recall at 1 over the length of sequences, of the rows of several views, with its 95 % interval.

    A row has a point at each length that its runs were seen in. Raises BadInput if no query has a right place.
    """
    of_length = {get_window_length(rows[0].runs[0]): rows for rows in map(choose_answerable, views)}
    lengths = sorted(of_length)
    figure, (axes,) = new_figure(style.SINGLE_MM, _HEIGHT_MM, grid=True)
    for name, look in choose_looks(row.name for length in lengths for row in of_length[length]).items():
        runs = {length: row.runs for length in lengths for row in of_length[length] if row.name == name}
        points = [_measure_recalls(seeds, lambda run: count_hits(run.outcome, 1)[None]) for seeds in runs.values()]
        _draw_curve(axes, look, name, [*runs], *(np.concatenate(part) for part in zip(*points, strict=True)))
    axes.set(xlabel="Queries in a sequence", ylabel="Recall at 1 (%)", xticks=lengths, ylim=(0, 102))
    add_legend(figure)
    counts = (f"{len(of_length[length][0].runs[0].outcome):,} at {length}" for length in lengths)
    caption = (
        "Recall at 1 of sequences, whose scores are the mean of neighbouring queries' scores; the longest: "
        f"{describe_sequence(of_length[lengths[-1]][0].runs[0])}. Queries: {', '.join(counts)}. "
        f"{_describe_recalls(of_length[lengths[0]])}"
    )
    return Drawing(figure, caption)


@use_style
def draw_metric(series: Sequence[MethodRuns], metric: Metric) -> Drawing:
    """Draw a metric of each row, the mean of its seeds and from the lowest to the highest; raises BadInput for none."""
    known = choose_runs(series, lambda run: metric.of(run) is not None, f"has a defined {metric.words}")
    figure, (axes,) = new_figure(style.SINGLE_MM, 15 + 8 * len(known))
    looks = choose_looks(row.name for row in series)
    for place, row in enumerate(known):
        look = looks[row.name]
        values = [metric.shown(value) for run in row.runs if (value := metric.of(run)) is not None]
        line = [min(values), mean(values), max(values)]
        axes.plot(line, [place] * 3, color=look.colour, marker=look.marker, markevery=[1])
    axes.set(yticks=range(len(known)), yticklabels=[fill(row.name, _LETTERS) for row in known], xlabel=metric.head)
    axes.invert_yaxis()
    caption = f"{metric.explained} Several seeds: the mean, and a line from lowest to highest. {describe_runs(known)}"
    return Drawing(figure, caption)


@use_style
def draw_robustness(robustness: Robustness) -> Drawing:
    """Draw R@1 of each row from clean frames to the strongest corruption, of few rows with its 95 % interval."""
    columns = min(_COLUMNS, len(robustness.kinds))
    n_lines = ceil(len(robustness.kinds) / columns)
    figure, panels = new_figure(style.DOUBLE_MM * columns / _COLUMNS, 46.0 * n_lines, n_lines, columns, grid=True)
    with_bands = len(robustness.clean) <= _MOST_BANDS
    for number, (axes, (kind, strengths)) in enumerate(zip(panels, robustness.kinds.items(), strict=False)):
        for name, look in choose_looks(row.name for row in robustness.clean).items():
            points = robustness.of(name, kind)
            shares = 100 * points[["recall_at_1", "low", "high"]].astype(float).to_numpy().T
            _draw_curve(axes, look, name, [*points["strength"]], *shares[: 3 if with_bands else 1])
        ticks = {0: "clean", **{strength: KINDS[kind].short([strength]) for strength in strengths}}
        axes.set(title=kind.capitalize(), xlim=(-0.2, max(ticks) + 0.2))
        axes.set(ylim=(0, 10 * ceil(10 * max(robustness.points["high"]))))
        axes.set_xticks([*ticks], [*ticks.values()])
        axes.set_ylabel("" if number % columns else "Recall at 1 (%)")
    for axes in panels[len(robustness.kinds) :]:
        axes.set_visible(False)
    add_legend(figure)
    effects = (f" {kind.capitalize()}: queries {effect}." for kind, effect in robustness.words.items())
    caption = (
        "Recall at 1 over all queries against the strength of corruptions of the queries; references are clean."
        f"{''.join(effects)} {f'Bands: {INTERVALS}. ' if with_bands else ''}{describe_runs(robustness.clean)}"
    )
    return Drawing(figure, caption)


def _describe_recalls(series: Sequence[MethodRuns]) -> str:
    return f"Bands: {INTERVALS}. Several seeds: {_SEEDS}; the band is of mean hits. {describe_runs(series)}"


def _draw_recalls(series: Sequence[MethodRuns], xs: Sequence[int], hits: Callable[[Run], Values]) -> Figure:
    """Draw the mean of `hits` (len(xs), n_queries) of each row over `xs`, in percent, with its interval."""
    figure, (axes,) = new_figure(style.SINGLE_MM, _HEIGHT_MM, grid=True)
    looks = choose_looks(row.name for row in series)
    for row in series:
        for run in row.runs if len(row.runs) > 1 else ():
            axes.plot(xs, 100 * hits(run).mean(axis=1), color=looks[row.name].colour, **_THIN)
        _draw_curve(axes, looks[row.name], row.name, xs, *_measure_recalls(row.runs, hits))
    axes.set_ylim(10 * (max(axes.dataLim.y0, 0) // 10), 102)
    add_legend(figure)
    return figure


def _measure_recalls(runs: Sequence[Run], hits: Callable[[Run], Values]) -> tuple[Values, Values, Values]:
    """Return in % the mean over the seeds of `hits` (n_points, n_queries), (n_points,), and the ends of its interval.

    The ends are NaN where there is no interval.
    """
    order, window = order_along_journey(runs[0]), get_window_length(runs[0])
    mean_hits = np.mean([hits(run)[:, order] for run in runs], axis=0)
    intervals = [share_interval(each, window=window) for each in mean_hits]
    low, high = np.transpose([(each.low, each.high) if each else (np.nan, np.nan) for each in intervals])
    return 100 * mean_hits.mean(axis=1), 100 * low, 100 * high


def _draw_curve(axes: Axes, look: Look, name: str, xs: Sequence[int], ys: Values, *band: Values) -> None:
    """Draw a row's curve with the two ends of its band, none where an end is NaN; of many points few have a marker."""
    if band and not np.isnan(band).any():
        _fill_band(axes, look, xs, *band)
    marked = [i for i, x in enumerate(xs) if len(xs) <= LARGEST_WIDENING + 1 or x == 1 or x % 5 == 0]
    axes.plot(xs, ys, label=name, markevery=marked, **look.of_line)


def _fill_band(axes: Axes, look: Look, xs: npt.ArrayLike, low: npt.ArrayLike, high: npt.ArrayLike) -> None:
    axes.fill_between(xs, low, high, color=look.colour, alpha=0.15, linewidth=0)


def _average_curves(curves: Sequence[PRCurve]) -> tuple[Values, Values]:
    """Return the mean precision at every recall that a curve has, up to the first end of one, as steps."""
    if len(curves) == 1:
        return curves[0].recall, curves[0].precision
    recall = np.unique(np.concatenate([curve.recall for curve in curves]))
    recall = recall[recall <= min(curve.recall[-1] for curve in curves)]
    return recall, np.mean([_precision_at(curve, recall) for curve in curves], axis=0)


def _precision_at(curve: PRCurve, recall: Values) -> Values:
    """Return the precision of a curve, in steps, at each of these recalls; NaN beyond its end."""
    return np.append(curve.precision, np.nan)[np.searchsorted(curve.recall, recall)]


def _resample_precision(run: Run, end: float) -> tuple[Values, Values, Values]:
    """Return recalls up to `end` and the 95 % interval of precision there, by a circular block bootstrap."""
    run = replace(run, scores=None)
    random, order = np.random.default_rng(0), order_along_journey(run)
    n, block = len(order), max(block_length(count_hits(run.outcome, 1)[order]), get_window_length(run))
    grid = np.linspace(0, end, _GRID_POINTS)
    precisions = np.full((_RESAMPLES, _GRID_POINTS), np.nan)
    for precision in precisions:
        starts = random.integers(n, size=(-(-n // block), 1))
        queries = order[((starts + np.arange(block)) % n).ravel()[:n]]
        if (curve := compute_pr_curve(select_queries(run, queries, {}).outcome, "A")) is not None:
            precision[:] = _precision_at(curve, grid)
    reached = (grid == 0) | (np.isnan(precisions).mean(axis=0) <= _ENDED)
    low, high = np.nanquantile(precisions[:, reached], [0.025, 0.975], axis=0)
    return grid[reached], low, high
