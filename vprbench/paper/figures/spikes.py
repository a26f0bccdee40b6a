"""How much spiking networks spike: in each layer for a query, and when each neuron spikes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter

from vprbench.errors import BadInput
from vprbench.paper.figures.captions import describe_runs, require_one_dataset
from vprbench.paper.figures.style import DOUBLE_MM, Drawn, Look, legend_above, looks, new, styled
from vprbench.paper.selection import Series
from vprbench.runs.record import Run
from vprbench.text import plural

_HEIGHT_MM = 56.0  # of a row of panels, without the legend
_COLUMNS = 4  # of panels, at most
_UPRIGHT = 3  # from more layers on, their names stand upright
_GROUP = 0.8  # of the distance of two layers, filled by the rows
_FILLED = 0.85  # of the room of a row
_WHISKERS = (5, 95)  # percentiles
_WIDE = 30  # from this ratio of the most to the fewest spikes on, a layer's axis is logarithmic

Layer = Mapping[str, Any]


@styled
def spike_statistics(series: Sequence[Series]) -> Drawn:
    """Draw, layer by layer, the spikes of a query in each row, and the share of neurons that spike.

    A box holds the sampled queries of all seeds; a bar is the mean over the seeds, its dots are the seeds. Rows
    without stored spikes are left out; raises BadInput if none has any, and for rows on different data.
    """
    styles = looks([row.name for row in series])
    rows = [Series(row.name, row.spiking, runs) for row in series if (runs := _with_spikes(row))]
    if not rows:
        raise BadInput("no stored run holds spikes: run a spiking method such as method=vprtempo, with force=true")
    require_one_dataset(rows, "spikes")
    names = list(dict.fromkeys(layer["name"] for row in rows for each in row.runs for layer in _layers(each)))
    lines = -(-(len(names) + 1) // _COLUMNS)
    columns = -(-(len(names) + 1) // lines)
    figure, cells = new(DOUBLE_MM, _HEIGHT_MM * lines, lines, columns)
    axes = cells[: len(names) + 1]
    for empty in cells[len(axes) :]:
        empty.remove()
    room = _GROUP / len(rows)
    for number, row in enumerate(rows):
        for position, name in enumerate(names):
            found = [layer for each in row.runs for layer in _layers(each) if layer["name"] == name]
            if found:
                _draw_box(axes[position], number, found, styles[row.name])
                x = position + (number - (len(rows) - 1) / 2) * room
                _draw_bar(axes[-1], x, room * _FILLED, found, styles[row.name])
    for panel, name in zip(axes, names, strict=False):
        panel.set(title=_title(name, rows), xticks=[], xlim=(-0.5, len(rows) - 0.5))
        _scale(panel, [layer for row in rows for each in row.runs for layer in _layers(each) if layer["name"] == name])
    for first in axes[:-1:columns]:
        first.set_ylabel("Spikes of a query")
    axes[-1].set(title="Neurons that\nspike (%)", ylim=(0, 103), xlim=(-0.5, len(names) - 0.5))
    axes[-1].set_xticks(range(len(names)), names, rotation=90 if len(names) > _UPRIGHT else 0)
    for panel in axes:
        panel.grid(True, axis="y")
    _legend(figure, rows, styles)
    caption = (
        "Spikes of a query in each layer: box from quartile to quartile with the median, whiskers from the "
        f"{_WHISKERS[0]}th to the {_WHISKERS[1]}th percentile. Last panel: share of neurons that spike in any sampled "
        f"query. Sampled: {'; '.join(map(_describe_sample, rows))}. "
    )
    return Drawn(figure, caption + describe_runs(rows, "a box holds all; bars are means, dots the seeds"))


def _with_spikes(row: Series) -> tuple[Run, ...]:
    return tuple(run for run in row.runs if run.spikes)


def _layers(run: Run) -> Sequence[Layer]:
    return run.spikes["layers"] if run.spikes else ()


def _draw_box(axes: Axes, x: float, layers: Sequence[Layer], look: Look) -> None:
    axes.boxplot(
        np.concatenate([layer["spikes_per_query"] for layer in layers]),
        positions=[x],
        widths=_GROUP * _FILLED,
        whis=_WHISKERS,
        showfliers=False,
        manage_ticks=False,
        patch_artist=True,
        boxprops={"facecolor": "white", "edgecolor": look.colour, "hatch": look.hatch},
        medianprops={"color": "black", "linewidth": 1.2},
        whiskerprops={"color": look.colour},
        capprops={"color": look.colour},
    )


def _draw_bar(axes: Axes, x: float, width: float, layers: Sequence[Layer], look: Look) -> None:
    shares = [100 * layer["active_share"] for layer in layers]
    axes.bar(x, np.mean(shares), width, facecolor="white", edgecolor=look.colour, hatch=look.hatch)
    if len(shares) > 1:
        axes.plot([x] * len(shares), shares, linestyle="", marker=look.marker, color="black", markersize=2.5)


def _scale(axes: Axes, layers: Sequence[Layer]) -> None:
    """Choose the axis of a layer: logarithmic if rows differ by far, with room for queries without a spike."""
    counts = np.concatenate([layer["spikes_per_query"] for layer in layers])
    if counts.max() >= _WIDE * max(counts.min(), 1):
        axes.set_yscale("symlog", linthresh=1)
        axes.set_ylim(0, 2 * counts.max())
    axes.yaxis.set_major_formatter(FuncFormatter(lambda spikes, _: f"{spikes:,g}"))


def _title(name: str, rows: Sequence[Series]) -> str:
    """Return a layer's name, with its number of neurons if all rows have as many."""
    neurons = {layer["neurons"] for row in rows for run in row.runs for layer in _layers(run) if layer["name"] == name}
    return f"{name},\n{plural(neurons.pop(), 'neuron')}" if len(neurons) == 1 else name


