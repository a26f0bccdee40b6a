"""R@1 against the strength of corruptions of the query frames, a panel for each kind."""

from __future__ import annotations

from math import ceil

from vprbench.paper.figures.captions import caption
from vprbench.paper.figures.style import DOUBLE_MM, Drawn, legend_above, looks, new, styled
from vprbench.paper.robustness import Robustness
from vprbench.run.corruption import KINDS

_COLUMNS = 4
_ROW_MM = 46.0
_BAND = 0.12  # opacity


@styled
def robustness(found: Robustness) -> Drawn:
    """Draw R@1 of each row from clean frames to the strongest corruption of each kind, with 95 % intervals."""
    kinds = found.kinds
    columns = min(_COLUMNS, len(kinds))
    n_rows = ceil(len(kinds) / columns)
    figure, panels = new(DOUBLE_MM * columns / _COLUMNS, _ROW_MM * n_rows, n_rows, columns)
    styles = looks([row.name for row in found.clean])
    highest = 10 * ceil(10 * max(point.high for point in found.points))
    for number, (axes, (kind, asked)) in enumerate(zip(panels, kinds.items(), strict=False)):
        for row in found.clean:
            look, points = styles[row.name], found.of(row.name, kind)
            strengths = [point.strength for point in points]
            low, mean, high = ([100 * getattr(p, end) for p in points] for end in ("low", "recall_at_1", "high"))
            axes.fill_between(strengths, low, high, color=look.colour, alpha=_BAND, linewidth=0)
            axes.plot(strengths, mean, color=look.colour, linestyle=look.dash, marker=look.marker, label=row.name)
        ticks = {0: "clean", **{one.strength: one.short for one in asked}}
        axes.set(title=kind.capitalize(), ylim=(0, highest), xlim=(-0.2, max(ticks) + 0.2))
        axes.set_xticks([*ticks], [*ticks.values()])
        if number % columns == 0:
            axes.set_ylabel("Recall at 1 (%)")
        axes.grid(True)
    for axes in panels[len(kinds) :]:
        axes.set_visible(False)
    legend_above(figure, panels[0].get_legend_handles_labels()[0])
    words = {kind: KINDS[kind].words.format(" / ".join(one.short for one in asked)) for kind, asked in kinds.items()}
    return Drawn(figure, caption("robustness", found.clean, kinds=words))
