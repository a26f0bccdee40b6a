"""Statistics of a network's spikes for the record of a run: plain values for each layer."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from vprbench.api.images import Images
from vprbench.api.method import LayerSpikes, Method
from vprbench.errors import BadInput
from vprbench.runs.notes import Note
from vprbench.runs.scorers import encode_sample


def count_spikes(method: Method, queries: Images) -> tuple[dict[str, Any] | None, tuple[Note, ...]]:
    """Return the statistics of a spiking network over queries spread over all; None, and a note, if counting fails."""
    if type(method).spikes is Method.spikes:
        return None, ()
    try:
        return summarise_spikes(method.spikes(encode_sample(method, queries))), ()
    except Exception as error:  # a plug-in may fail in any way, and its answers and times still stand
        reason = " ".join(str(error).split())
        return None, (Note("spikes", f"no spikes were counted ({type(error).__name__}: {reason})"),)


def summarise_spikes(layers: Sequence[LayerSpikes]) -> dict[str, Any] | None:
    """Return the statistics of layers over their queries, as plain values; None without a layer.

    Of each layer: `spikes_per_query`, the `active_share` of neurons that spiked for at least one query, and
    `amplitude_mean`, of all spikes, None if only their number is known or there is none; of timed spikes the `times`
    of all neurons for the query in the middle; where it leads on, the mean `synops` of a query, "AC" or "MAC" as
    NeuroBench tells them apart: an amplitude is multiplied. Raises BadInput for layers of different queries and for
    values that are not finite or below 0.
    """
    if not layers:
        return None
    counts = sorted({len(layer.values) for layer in layers})
    if len(counts) > 1 or any(layer.values.ndim != 2 for layer in layers):
        shapes = ", ".join(f"{layer.name} {layer.values.shape}" for layer in layers)
        raise BadInput(f"spikes of shapes {shapes} came; wanted (n_queries, n_neurons), all of the same queries")
    return {"queries": counts[0], "layers": [_summarise_layer(layer) for layer in layers]}


def _summarise_layer(layer: LayerSpikes) -> dict[str, Any]:
    values = np.asarray(layer.values)
    if not np.isfinite(values).all() or (values < 0).any():
        raise BadInput(f"the spikes of layer {layer.name} are not all finite and 0 or more")
    spiked = values > 0
    per_query = spiked if layer.kind == "amplitude" else values
    leads = layer.fan_out is not None
    synops = float((per_query @ np.asarray(layer.fan_out, np.float64)).mean()) if leads else 0.0
    operation = "MAC" if layer.kind == "amplitude" else "AC"
    return {
        "name": layer.name,
        "neurons": values.shape[1],
        "spikes_per_query": per_query.sum(1, dtype=np.float64).tolist(),
        "active_share": float(spiked.any(0).mean()) if values.size else 0.0,
        "amplitude_mean": float(values[spiked].mean(dtype=np.float64))
        if layer.kind == "amplitude" and spiked.any()
        else None,
        **({"times": layer.times[len(values) // 2].tolist()} if layer.times is not None else {}),
        **({"synops": synops, "operation": operation} if leads else {}),
    }
