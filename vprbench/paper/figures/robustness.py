"""R@1 against the strength of corruptions of the query frames, a panel for each kind."""

from __future__ import annotations

from math import ceil

from vprbench.paper.figures.captions import caption
from vprbench.paper.figures.style import DOUBLE_MM, Drawn, legend_above, looks, new, styled
from vprbench.paper.robustness import Robustness
from vprbench.runs.corruption import KINDS

_COLUMNS = 4
_ROW_MM = 46.0
_BAND = 0.12  # opacity
_MOST_BANDS = 3  # more would hide one another


@styled
def robustness(found: Robustness) -> Drawn:
    """Draw R@1 of each row from clean frames to the strongest corruption, of few rows with its 95 % interval."""
    kinds = found.kinds
    columns = min(_COLUMNS, len(kinds))
    n_rows = ceil(len(kinds) / columns)
    figure, panels = new(DOUBLE_MM * columns / _COLUMNS, _ROW_MM * n_rows, n_rows, columns)
    styles = looks([row.name for row in found.clean])
    bands = len(found.clean) <= _MOST_BANDS
    highest = 10 * ceil(10 * max(found.points["high"]))
    for number, (axes, (kind, strengths)) in enumerate(zip(panels, kinds.items(), strict=False)):
        for row in found.clean:
            look, points = styles[row.name], found.of(row.name, kind)
            at = [*points["strength"]]
            low, mean, high = ([100 * share for share in points[end]] for end in ("low", "recall_at_1", "high"))
            if bands:
                axes.fill_between(at, low, high, color=look.colour, alpha=_BAND, linewidth=0)
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
    return Drawn(figure, caption("robustness", found.clean, kinds=found.words, bands=bands))
