"""Spikes in time: when each neuron spikes for one query, and recall at 1 against the time steps that queries take."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from vprbench.errors import BadInput
from vprbench.paper.figures.captions import caption
from vprbench.paper.figures.style import DOUBLE_MM, SINGLE_MM, Drawn, legend_above, looks, new, styled
from vprbench.paper.selection import Series

_PANEL_MM, _HEIGHT_MM = 30.0, 64.0  # of a layer, and of the other figure without its legend


def in_time(series: Sequence[Series]) -> list[Series]:
    """Return the rows, and of them the runs, that hold spike times."""
    runs = [(row, [run for run in row.runs if run.spikes and "times" in run.spikes["layers"][0]]) for row in series]
    return [Series(row.name, row.spiking, tuple(timed)) for row, timed in runs if timed]


@styled
def raster(series: Sequence[Series]) -> Drawn:
    """Draw when the neurons of each layer spike for one query of the first run that holds spike times."""
    for row in in_time(series):
        layers = (row.runs[0].spikes or {})["layers"]
        figure, axes = new(DOUBLE_MM, _PANEL_MM * len(layers), len(layers))
        for panel, layer in zip(axes, layers, strict=True):
            neurons = np.flatnonzero(layer["times"])
            panel.scatter(np.array(layer["times"])[neurons], neurons, 1.5, color="black", linewidths=0)
            panel.set(title=f"{layer['name']}: {len(neurons):,} of {layer['neurons']:,} neurons spike", ylabel="Neuron")
            panel.set(xlim=(0, 1 + max(max(each["times"]) for each in layers)), ylim=(-1, layer["neurons"]))
        axes[-1].set_xlabel("Time step since the query was shown")
        return Drawn(figure, caption("raster", [row]))
    raise BadInput("no stored run holds spike times: run a method that has them, such as method=vprtempo_latencies")


@styled
def recall_at_step(series: Sequence[Series]) -> Drawn:
    """Draw recall at 1 of answers at each time step, and of queries that stop early at the steps of the mean query."""
    rows = [row for row in in_time(series) if all(run.readouts for run in row.runs)]
    if not rows:
        raise BadInput("no stored run was asked step by step: run method=vprtempo_latencies with readouts=true")
    figure, (axes,) = new(SINGLE_MM, _HEIGHT_MM)
    styles = looks([row.name for row in series])
    for row in rows:
        found: dict[str, list[tuple[float, float]]] = {}
        for each in (readout for run in row.runs for readout in run.readouts or () if "steps" in readout):
            found.setdefault(each["name"], []).append((np.mean(each["steps"]), 100 * np.mean(each["hits"])))
        look, (fixed, early) = styles[row.name], ([], [])
        for name, points in found.items():
            (fixed if name.startswith("step ") else early).append(np.mean(points, axis=0))
        axes.plot(*np.transpose(fixed), color=look.colour, linestyle=look.dash, label=row.name)
        axes.plot(*np.transpose(early), color=look.colour, linestyle="", marker=look.marker)
    axes.set(xlabel="Time steps since the query was shown", ylabel="Recall at 1 (%)", ylim=(0, 102))
    axes.grid(True)
    legend_above(figure, axes.get_legend_handles_labels()[0])
    return Drawn(figure, caption("recall_at_step", rows))
