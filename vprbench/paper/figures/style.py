"""What all figures share: sizes, type, looks that read in colour and in grey, and files whose bytes repeat."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial, wraps
from io import BytesIO
from math import ceil, log10, sqrt
from pathlib import Path
from textwrap import fill
from typing import Any, Literal, ParamSpec

import matplotlib.style
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure as Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from vprbench.errors import BadInput
from vprbench.storage.atomic import replace_bytes
from vprbench.text import find_exponent, format_three_digits

logging.getLogger("fontTools").setLevel(logging.WARNING)  # it tells every glyph that it embeds

SINGLE_MM = 88.0  # one column of a two-column page
DOUBLE_MM = 180.0  # both columns
GREY = "#6E6E6E"  # of what is no method: fronts, chance, annotations

Dash = tuple[int, tuple[float, ...]]  # offset, then lengths of lines and gaps in line widths; () is a solid line
Arguments = ParamSpec("Arguments")

_SETTINGS: dict[str, Any] = {
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],  # comes with matplotlib: the same glyphs on every machine
    "font.size": 8,
    "axes.labelsize": 8,
    "axes.titlesize": 8,
    "axes.titlelocation": "left",
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "legend.fontsize": 7,
    "legend.frameon": False,
    "legend.handlelength": 2.8,  # long enough for a whole dash
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.6,
    "axes.axisbelow": True,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.minor.width": 0.4,
    "ytick.minor.width": 0.4,
    "grid.color": "#DDDDDD",
    "grid.linewidth": 0.5,
    "lines.linewidth": 1.2,
    "lines.markersize": 4,
    "errorbar.capsize": 2,
    "hatch.linewidth": 0.6,
    "image.cmap": "gray",
    "pdf.fonttype": 42,  # TrueType: publishers refuse Type 3
    "savefig.dpi": 300,
}


class NotebookFigure(Figure):
    """A figure that a notebook shows."""

    def _repr_png_(self) -> bytes:
        return _saved(self, "png", {"Software": None})


@dataclass(frozen=True)
class Drawn:
    """A figure and its caption in full sentences."""

    figure: Figure
    caption: str


@dataclass(frozen=True)
class Look:
    """How one method looks in every figure: no two rely on colour alone."""

    colour: str
    marker: str
    dash: Dash
    hatch: str


# Colours of Okabe and Ito (2008), without their yellow, which is too light for a line on white paper; the last five of
# the further ones are of Paul Tol's muted scheme, made for colour-blind readers too.
_PAPER = {
    "SAD": Look("#56B4E9", "o", (0, (1.5, 1.2)), "...."),
    "NetVLAD": Look("#0072B2", "s", (0, (5, 1.5)), "\\\\\\\\"),
    "GCL": Look("#E69F00", "^", (0, (5, 1.5, 1.2, 1.5)), "xxxx"),
    "VPRSNN": Look("#000000", "v", (0, (9, 2)), "----"),
    "VPRTempo": Look("#D55E00", "D", (0, ()), "////"),
}
_COLOURS = ("#009E73", "#CC79A7", "#332288", "#999999", "#882255", "#999933", "#117733", "#AA4499")
_MARKERS = ("P", "X", "<", ">", "h", "p", "d", "*", "8")
_DASHES: tuple[Dash, ...] = (
    *((0, (3, 1, 1, 1, 1, 1)), (0, (7, 2, 2, 2)), (0, (1, 2.5)), (0, (3, 3)), (0, ())),
    *((0, (12, 2, 1, 2)), (0, (2, 1)), (0, (6, 1, 1, 1, 1, 1, 1, 1)), (0, (10, 4)), (0, (4, 1, 4, 1, 1, 1))),
)
_HATCHES = ("++++", "oo", "||||", "**", "OO", "|-|-", "/.", "\\+")

_LETTER_MM = 1.3  # of a legend's type
_KEY_MM = 13.0  # before a label, and after it
_LEGEND_ROW_MM = 3.9


def look(name: str) -> Look:
    """Return the look of one of the paper's rows; of any other method the first of the further looks."""
    return looks([name])[name]


def looks(names: Sequence[str]) -> dict[str, Look]:
    """Return a look for each name: fixed ones for the paper's rows, further ones for others in their order.

    Up to 360 others look different, the first eight of them in every part. Give the same names to figures that stand
    side by side.
    """
    others = [name for name in dict.fromkeys(names) if name not in _PAPER]
    further = {
        name: Look(
            _COLOURS[i % len(_COLOURS)],
            _MARKERS[i % len(_MARKERS)],
            _DASHES[i % len(_DASHES)],
            _HATCHES[i % len(_HATCHES)],
        )
        for i, name in enumerate(others)
    }
    return {name: _PAPER.get(name) or further[name] for name in dict.fromkeys(names)}


