from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import little
import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle

from vprbench.paper.figures.spikes import spike_statistics
from vprbench.paper.selection import Series
from vprbench.run.record import Run


def spiking(*layers: dict[str, Any], **changes: Any) -> Run:
    queries = len(layers[0]["spikes_per_query"])
    return little.a_run(spikes={"queries": queries, "layers": list(layers)}, **changes)


def layer(
    name: str, spikes_per_query: Sequence[float], active_share: float = 0.5, neurons: int = 100
) -> dict[str, Any]:
    return little.a_layer(name, neurons, list(spikes_per_query), active_share, None)


def panels(*rows: Series) -> list[Axes]:
    return spike_statistics(rows).figure.axes


def medians(axes: Axes) -> list[float]:
    """The heights of black lines: a box has one, at its median."""
    return [float(np.asarray(line.get_ydata())[0]) for line in axes.lines if line.get_color() == "black"]


def ends(axes: Axes) -> tuple[float, float]:
    """The lowest and the highest point of the lines, which are the whiskers'."""
    heights = np.concatenate([np.asarray(line.get_ydata()) for line in axes.lines])
    return float(heights.min()), float(heights.max())


def bars(axes: Axes) -> list[float]:
    return [patch.get_height() for patch in axes.patches if isinstance(patch, Rectangle)]


TEMPO = Series(
    "VPRTempo",
    True,
    (spiking(layer("input", [700, 710, 690], 1.0, 784), layer("output", [20, 30, 25], 0.25, 300)),),
)


def test_each_layer_has_a_box_at_the_median_of_its_queries_and_a_bar_of_its_active_neurons() -> None:
    first, output, active = panels(TEMPO)
    assert medians(first) == [700]
    assert medians(output) == [25]
    assert bars(active) == [100, 25]
    assert [tick.get_text() for tick in active.get_xticklabels()] == ["input", "output"]


def test_a_box_holds_the_middle_half_and_its_whiskers_nine_tenths_of_the_queries() -> None:
    axes, _ = panels(Series("VPRTempo", True, (spiking(layer("output", range(100, 201))),)))
    (box,) = axes.patches
    heights = box.get_path().vertices[:, 1]
    assert (heights[:4].min(), heights[:4].max()) == (125, 175)
    assert ends(axes) == (105, 195)


def test_queries_of_several_seeds_share_a_box_and_their_bar_is_the_mean_with_a_dot_each() -> None:
    seeds = [spiking(layer("output", [10, 10], 0.2)), spiking(layer("output", [14, 16], 0.4))]
    axes, active = panels(Series("VPRTempo", True, tuple(seeds)))
    assert medians(axes) == [12]  # of 10, 10, 14, 16
    assert bars(active) == pytest.approx([30])
    (dots,) = active.lines
    assert np.asarray(dots.get_ydata()).tolist() == [20, 40]


def test_rows_stand_side_by_side_in_their_order_and_differ_in_hatch() -> None:
    other = Series("VPRSNN", True, (spiking(layer("output", [50, 60, 70], 0.75)),))
    drawn = spike_statistics([other, TEMPO])
    output = next(axes for axes in drawn.figure.axes if axes.get_title(loc="left").startswith("output"))
    assert medians(output) == [60, 25]
    (legend,) = drawn.figure.legends
    assert [text.get_text() for text in legend.get_texts()] == ["VPRSNN", "VPRTempo"]
    assert len({patch.get_hatch() for patch in output.patches}) == 2


def test_a_layer_that_only_one_network_has_is_drawn_for_that_one_alone() -> None:
    other = Series("VPRSNN", True, (spiking(layer("inhibitory", [5, 6, 7], 0.5)),))
    _, _, inhibitory, active = panels(TEMPO, other)
    assert inhibitory.get_title(loc="left") == "inhibitory,\n100 neurons"
    assert medians(inhibitory) == [6]
    assert sorted(bars(active)) == [25, 50, 100]


def test_the_number_of_neurons_is_the_title_where_all_rows_have_as_many() -> None:
    other = Series(
        "VPRSNN", True, (spiking(layer("input", [5, 6], neurons=784), layer("output", [5, 6], neurons=400)),)
    )
    first, output, _ = panels(TEMPO, other)
    assert first.get_title(loc="left") == "input,\n784 neurons"
    assert output.get_title(loc="left") == "output"


def test_rows_that_differ_by_far_share_a_logarithmic_axis_that_has_room_for_silence() -> None:
    silent = Series("VPRSNN", True, (spiking(layer("output", [0, 0, 5000])),))
    axes, _ = panels(silent)
    assert axes.get_yscale() == "symlog"
    assert axes.get_ylim()[0] == 0
    axes, _ = panels(Series("VPRSNN", True, (spiking(layer("output", [10, 20, 40])),)))
    assert axes.get_yscale() == "linear"


def test_a_silent_layer_is_drawn() -> None:
    axes, active = panels(Series("VPRTempo", True, (spiking(layer("output", [0, 0, 0], 0.0)),)))
    assert medians(axes) == [0]
    assert bars(active) == [0]


def test_rows_without_stored_spikes_are_left_out() -> None:
    drawn = spike_statistics([Series("SAD", False, (little.a_run(spikes=None),)), TEMPO])
    assert [text.get_text() for text in drawn.figure.legends[0].get_texts()] == ["VPRTempo"]
