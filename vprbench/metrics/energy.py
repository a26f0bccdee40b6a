"""Joules of arithmetic by a table of costs: an estimate, which leaves out memory and all else around it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from vprbench.api.arithmetic import Arithmetic, Kind

#: Picojoules of a single operation and of a multiply-add in 45 nm (Horowitz, ISSCC 2014); 64 bits are priced as 32.
PICOJOULES: Mapping[Kind, tuple[float, float]] = {
    **dict.fromkeys(("float64", "float32"), (0.9, 0.9 + 3.7)),
    **dict.fromkeys(("int64", "int32"), (0.1, 0.1 + 3.1)),
    "int8": (0.03, 0.1 + 0.2),  # summed in 32 bits
}


def estimated_joules(arithmetic: Iterable[Arithmetic]) -> float:
    """Return the joules of some arithmetic."""
    prices = [(each, *PICOJOULES[each.kind]) for each in arithmetic]
    return 1e-12 * sum(each.single * single + each.multiply_adds * both for each, single, both in prices)


def synaptic_operations(spikes: Mapping[str, Any] | None) -> tuple[float, float] | None:
    """Return the accumulates and the multiply-accumulates of a query, of what a run keeps of spikes; None without any.

    NeuroBench's SynOps (2.3.0): a spike costs one for each synapse of a weight other than 0 that it reaches, an
    accumulate where all spikes are alike, a multiply-accumulate where they have amplitudes.
    """
    layers = [] if spikes is None else [layer for layer in spikes["layers"] if "synops" in layer]
    alike, graded = (sum(layer["synops"] for layer in layers if layer["operation"] == kind) for kind in ("AC", "MAC"))
    return (alike, graded) if layers else None
