"""Time against the number of places, with the laws of growth fitted to it: Figure 2C of the paper."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from vprbench.errors import BadInput
from vprbench.metrics.growth import LAWS, Comparison, Law, compare
from vprbench.paper.figures.captions import caption
from vprbench.paper.figures.style import (
    DOUBLE_MM,
    GREY,
    Dash,
    Drawn,
    Look,
    legend_above,
    looks,
    new,
    plain_log,
    styled,
    wrapped,
)
from vprbench.paper.growth import GrowthSamples, Sample
from vprbench.paper.selection import Series
from vprbench.runs.stream import stream_numbers

_CLAIMS: dict[str, tuple[Law, Law]] = {"VPRTempo": ("linear", "logarithmic")}  # by the paper: training, query
_DASHES: dict[Law, Dash] = {"constant": (0, (1, 2)), "logarithmic": (0, (4, 2)), "linear": (0, ())}
_ORDER: dict[Law, str] = {"constant": "O(1)", "logarithmic": "O(log n)", "linear": "O(n)"}
_MS = 1e3  # milliseconds of a second
_HEIGHT_MM = 74.0  # without the legend
_LINE_MM = 4.2  # of the legend
_LETTERS = 52  # of a line of it


@dataclass(frozen=True)
class _Fitted:
    """The samples of a row with the laws fitted to them; None if they are too few to tell laws apart."""

    samples: GrowthSamples
    claims: tuple[Law | None, Law | None]  # of the paper: training, query
    training: Comparison | None
    query: Comparison | None


@styled
def growth(rows: Sequence[GrowthSamples]) -> Drawn:
    """Draw training time (left) and the time of a query (right) against the number of places, with fitted laws.

    One row shows all laws, several rows the best law of each. Raises BadInput if there is no row.
    """
    if not rows:
        raise BadInput("no run with different numbers of places is stored: there is no growth to draw")
    figure, (left, right) = new(DOUBLE_MM, _HEIGHT_MM, 1, 2)
    looked = looks([row.name for row in rows])
    fitted = list(map(_fitted, rows))
    for row in fitted:
        samples, look = row.samples, looked[row.samples.name]
        name = "" if len(rows) == 1 else samples.name
        _draw_points(left, samples.training, 1, look, _label(name, "training", row.training))
        _draw_laws(left, samples.training, row.training, 1, look, name)
        _draw_points(right, samples.query, _MS, look, _label(name, "encode and match", row.query))
        _draw_laws(right, samples.query, row.query, _MS, look, name)
    left.set(xlabel="Places", ylabel="Training time (s)", title="Training")
    right.set(xlabel="Places", ylabel="Time of a query (ms)", title="Query")
    lines = _finish(left, [sample for row in rows for sample in row.training], 1, "nothing was trained")
    queries = [sample for row in rows for sample in row.query]
    lines = max(lines, _finish(right, queries, _MS, "nothing was timed"))
    figure.set_figheight((_HEIGHT_MM + lines * _LINE_MM) / 25.4)
    runs = [run for row in rows for run in row.runs]
    told = {
        "datasets": [run.dataset for run in runs],
        "sizes": sorted({run.outcome.n_places for run in runs}),
        "disturbed": [(row.name, sizes) for row in rows if (sizes := _disturbed(row))],
        "several_seeds": any(len({run.config["seed"] for run in row.runs}) > 1 for row in rows),
    }
    return Drawn(figure, caption("growth", rows, rows=fitted, orders=_ORDER, **told))


@styled
def growing_map(series: Sequence[Series]) -> Drawn:
    """Draw recall at 1 (left) and the time of a new place (right) over the places of a map that grew one by one.

    Of several seeds the first that did. Raises BadInput if no run did.
    """
    grown = {one.name: run for one in series for run in reversed(one.runs) if run.stream}
    if not grown:
        raise BadInput("no map grew while it was asked: give a run stream=true")
    figure, (left, right) = new(DOUBLE_MM, _HEIGHT_MM, 1, 2)
    for name, look in looks([*grown]).items():
        stops = stream_numbers(grown[name])
        places = [stop["places"] for stop in stops]
        style: dict[str, Any] = {"color": look.colour, "marker": look.marker}
        for of, dash, label in (("", "-", name), ("_of_first", ":", f"{name}, of the first {places[0]:,}")):
            shares = np.array([stop[f"recall_at_1{of}"] for stop in stops], np.float64)  # NaN where nothing was asked
            left.plot(places, 100 * shares, linestyle=dash, label=label, **style)
        right.plot(places[1:], [_MS * stop["seconds_a_place"] for stop in stops[1:]], **style)
    left.set(xlabel="Places in the map", ylabel="Recall at 1 (%)", ylim=(0, 102))
    right.set(xlabel="Places in the map", ylabel="Time of a new place (ms)", yscale="log")
    legend_above(figure, left.get_legend_handles_labels()[0])
    return Drawn(figure, caption("growing_map", [one for one in series if one.name in grown]))


def _fitted(row: GrowthSamples) -> _Fitted:
    claims = _CLAIMS.get(row.name, (None, None))
    return _Fitted(row, claims, _compared(row.training), _compared(row.query))


def _compared(samples: Sequence[Sample]) -> Comparison | None:
    """Compare the laws; None if the samples are too few to tell them apart."""
    try:
        return compare([sample.n_places for sample in samples], [sample.seconds for sample in samples])
    except BadInput:
        return None


def _label(name: str, step: str, comparison: Comparison | None) -> str:
    """Return what stands in the legend beside points: of a row among others its name and best law."""
    if comparison is None:
        return name or step
    exponent = comparison.exponent
    told = f"exponent {exponent.value:.2f} [{exponent.low:.2f}, {exponent.high:.2f}]"
    return f"{name}: {comparison.best}, {told}" if name else f"{step}, {told}"


def _draw_points(axes: Axes, samples: Sequence[Sample], unit: float, look: Look, label: str) -> None:
    """Draw times with their intervals; the disturbed ones are hollow."""
    for disturbed in (False, True):
        drawn = [sample for sample in samples if sample.disturbed is disturbed]
        if not drawn:
            continue
        ends = [[s.seconds - (s.low or s.seconds), (s.high or s.seconds) - s.seconds] for s in drawn]
        axes.errorbar(
            [sample.n_places for sample in drawn],
            [unit * sample.seconds for sample in drawn],
            unit * np.array(ends).T,
            color=look.colour,
            marker=look.marker,
            markerfacecolor="white" if disturbed else look.colour,
            linestyle="none",
            label=label,
            zorder=3,
        )
        label = ""  # once in the legend


def _draw_laws(
    axes: Axes, samples: Sequence[Sample], comparison: Comparison | None, unit: float, look: Look, name: str
) -> None:
    """Draw the best law, and thinly the others with a key for each where the row is alone and so has no name."""
    if comparison is None:
        return
    fewest, *_, most = sorted(sample.n_places for sample in samples)
    places = np.geomspace(fewest, most, 200)
    for law in sorted(LAWS, key=lambda law: comparison.fits[law].aicc):
        best = law == comparison.best
        if best or not name:
            verdict = "lowest AICc" if best else f"AICc higher by {comparison.differences[law]:.1f}"
            axes.plot(
                places,
                unit * comparison.fits[law].at(places),
                color=look.colour if best else GREY,
                linestyle=_DASHES[law],
                linewidth=1.8 if best else 0.9,
                label="" if name else f"{law}, {verdict}",
                zorder=2 if best else 1,
            )


def _finish(axes: Axes, samples: Sequence[Sample], unit: float, nothing: str) -> int:
    """Scale the axes and write the legend below them; returns how many lines it has."""
    if not samples:
        axes.text(0.5, 0.5, nothing, transform=axes.transAxes, ha="center", color=GREY, style="italic")
        axes.set(xticks=[], yticks=[])
        return 0
    plain_log(axes, "x", [sample.n_places for sample in samples])
    plain_log(axes, "y", [unit * sample.seconds for sample in samples])
    axes.grid(True)
    handles, labels = axes.get_legend_handles_labels()
    points_first = sorted(range(len(handles)), key=lambda i: isinstance(handles[i], Line2D))
    texts = [wrapped(labels[i], _LETTERS) for i in points_first]
    axes.legend(
        [handles[i] for i in points_first],
        texts,
        loc="upper left",
        bbox_to_anchor=(-0.02, -0.2),
        borderaxespad=0,
    )
    return sum(1 + text.count("\n") for text in texts)


def _disturbed(row: GrowthSamples) -> list[str]:
    """Return the sizes whose times were disturbed."""
    return [f"{n:,}" for n in sorted({s.n_places for s in (*row.training, *row.query) if s.disturbed})]