def styled(draw: Callable[Arguments, Drawn]) -> Callable[Arguments, Drawn]:
    """Draw in the type and lines of this module, whatever matplotlib's own settings are; for every figure function."""

    @wraps(draw)
    def in_style(*given: Arguments.args, **named: Arguments.kwargs) -> Drawn:
        with matplotlib.style.context(_SETTINGS, after_reset=True):
            return draw(*given, **named)

    return in_style


def new(width_mm: float, height_mm: float, rows: int = 1, columns: int = 1) -> tuple[Figure, tuple[Axes, ...]]:
    """Return an empty figure and its axes, row by row; labels make room for themselves within the given size."""
    with matplotlib.style.context(_SETTINGS, after_reset=True):
        figure = NotebookFigure(figsize=(width_mm / 25.4, height_mm / 25.4), layout="constrained")
        FigureCanvasAgg(figure)
        return figure, tuple(figure.subplots(rows, columns, squeeze=False).flat)


def legend_above(figure: Figure, handles: Sequence[Any]) -> None:
    """Add a legend above the panels and the height that it takes, in as many columns as its labels leave room for."""
    width = figure.get_figwidth() * 25.4
    labels = [wrapped(str(handle.get_label()), int((width - _KEY_MM) / _LETTER_MM)) for handle in handles]
    longest = max(len(line) for label in labels for line in label.split("\n"))
    columns = max(1, min(len(labels), int(width / (_KEY_MM + _LETTER_MM * longest))))
    n_rows = -(-len(labels) // columns) * max(1 + label.count("\n") for label in labels)
    figure.set_figheight(figure.get_figheight() + n_rows * _LEGEND_ROW_MM / 25.4)
    figure.legend(handles, labels, loc="outside upper left", ncols=columns)


def wrapped(text: str, letters: int) -> str:
    """Return text in lines of at most so many letters."""
    return fill(text, max(letters, 1))


def png(drawn: Drawn) -> bytes:
    """Return a figure as PNG, 300 dots per inch, its caption as the description; the same bytes for the same data."""
    return _saved(drawn.figure, "png", {"Software": None, "Description": drawn.caption})


def pdf(drawn: Drawn) -> bytes:
    """Return a figure as PDF, its caption as the subject; the same bytes for the same data."""
    return _saved(drawn.figure, "pdf", {"CreationDate": None, "Subject": drawn.caption})


def write(drawn: Drawn, folder: Path, name: str) -> tuple[Path, Path]:
    """Write `<name>.pdf` and `<name>.png` into a folder, made where missing; raises BadInput if the disk refuses."""
    paths = folder / f"{name}.pdf", folder / f"{name}.png"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for path, content in zip(paths, (pdf(drawn), png(drawn)), strict=True):
            replace_bytes(path, content)
    except OSError as error:
        raise BadInput(
            f"figure {name} could not be written to {folder} ({error.strerror or error}): choose another folder"
        ) from error
    return paths


def _saved(figure: Figure, kind: str, metadata: dict[str, Any]) -> bytes:
    content = BytesIO()
    with matplotlib.style.context(_SETTINGS, after_reset=True):
        figure.savefig(content, format=kind, metadata=metadata)
    return content.getvalue()


_NARROWEST = 20.0  # the highest end over the lowest
_FEW_DECADES = 2.5  # below it the axis names 2 and 5 as well
_DIGIT_POINTS = 4.6  # width of a digit of a number at a tick, with some room between the numbers


def plain_log(
    axes: Axes, which: Literal["x", "y"], values: Iterable[float], below: float = 1.6, above: float = 1.6
) -> None:
    """Make one axis logarithmic around `values`, with room for a factor `below` and `above` them."""
    known = [value for value in values if value > 0]
    low, high = min(known) / below, max(known) * above
    if high / low < _NARROWEST:
        widening = sqrt(_NARROWEST / (high / low))
        low, high = low / widening, high * widening
    axis = axes.xaxis if which == "x" else axes.yaxis
    axes.set(**{f"{which}scale": "log", f"{which}lim": (low, high)})
    labelled = (1.0, 2.0, 5.0) if log10(high / low) < _FEW_DECADES else (1.0,)
    axis.set_major_locator(LogLocator(subs=labelled, numticks=20))
    axis.set_minor_locator(LogLocator(subs=range(2, 10), numticks=20))
    axis.set_major_formatter(
        FuncFormatter(partial(_label, axis) if which == "x" else lambda value, _: format_three_digits(value))
    )
    axis.set_minor_formatter(NullFormatter())


def _label(axis: Axis, value: float, _: int | None) -> str:
    """Return the number at a tick; of decades too near for all their numbers, every second, or every third."""
    low, high = axis.get_view_interval()
    longest = _DIGIT_POINTS * max(len(format_three_digits(10.0 ** find_exponent(end, 2))) for end in (10 * low, high))
    points = axis.axes.get_window_extent().transformed(axis.axes.figure.dpi_scale_trans.inverted()).width * 72
    decade = points / log10(high / low)
    return "" if find_exponent(value, 2) % ceil(longest / decade) else format_three_digits(value)
