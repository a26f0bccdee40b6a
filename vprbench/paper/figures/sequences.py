"""Sequences: recall at 1 of every row against the number of neighbouring queries that answer together."""

from __future__ import annotations

from collections.abc import Sequence

from vprbench.errors import BadInput
from vprbench.metrics.accuracy import hits_at
from vprbench.paper.figures.captions import caption
from vprbench.paper.figures.style import SINGLE_MM, Drawn, legend_above, looks, new, styled
from vprbench.paper.selection import Series
from vprbench.runs.recall_intervals import recall_interval
from vprbench.runs.views import window_of

_HEIGHT_MM = 64.0  # without the legend
_BAND = 0.15  # opacity


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
    first = views[0]
    protocol = max((rows[0].runs[0].protocol for rows in views), key=len)
    asked = [(_length(rows), len(rows[0].runs[0].outcome)) for rows in views]
    return Drawn(figure, caption("recall_at_length", first, protocol=protocol, asked=asked))


def _length(rows: Sequence[Series]) -> int:
    return window_of(rows[0].runs[0])