def _describe_sample(row: Series) -> str:
    """Return a row's name, the sampled queries of a seed, and the neurons of its layers."""
    queries = dict.fromkeys(f"{run.spikes['queries']:,}" for run in row.runs if run.spikes)
    neurons = ", ".join(f"{layer['name']} {layer['neurons']:,}" for layer in _layers(row.runs[0]))
    return f"{row.name}, {' and '.join(queries)} queries of a seed (neurons: {neurons})"


def _legend(figure: Figure, rows: Sequence[Series], styles: Mapping[str, Look]) -> None:
    handles = [
        Patch(facecolor="white", edgecolor=styles[row.name].colour, hatch=styles[row.name].hatch, label=row.name)
        for row in rows
    ]
    legend_above(figure, handles)


def in_time(series: Sequence[Series]) -> list[Series]:
    """Return the rows, and of them the runs, that hold spike times."""
    runs = [(row, [run for run in row.runs if run.spikes and "times" in run.spikes["layers"][0]]) for row in series]
    return [Series(row.name, row.spiking, tuple(timed)) for row, timed in runs if timed]


@styled
def raster(rows: Sequence[Series]) -> Drawn:
    """Draw when the neurons of each layer spike for one query, of the first run of rows that hold spike times."""
    layers = (rows[0].runs[0].spikes or {})["layers"]
    figure, axes = new(DOUBLE_MM, 30 * len(layers), len(layers))
    for panel, layer in zip(axes, layers, strict=True):
        neurons = np.flatnonzero(layer["times"])
        panel.scatter(np.array(layer["times"])[neurons], neurons, 1.5, color="black", linewidths=0)
        panel.set(title=f"{layer['name']}: {len(neurons):,} of {layer['neurons']:,} neurons spike", ylabel="Neuron")
        panel.set(xlim=(0, 1 + max(max(each["times"]) for each in layers)), ylim=(-1, layer["neurons"]))
    axes[-1].set_xlabel("Time step since the query was shown")
    caption = f"Spikes of {rows[0].name} for one query, a dot a neuron; an earlier spike is a larger amplitude. "
    return Drawn(figure, caption + describe_runs(rows[:1], "the first is drawn"))
