"""The style of all figures: sizes, type, looks that read in colour and in grey, and files whose bytes repeat."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Sequence
from functools import cache
from io import BytesIO
from itertools import cycle
from math import ceil, log10, sqrt
from pathlib import Path
from textwrap import fill
from typing import Any, Literal, NamedTuple

import matplotlib.style
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure as Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from vprbench.text import format_three_digits

logging.getLogger("fontTools").setLevel(logging.WARNING)  # it logs every glyph that it embeds

SINGLE_MM = 88.0  # one column of a two-column page
DOUBLE_MM = 180.0  # both columns
GREY = "#6E6E6E"  # of what is no method: fronts, chance, annotations

#: A decorator of every function that draws: the type and lines of all figures, whatever matplotlib's settings are.
use_style = matplotlib.style.context(Path(__file__).with_name("figures.mplstyle"), after_reset=True)


class NotebookFigure(Figure):
    """A figure that a notebook shows."""

    def _repr_png_(self) -> bytes:
        return _render(self, "png", {"Software": None})


class Drawing(NamedTuple):
    """A figure and its caption in full sentences."""

    figure: Figure
    caption: str


class Look(NamedTuple):
    """How one method looks in every figure: no two rely on colour alone."""

    colour: str
    marker: str
    dash: tuple[int, tuple[float, ...]]  # offset, then lengths of lines and gaps in line widths; () is a solid line
    hatch: str

    @property
    def of_line(self) -> dict[str, Any]:
        """How a line with points is drawn."""
        return {"color": self.colour, "marker": self.marker, "linestyle": self.dash}

    @property
    def of_points(self) -> dict[str, Any]:
        """How points without a line are drawn."""
        return {"color": self.colour, "marker": self.marker, "linestyle": "none"}

    @property
    def of_bar(self) -> dict[str, Any]:
        """How a bar or a box is filled."""
        return {"facecolor": "white", "edgecolor": self.colour, "hatch": self.hatch}


# Colours of Okabe and Ito (2008), without their yellow, which is too light for a line on white paper; the last five of
# the further ones are of Paul Tol's muted scheme, made for colour-blind readers too.
_FIXED = {
    "SAD": Look("#56B4E9", "o", (0, (1.5, 1.2)), "...."),
    "NetVLAD": Look("#0072B2", "s", (0, (5, 1.5)), "\\\\\\\\"),
    "GCL": Look("#E69F00", "^", (0, (5, 1.5, 1.2, 1.5)), "xxxx"),
    "VPRSNN": Look("#000000", "v", (0, (9, 2)), "----"),
    "VPRTempo": Look("#D55E00", "D", (0, ()), "////"),
}
_COLOURS = ("#009E73", "#CC79A7", "#332288", "#999999", "#882255", "#999933", "#117733", "#AA4499")
_MARKERS = ("P", "X", "<", ">", "h", "p", "d", "*", "8")
_DASHES: tuple[tuple[int, tuple[float, ...]], ...] = (
    *((0, (3, 1, 1, 1, 1, 1)), (0, (7, 2, 2, 2)), (0, (1, 2.5)), (0, (3, 3)), (0, ())),
    *((0, (12, 2, 1, 2)), (0, (2, 1)), (0, (6, 1, 1, 1, 1, 1, 1, 1)), (0, (10, 4)), (0, (4, 1, 4, 1, 1, 1))),
)
_HATCHES = ("++++", "oo", "||||", "**", "OO", "|-|-", "/.", "\\+")

_LETTER_MM = 1.3  # of a legend's type
_KEY_MM = 13.0  # before a label, and after it
_LEGEND_ROW_MM = 3.9

_NARROWEST = 20.0  # the highest end of a logarithmic axis over the lowest
_FEW_DECADES = 2.5  # below it the axis names 2 and 5 as well
_MOST_DECADES = 5  # of more, every second or third is named


def choose_looks(names: Iterable[str]) -> dict[str, Look]:
    """Return a look for each name: fixed ones for common baselines, further ones for others in their order.

    Up to 360 others look different, the first eight of them in every part. Give the same names to figures that stand
    side by side.
    """
    further = map(Look, cycle(_COLOURS), cycle(_MARKERS), cycle(_DASHES), cycle(_HATCHES))
    return {name: _FIXED.get(name) or next(further) for name in dict.fromkeys(names)}


def new_figure(
    width_mm: float, height_mm: float, rows: int = 1, columns: int = 1, grid: bool = False, **subplots: Any
) -> tuple[Figure, tuple[Axes, ...]]:
    """Return an empty figure and its axes, row by row; labels make room for themselves within the given size.

    `subplots` are further arguments of `Figure.subplots`.
    """
    figure = NotebookFigure(figsize=(width_mm / 25.4, height_mm / 25.4), layout="constrained")
    FigureCanvasAgg(figure)
    panels = tuple(figure.subplots(rows, columns, squeeze=False, **subplots).flat)
    for axes in panels:
        axes.grid(grid)
    return figure, panels


def add_legend(figure: Figure, handles: Sequence[Any] = (), title: str = "") -> None:
    """Add a legend above the panels and the height that it takes, in as many columns as its labels leave room for.

    Without `handles` it names the lines of the first panel.
    """
    handles = handles or figure.axes[0].get_legend_handles_labels()[0]
    letters = int((figure.get_figwidth() * 25.4 - _KEY_MM) / _LETTER_MM)
    labels = [fill(str(handle.get_label()), letters) for handle in handles]
    columns = max(1, min(len(labels), letters // (max(map(len, labels)) + int(_KEY_MM / _LETTER_MM))))
    lines = ceil(len(labels) / columns) * max(1 + label.count("\n") for label in labels) + bool(title)
    figure.set_figheight(figure.get_figheight() + lines * _LEGEND_ROW_MM / 25.4)
    figure.legend(handles, labels, loc="outside upper left", ncols=columns, title=title or None, alignment="left")


def scale_log(axes: Axes, which: Literal["x", "y"], values: Iterable[float], room: float = 1.6) -> None:
    """Make one axis logarithmic around `values`, with room for a factor at both ends and plain numbers at its ticks."""
    known = [value for value in values if value > 0]
    low, high = min(known) / room, max(known) * room
    widening = max(1.0, sqrt(_NARROWEST / (high / low)))
    axes.set(**{f"{which}scale": "log", f"{which}lim": (low / widening, high * widening)})
    axis = axes.xaxis if which == "x" else axes.yaxis
    subs = (1.0, 2.0, 5.0) if log10(high / low) < _FEW_DECADES else (1.0,)
    axis.set_major_locator(LogLocator(subs=subs, numticks=_MOST_DECADES))
    axis.set_major_formatter(FuncFormatter(lambda value, _: format_three_digits(value)))
    axis.set_minor_formatter(NullFormatter())


@cache
def render_png(drawing: Drawing) -> bytes:
    """Return a figure as PNG, 300 dots per inch, its caption as the description; the same bytes for the same data.

    Its panels keep the places that they get here: a later PDF has the same layout.
    """
    png = _render(drawing.figure, "png", {"Software": None, "Description": drawing.caption})
    drawing.figure.set_layout_engine("none")
    return png


def render_pdf(drawing: Drawing) -> bytes:
    """Return a figure as PDF, its caption as the subject; the same bytes for the same data."""
    return _render(drawing.figure, "pdf", {"CreationDate": None, "Subject": drawing.caption})


@use_style
def _render(figure: Figure, kind: str, metadata: dict[str, Any]) -> bytes:
    content = BytesIO()
    figure.savefig(content, format=kind, metadata=metadata)
    return content.getvalue()
