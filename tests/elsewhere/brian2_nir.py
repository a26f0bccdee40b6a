"""A network of NIR asked in Brian2, in a Python of its own: `brian2_nir.py NET.nir INPUTS.npy SCORES.npy`.

Inputs are (n, n_in), scores (n, n_out). Every node after the first is neurons and synapses of the simulator.
"""

from __future__ import annotations

import sys

import brian2
import nir
import numpy as np


def chain(graph: nir.NIRGraph) -> list[nir.NIRNode]:
    """Return the nodes between input and output in their order."""
    after, name, nodes = dict(graph.edges), "input", []
    while (name := after[name]) != "output":
        nodes.append(graph.nodes[name])
    return nodes


def simulated(graph: nir.NIRGraph, inputs: np.ndarray) -> np.ndarray:
    """Return the mean output over the steps, limited as the file says."""
    first, *rest = chain(graph)
    told, neurons = graph.metadata, [node for node in rest if isinstance(node, nir.IF)]
    currents = inputs @ first.weight.T + first.bias
    if not neurons:  # nothing spikes
        for node in rest:
            currents = currents @ node.weight.T + node.bias
        return currents
    (spiking,), last = neurons, rest[-1]
    assert told["reset"] == "the threshold is subtracted"
    brian2.prefs.codegen.target = "numpy"  # needs no compiler
    brian2.defaultclock.dt = 1 * brian2.second
    features = brian2.NeuronGroup(
        len(first.bias),
        "dv/dt = r * current / second : 1\nr : 1\ncurrent : 1\nthreshold : 1",
        threshold="v > threshold",
        reset="v -= threshold",
        method="euler",
    )
    places = brian2.NeuronGroup(len(last.bias), "total : 1")
    synapses = brian2.Synapses(features, places, "w : 1", on_pre="total_post += w")
    to, of = np.nonzero(last.weight)
    synapses.connect(i=of, j=to)
    synapses.w = last.weight[to, of]
    features.r, features.threshold = spiking.r, spiking.v_threshold
    network = brian2.Network(features, places, synapses)
    scores = np.empty((len(inputs), len(last.bias)))
    for number, current in enumerate(currents):
        features.current, features.v, places.total = current, 0, 0
        network.run(told["steps"] * brian2.second)
        scores[number] = places.total / told["steps"] + last.bias
    return scores


if __name__ == "__main__":
    np.save(sys.argv[3], simulated(nir.read(sys.argv[1]), np.load(sys.argv[2])))
