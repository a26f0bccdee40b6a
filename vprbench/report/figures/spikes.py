"""How much spiking networks spike: in each layer for a query, and when each neuron spikes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.patches import Patch

from vprbench.report.figures import style
from vprbench.report.figures.captions import choose_runs, describe_runs
from vprbench.report.figures.style import Drawing, choose_looks, new_figure, use_style
from vprbench.report.selection import MethodRuns
from vprbench.runs.record import Run

_HEIGHT_MM = 52.0  # of a line of panels, without the legend
_COLUMNS = 2  # of panels: their type is as large as that of other figures
_UPRIGHT = 3  # from more layers on, their names stand upright
_GROUP = 0.8  # of the distance of two layers, filled by the rows
_FILLED = 0.85  # of the room of a row
_WHISKERS = (5, 95)  # percentiles
_WIDE = 30  # from this ratio of the most to the fewest spikes on, a layer's axis is logarithmic

Layer = Mapping[str, Any]


@use_style
def draw_spikes(series: Sequence[MethodRuns]) -> Drawing:
    """Draw, layer by layer, the spikes of a query in each row, and the share of neurons that spike.

    A box holds the sampled queries of all seeds; a bar is the mean over the seeds, its dots are the seeds. Rows
    without stored spikes are left out; raises BadInput if none has any.
    """
    looks = choose_looks(row.name for row in series)
    rows = choose_runs(series, _list_layers, "holds spikes: run a spiking method, such as method=vprtempo force=true")
    layers = [(row.name, layer) for row in rows for run in row.runs for layer in _list_layers(run)]
    names = list(dict.fromkeys(layer["name"] for _, layer in layers))
    n_lines = len(names) // _COLUMNS + 1
    figure, cells = new_figure(style.SINGLE_MM, _HEIGHT_MM * n_lines, n_lines, _COLUMNS)
    *panels, active = cells[: len(names) + 1]
    for empty in cells[len(names) + 1 :]:
        empty.remove()
    width = _GROUP / len(rows) * _FILLED
    for position, (panel, name) in enumerate(zip(panels, names, strict=True)):
        for number, row in enumerate(rows):
            seeds = [layer for owner, layer in layers if (owner, layer["name"]) == (row.name, name)]
            if not seeds:
                continue
            look = looks[row.name]
            panel.boxplot(
                np.concatenate([layer["spikes_per_query"] for layer in seeds]),
                positions=[number],
                widths=_GROUP * _FILLED,
                whis=_WHISKERS,
                showfliers=False,
                manage_ticks=False,
                patch_artist=True,
                boxprops=look.of_bar,
                medianprops={"color": "black", "linewidth": 1.2},
                whiskerprops={"color": look.colour},
                capprops={"color": look.colour},
            )
            x, shares = position + (number / len(rows) - 0.5) * _GROUP, [100 * layer["active_share"] for layer in seeds]
            active.bar(x, np.mean(shares), width, align="edge", **look.of_bar)
            if len(shares) > 1:
                active.plot(
                    [x + width / 2] * len(shares), shares, linestyle="", marker=".", color="black", markersize=3
                )
        neurons = sorted({layer["neurons"] for _, layer in layers if layer["name"] == name})
        panel.set(title=f"{name},\n{'/'.join(f'{count:,}' for count in neurons)} neurons", xticks=[])
        panel.set(xlim=(-0.5, len(rows) - 0.5), ylabel="" if position % _COLUMNS else "Spikes of a query")
        low, high = panel.dataLim.intervaly
        if high >= _WIDE * max(low, 1):
            panel.set_yscale("symlog", linthresh=1)
        panel.yaxis.set_major_formatter("{x:,g}")
        panel.grid(True, axis="y")
    active.set(title="Neurons that\nspike (%)", ylim=(0, 103), xlim=(-0.5, len(names) - 0.5))
    active.set_xticks(range(len(names)), names, rotation=90 if len(names) > _UPRIGHT else 0)
    active.grid(True, axis="y")
    keys = [Patch(label=row.name, **looks[row.name].of_bar) for row in rows]
    style.add_legend(figure, keys, rows[0].runs[0].dataset)
    queries = ", ".join(dict.fromkeys(f"{run.spikes['queries']:,}" for row in rows for run in row.runs if run.spikes))
    caption = (
        "Spikes of a query in each layer: box from quartile to quartile with the median, whiskers from the "
        f"{_WHISKERS[0]}th to the {_WHISKERS[1]}th percentile. Last panel: share of neurons that spike in any sampled "
        f"query, {queries} of a seed; bars are means, dots the seeds. {describe_runs(rows)}"
    )
    return Drawing(figure, caption)


def has_spike_times(run: Run) -> bool:
    """Tell whether a run holds when its neurons spike."""
    return any("times" in layer for layer in _list_layers(run))


@use_style
def draw_raster(series: Sequence[MethodRuns]) -> Drawing:
    """Draw when the neurons of each layer spike for one query, of the first run that holds it; BadInput for none."""
    rows = choose_runs(series, has_spike_times, "holds spike times: run method=vprtempo_latencies")
    layers = _list_layers(rows[0].runs[0])
    figure, panels = new_figure(style.DOUBLE_MM, 30 * len(layers), len(layers))
    for panel, layer in zip(panels, layers, strict=True):
        neurons = np.flatnonzero(layer["times"])
        panel.scatter(np.array(layer["times"])[neurons], neurons, 1.5, color="black", linewidths=0)
        panel.set(title=f"{layer['name']}: {len(neurons):,} of {layer['neurons']:,} neurons spike", ylabel="Neuron")
        panel.set(xlim=(0, 1 + max(max(each["times"]) for each in layers)), ylim=(-1, layer["neurons"]))
    panels[-1].set_xlabel("Time step since the query was shown")
    caption = (
        f"Spikes of {rows[0].name}, its first seed, for one query, a dot a neuron; an earlier spike is a larger "
        f"amplitude. {describe_runs(rows[:1])}"
    )
    return Drawing(figure, caption)


def _list_layers(run: Run) -> Sequence[Layer]:
    """Return the layers of a run's network; none for a run that holds no spikes."""
    layers: Sequence[Layer] = (run.spikes or {}).get("layers", ())
    return layers
