"""Time and memory of indexes against the number of places, both logarithmic: what a map costs as it grows."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import sqrt

from matplotlib.lines import Line2D

from vprbench.errors import BadInput
from vprbench.paper.figures.log_axis import plain_log
from vprbench.paper.figures.style import DOUBLE_MM, Drawn, legend_above, looks, new, styled

_HEIGHT_MM = 50.0  # of a row of panels
_MOST = 4  # columns of panels


@dataclass(frozen=True)
class MapCost:
    """What an index costs on one map."""

    index: str
    n_dimensions: int
    n_places: int
    building_seconds: float
    query_seconds: float
    memory_bytes: float


@styled
def maps(costs: Sequence[MapCost]) -> Drawn:
    """Draw building time, time of a single query and memory, from above, of descriptors of different lengths.

    Of more than four lengths the shortest, the longest and two between are shown. Raises BadInput if there is nothing.
    """
    if not costs:
        raise BadInput("no index was measured: there is nothing to draw")
    lengths = sorted({cost.n_dimensions for cost in costs})
    if len(lengths) > _MOST:
        lengths = [lengths[round(i * (len(lengths) - 1) / (_MOST - 1))] for i in range(_MOST)]
    places = [cost.n_places for cost in costs]
    room = max(1.6, 20 / sqrt(max(places) / min(places)))  # so wide that the numbers of decades alone stand at the axis
    looked = looks([cost.index for cost in costs])
    figure, axes = new(DOUBLE_MM, 3 * _HEIGHT_MM, 3, len(lengths))
    rows: tuple[tuple[str, Callable[[MapCost], float]], ...] = (
        ("Building (s)", lambda cost: cost.building_seconds),
        ("One query (ms)", lambda cost: 1e3 * cost.query_seconds),
        ("Memory in answers (MB)", lambda cost: cost.memory_bytes / 1e6),
    )
    for number, panel in enumerate(axes):
        (label, value), length = rows[number // len(lengths)], lengths[number % len(lengths)]
        for name, look in looked.items():
            shown = sorted((c.n_places, value(c)) for c in costs if (c.index, c.n_dimensions) == (name, length))
            panel.plot(
                *zip(*shown, strict=True) if shown else ([], []),
                color=look.colour,
                marker=look.marker,
                linestyle=look.dash,
            )
        plain_log(panel, "x", places, room, room)
        plain_log(panel, "y", [value(cost) for cost in costs])
        panel.set(title=f"{length:,} numbers" if number < len(lengths) else "")
        panel.set(xlabel="Places" if number >= 2 * len(lengths) else "", ylabel="" if number % len(lengths) else label)
        panel.grid(visible=True)
    legend_above(
        figure,
        [
            Line2D([], [], color=look.colour, marker=look.marker, linestyle=look.dash, label=name)
            for name, look in looked.items()
        ],
    )
    return Drawn(
        figure,
        "Building time, time of one query and anonymous memory while answering: indexes of simulated descriptors of "
        "different lengths, against the number of places; both axes are logarithmic.",
    )
