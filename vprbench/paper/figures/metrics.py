"""One of `METRICS` for each row: a figure for every metric that is asked for."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import mean

from vprbench.errors import BadInput
from vprbench.metrics.registry import Metric
from vprbench.paper.figures.captions import caption
from vprbench.paper.figures.style import SINGLE_MM, Drawn, looks, new, styled, wrapped
from vprbench.paper.selection import Series

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
    return Drawn(figure, caption("of_rows", kept, metric=metric))
