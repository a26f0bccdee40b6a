"""Spikes in time: when each neuron spikes for one query, and recall at 1 against the time steps that queries take."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from vprbench.errors import BadInput
from vprbench.paper.figures.captions import caption
from vprbench.paper.figures.style import DOUBLE_MM, SINGLE_MM, Drawn, legend_above, looks, new, styled
from vprbench.paper.selection import Series


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
    return Drawn(figure, caption("raster", rows[:1], name=rows[0].name))


@styled
def recall_at_step(rows: Sequence[Series]) -> Drawn:
    """Draw recall at 1 over time steps, and of queries that stop early over their mean steps, means over the seeds.

    Raises BadInput if no run was asked step by step.
    """
    figure, (axes,) = new(SINGLE_MM, 64)
    for name, look in looks([row.name for row in rows]).items():
        runs = [run for row in rows if row.name == name for run in row.runs]
        found: dict[str, list[tuple[float, float]]] = {}
        for each in (readout for run in runs for readout in run.readouts or () if "steps" in readout):
            found.setdefault(each["name"], []).append((np.mean(each["steps"]), 100 * np.mean(each["hits"])))
        points = {answer: np.mean(seeds, axis=0) for answer, seeds in found.items()}
        fixed = [point for answer, point in points.items() if answer.startswith("step ")]
        early = [point for answer, point in points.items() if not answer.startswith("step ")]
        axes.plot(*np.reshape(fixed, (-1, 2)).T, color=look.colour, linestyle=look.dash, label=name)
        axes.plot(*np.reshape(early, (-1, 2)).T, color=look.colour, linestyle="", marker=look.marker)
    if not any("steps" in each for row in rows for run in row.runs for each in run.readouts or ()):
        raise BadInput("no stored run was asked step by step: run it with readouts=true")
    axes.set(xlabel="Time steps since the query was shown", ylabel="Recall at 1 (%)", ylim=(0, 102))
    axes.grid(True)
    legend_above(figure, axes.get_legend_handles_labels()[0])
    return Drawn(figure, caption("recall_at_step", rows))
