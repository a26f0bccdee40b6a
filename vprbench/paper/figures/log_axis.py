"""Logarithmic axes with plain numbers, at least three of them however near the values lie."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from math import ceil, log10, sqrt
from typing import Literal

from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

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
    axis.set_major_formatter(FuncFormatter(partial(_label, axis) if which == "x" else lambda value, _: plain(value)))
    axis.set_minor_formatter(NullFormatter())


def plain(value: float) -> str:
    """Return a number to three significant digits, without powers of ten: "0.05", "353", "15,120"."""
    if value >= 100:
        return f"{value:,.0f}"
    text = f"{value:.{max(0, 2 - exponent_of(value))}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


def _label(axis: Axis, value: float, _: int | None) -> str:
    """Return the number at a tick; of decades too near for all their numbers, every second, or every third."""
    low, high = axis.get_view_interval()
    longest = _DIGIT_POINTS * max(len(plain(10.0 ** exponent_of(end))) for end in (10 * low, high))
    points = axis.axes.get_window_extent().transformed(axis.axes.figure.dpi_scale_trans.inverted()).width * 72
    decade = points / log10(high / low)
    return "" if exponent_of(value) % ceil(longest / decade) else plain(value)


def exponent_of(value: float) -> int:
    """Return the power of ten of a number's first digit, of 0 for 0."""
    return int(f"{value:.2e}".partition("e")[2])
