"""Accuracy: precision-recall curves, recall at N, under a wider ground truth, of sequences and corruptions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from math import ceil
from statistics import mean

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from vprbench.errors import BadInput
from vprbench.metrics.accuracy import PRCurve, Values, average_precision, hits_at, hits_within, pr_curve
from vprbench.metrics.intervals import block_length, share_interval
from vprbench.metrics.ranking import Outcome
from vprbench.metrics.registry import Metric
from vprbench.paper.figures.captions import INTERVALS, describe_runs, join_facts, list_names, require_one_dataset
from vprbench.paper.figures.style import DOUBLE_MM, SINGLE_MM, Drawn, legend_above, looks, new, styled, wrapped
from vprbench.paper.robustness import Robustness
from vprbench.paper.selection import Series
from vprbench.runs.corruption import KINDS
from vprbench.runs.recall_intervals import order_along_journey, recall_interval
from vprbench.runs.record import Run
from vprbench.runs.views import window_of

LARGEST_N = 25
LARGEST_TOLERANCE = 10  # places to either side

_HEIGHT_MM = 64.0  # without the legend
_RESAMPLES = 500
_GRID_POINTS = 200  # recalls at which resampled curves are compared
_ENDED = 0.05  # of the resampled curves; beyond, only the better ones would be left
_BAND = 0.15  # opacity


@styled
def precision_recall(series: Sequence[Series]) -> Drawn:
    """Draw the precision-recall curves over the answerable queries (curve A), Figure 3C of the paper.

    The area under a drawn curve, which goes in steps, is its average precision. A single seed has a band from the
    block bootstrap of its queries; several seeds are thin lines around their mean, which ends where the first of
    them does. Raises BadInput for no rows, for rows on different data and if no query has a right place.
    """
    _answerable(series, "precision and recall")
    figure, (axes,) = new(SINGLE_MM, _HEIGHT_MM)
    styles = looks([row.name for row in series])
    for row in series:
        look = styles[row.name]
        curves = [curve for each in row.runs if (curve := pr_curve(each.outcome, "A"))]
        recall, precision = _mean_curve(curves)
        if len(curves) > 1:
            for curve in curves:
                axes.step(curve.recall, curve.precision, color=look.colour, linewidth=0.4, alpha=0.6)
        else:
            grid, low, high = _resampled(row.runs[0], float(recall[-1]))
            axes.fill_between(grid, low, high, color=look.colour, alpha=_BAND, linewidth=0)
        label = f"{row.name}, AP {_mean_and_spread([average_precision(curve) for curve in curves])}"
        (line,) = axes.step(recall, precision, color=look.colour, linestyle=look.dash, marker=look.marker, label=label)
        line.set_markevery([len(recall) - 1])
    axes.set(xlabel="Recall", ylabel="Precision", xlim=(0, 1.03), ylim=(0, 1.03))
    _finish(figure, axes)
    caption = (
        "Precision-recall curves of the best match of each query; recall is over the queries with a right place (curve "
        "A). AP: the area under the steps. Band of a single run: 95 % interval of precision, block bootstrap of "
        f"{_RESAMPLES} resamples. {describe_runs(series, 'thin lines, their mean is thick; AP ± standard deviation')}"
    )
    return Drawn(figure, caption)


@styled
def recall_at_n(series: Sequence[Series]) -> Drawn:
    """Draw recall at N of 1 to 25 best places over all queries, Figure 3D of the paper; ties as expected values.

    The band is the interval of `share_interval`, of several seeds that of their mean hits. Raises BadInput for no rows,
    for rows on different data and if no query has a right place.
    """
    run = _answerable(series, "recall at N")
    numbers = range(1, min(LARGEST_N, run.outcome.n_places) + 1)
    figure, (axes,) = new(SINGLE_MM, _HEIGHT_MM)
    _draw_recalls(axes, series, numbers, lambda each: np.stack([hits_at(each.outcome, n) for n in numbers]))
    ticks = [n for n in (1, 5, 10, 15, 20, 25) if n in numbers]
    axes.set(xlabel="Best places looked at, N", ylabel="Recall at N (%)", xticks=ticks)
    _finish(figure, axes)
    caption = "Recall at N: share of all queries with a right place among the N best; ties count by expected value."
    return Drawn(figure, f"{caption} {_describe_recalls(series)}")


@styled
def recall_at_tolerance(series: Sequence[Series]) -> Drawn:
    """Draw recall at 1 over all queries with the ground truth widened by 0 to 10 places to either side.

    Intervals and what is raised are those of `recall_at_n`; ties are counted as in `tolerance.hits_within`.
    """
    first = _answerable(series, "recall against tolerance")
    tolerances = range(LARGEST_TOLERANCE + 1)
    figure, (axes,) = new(SINGLE_MM, _HEIGHT_MM)
    _draw_recalls(
        axes,
        series,
        tolerances,
        lambda each: hits_within(each.top_places, each.top_scores, each.positives, tolerances, each.place_numbers),
    )
    axes.set(xlabel="Tolerance (places to either side)", ylabel="Recall at 1 (%)", xticks=tolerances[::2])
    _finish(figure, axes)
    cut = [
        row.name for row in series if any((run.outcome.top_tied > run.top_places.shape[1]).any() for run in row.runs)
    ]
    own = first.protocol.get("tolerance_places")
    caption = join_facts(
        "Recall at 1 over all queries; at tolerance k a match within k places of a right place counts as right"
        f"{f' (the dataset allows {own})' if own else ''}, and ties by the share of right places.",
        list_names("Of ties only the stored places count", cut),
        _describe_recalls(series),
    )
    return Drawn(figure, caption)


def _describe_recalls(series: Sequence[Series]) -> str:
    return f"Bands: {INTERVALS}. {describe_runs(series, 'thin lines, their mean is thick; the band is of mean hits')}"


def _answerable(series: Sequence[Series], figure: str) -> Run:
    """Return a run that stands for the data of all rows; raises BadInput if no query has a right place."""
    run = require_one_dataset(series, figure)
    if not run.outcome.answerable.any():
        raise BadInput(f"no query of dataset {run.dataset} has a right place: there is no figure of {figure}")
    return run


def _finish(figure: Figure, axes: Axes) -> None:
    """Add the grid, and above the panel a legend, which never hides a curve."""
    axes.grid(True)
    legend_above(figure, axes.get_legend_handles_labels()[0])


def _mean_curve(curves: Sequence[PRCurve]) -> tuple[Values, Values]:
    """Return the mean precision at every recall that a curve has, up to the first end of one, as steps."""
    end = min(float(curve.recall[-1]) for curve in curves)
    if len(curves) == 1:
        return curves[0].recall, curves[0].precision
    recall = np.unique(np.concatenate([curve.recall for curve in curves]))
    recall = recall[recall <= end]
    return recall, np.mean([_precision_at(curve, recall) for curve in curves], axis=0)


def _precision_at(curve: PRCurve, recall: Values) -> Values:
    """Return the precision of a curve, in steps, at each of these recalls; NaN beyond its end."""
    precision = np.append(curve.precision, np.nan)
    return precision[np.searchsorted(curve.recall, recall)]


def _resampled(run: Run, end: float) -> tuple[Values, Values, Values]:
    """Return recalls up to `end` and the 95 % interval of precision there, by a circular block bootstrap."""
    random = np.random.default_rng(0)
    outcome = _of_queries(run.outcome, order_along_journey(run))
    block = max(block_length(hits_at(outcome, 1)), window_of(run))
    n_blocks = -(-len(outcome) // block)
    grid = np.linspace(0, end, _GRID_POINTS)
    precisions = np.full((_RESAMPLES, _GRID_POINTS), np.nan)
    for precision in precisions:
        starts = random.integers(len(outcome), size=(n_blocks, 1))
        drawn = ((starts + np.arange(block)) % len(outcome)).ravel()[: len(outcome)]
        curve = pr_curve(_of_queries(outcome, drawn), "A")
        if curve is not None:
            precision[:] = _precision_at(curve, grid)
    reached = np.isnan(precisions).mean(axis=0) <= _ENDED
    if not reached.any():  # too few queries have a right place
        return grid[:0], grid[:0], grid[:0]
    low, high = np.nanquantile(precisions[:, reached], [0.025, 0.975], axis=0)
    return grid[reached], low, high


def _of_queries(outcome: Outcome, queries: npt.NDArray[np.int64]) -> Outcome:
    columns = [field.name for field in fields(Outcome) if field.name != "n_places"]
    return replace(outcome, **{name: getattr(outcome, name)[queries] for name in columns})


def _mean_and_spread(values: Sequence[float]) -> str:
    return f"{np.mean(values):.3f}" + (f" ± {np.std(values, ddof=1):.3f}" if len(values) > 1 else "")


def _draw_recalls(axes: Axes, series: Sequence[Series], xs: Sequence[int], hits: Callable[[Run], Values]) -> None:
    """Draw the mean of `hits` (len(xs), n_queries) of each row over `xs`, in percent, with its interval."""
    styles = looks([row.name for row in series])
    lowest = 100.0
    for row in series:
        look = styles[row.name]
        order = order_along_journey(row.runs[0])
        of_seeds = np.stack([hits(run)[:, order] for run in row.runs])  # (n_seeds, len(xs), n_queries)
        shares = of_seeds.mean(axis=2)
        mean = shares.mean(axis=0)
        ends = [end for each in of_seeds.mean(axis=0) if (end := share_interval(each, window=window_of(row.runs[0])))]
        low, high = 100 * np.array([[end.low for end in ends], [end.high for end in ends]])
        for seed in shares if len(row.runs) > 1 else ():
            axes.plot(xs, 100 * seed, color=look.colour, linewidth=0.4, alpha=0.6)
            lowest = min(lowest, 100 * float(seed.min()))
        axes.fill_between(xs, low, high, color=look.colour, alpha=_BAND, linewidth=0)
        (line,) = axes.plot(xs, 100 * mean, color=look.colour, linestyle=look.dash, marker=look.marker, label=row.name)
        line.set_markevery(_marked(xs))
        lowest = min(lowest, float(low.min()))
    axes.set_ylim(10 * (lowest // 10), 102)


def _marked(xs: Sequence[int]) -> list[int]:
    """Return which points have a marker: 1 and each fifth of many, all of few."""
    return [i for i, x in enumerate(xs) if len(xs) <= LARGEST_TOLERANCE + 1 or x == 1 or x % 5 == 0]


_LETTERS = 26  # of a line of a row's name


@styled
def of_rows(series: Sequence[Series], metric: Metric) -> Drawn:
    """Draw a metric of each row, the mean of its seeds and from the lowest to the highest; raises BadInput for none."""
    found = [(one, [metric.shown(v) for run in one.runs if (v := metric.of(run)) is not None]) for one in series]
    known = [(one, values) for one, values in found if values]
    if not known:
        raise BadInput(f"{metric.words} is undefined for all rows")
    kept = [one for one, _ in known]
    styles = looks([one.name for one in series])
    figure, (axes,) = new(SINGLE_MM, 15 + 8 * len(known))
    for place, (one, values) in enumerate(known):
        look = styles[one.name]
        axes.plot([min(values), max(values)], [place, place], color=look.colour)
        axes.plot([mean(values)], [place], color=look.colour, marker=look.marker)
    axes.set(yticks=range(len(known)), yticklabels=[wrapped(one.name, _LETTERS) for one in kept], xlabel=metric.head)
    axes.invert_yaxis()
    return Drawn(figure, f"{metric.explained} {describe_runs(kept, 'mean, and a line from lowest to highest')}")


_COLUMNS = 4
_PANEL_ROW_MM = 46.0
_FAINT_BAND = 0.12  # opacity
_MOST_BANDS = 3  # more would hide one another


@styled
def robustness(found: Robustness) -> Drawn:
    """Draw R@1 of each row from clean frames to the strongest corruption, of few rows with its 95 % interval."""
    kinds = found.kinds
    columns = min(_COLUMNS, len(kinds))
    n_rows = ceil(len(kinds) / columns)
    figure, panels = new(DOUBLE_MM * columns / _COLUMNS, _PANEL_ROW_MM * n_rows, n_rows, columns)
    styles = looks([row.name for row in found.clean])
    bands = len(found.clean) <= _MOST_BANDS
    highest = 10 * ceil(10 * max(found.points["high"]))
    for number, (axes, (kind, strengths)) in enumerate(zip(panels, kinds.items(), strict=False)):
        for row in found.clean:
            look, points = styles[row.name], found.of(row.name, kind)
            at = [*points["strength"]]
            low, mean, high = ([100 * share for share in points[end]] for end in ("low", "recall_at_1", "high"))
            if bands:
                axes.fill_between(at, low, high, color=look.colour, alpha=_FAINT_BAND, linewidth=0)
            axes.plot(at, mean, color=look.colour, linestyle=look.dash, marker=look.marker, label=row.name)
        ticks = {0: "clean", **{each: KINDS[kind].short([each]) for each in strengths}}
        axes.set(title=kind.capitalize(), ylim=(0, highest), xlim=(-0.2, max(ticks) + 0.2))
        axes.set_xticks([*ticks], [*ticks.values()])
        if number % columns == 0:
            axes.set_ylabel("Recall at 1 (%)")
        axes.grid(True)
    for axes in panels[len(kinds) :]:
        axes.set_visible(False)
    legend_above(figure, panels[0].get_legend_handles_labels()[0])
    caption = join_facts(
        "Recall at 1 over all queries against the strength of corruptions of the queries; references are clean.",
        *(f"{kind.capitalize()}: queries {effect}." for kind, effect in found.words.items()),
        f"Bands: {INTERVALS}." if bands else "",
        describe_runs(found.clean, "means"),
    )
    return Drawn(figure, caption)


@styled
def recall_at_length(shown: Sequence[Sequence[Series]]) -> Drawn:
    """Draw recall at 1 over the length of sequences, of the rows of several views, with its 95 % interval.

    A row has a point at each length that its runs were seen in. Raises BadInput for fewer than two lengths and if no
    query has a right place.
    """
    views = sorted((rows for rows in shown if rows), key=_length)
    if len(views) < 2 or not any(row.runs[0].outcome.answerable.any() for rows in views for row in rows):
        raise BadInput("sequences of two lengths or more are wanted, of queries that have a right place")
    figure, (axes,) = new(SINGLE_MM, _HEIGHT_MM)
    names = list(dict.fromkeys(row.name for rows in views for row in rows))
    styles = looks(names)
    for name in names:
        look = styles[name]
        found = [(_length(rows), row.runs) for rows in views for row in rows if row.name == name]
        xs = [length for length, _ in found]
        ys = [100 * sum(float(hits_at(run.outcome, 1).mean()) for run in runs) / len(runs) for _, runs in found]
        ends = [recall_interval(runs) for _, runs in found]
        if all(ends):
            low, high = zip(*((100 * end.low, 100 * end.high) for end in ends if end), strict=True)
            axes.fill_between(xs, low, high, color=look.colour, alpha=_BAND, linewidth=0)
        axes.plot(xs, ys, color=look.colour, linestyle=look.dash, marker=look.marker, label=name)
    axes.set(xlabel="Queries in a sequence", ylabel="Recall at 1 (%)", xticks=[*map(_length, views)], ylim=(0, 102))
    axes.grid(True)
    legend_above(figure, axes.get_legend_handles_labels()[0])
    protocol = max((rows[0].runs[0].protocol for rows in views), key=len)
    parts = {"sequence_velocities": "velocities", "sequence_contrast": "local contrast", "sequence_gaps": "gaps"}
    caption = (
        "Recall at 1 of sequences, whose scores are the mean of neighbouring queries' scores; the window "
        f"{'ends with the query' if 'causal' in protocol['sequence'] else 'has the query in its middle'}"
        f"{''.join(f', {words} {protocol[name]}' for name, words in parts.items() if name in protocol)}. Queries: "
        f"{', '.join(f'{len(rows[0].runs[0].outcome):,} at {_length(rows)}' for rows in views)}. "
        f"{_describe_recalls(views[0])}"
    )
    return Drawn(figure, caption)


def _length(rows: Sequence[Series]) -> int:
    return window_of(rows[0].runs[0])
