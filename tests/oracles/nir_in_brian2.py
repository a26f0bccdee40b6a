"""A graph of NIR in Brian2, in a Python of its own: `nir_in_brian2.py NET.nir INPUTS.npy (n, n_in) OUTPUTS.npy`."""

import sys

import brian2
import nir
import numpy as np
from nir_simulators import chain


def simulated(graph, inputs):
    """Show each input as a constant current; spikes pass synapses into the sums of the last node."""
    first, *rest = chain(graph)
    steps, last = int(graph.metadata["steps"]), rest[-1]
    currents = inputs @ first.weight.T + first.bias
    if not isinstance(rest[0], nir.IF):
        return currents @ last.weight.T + last.bias
    brian2.prefs.codegen.target = "numpy"  # needs no compiler
    brian2.defaultclock.dt = 1 * brian2.second
    neurons = brian2.NeuronGroup(
        len(first.bias),
        "dv/dt = r * current / second : 1\nr : 1 (constant)\ncurrent : 1 (constant)\nlimit : 1 (constant)",
        threshold="v > limit",
        reset="v -= limit",
        method="euler",
    )
    sums = brian2.NeuronGroup(len(last.bias), "total : 1")
    synapses = brian2.Synapses(neurons, sums, "w : 1 (constant)", on_pre="total_post += w")
    to, of = np.nonzero(last.weight)
    synapses.connect(i=of, j=to)
    synapses.w = last.weight[to, of]
    neurons.r, neurons.limit = rest[0].r, rest[0].v_threshold
    network = brian2.Network(neurons, sums, synapses)
    outputs = np.empty((len(inputs), len(last.bias)))
    for number, shown in enumerate(currents):
        neurons.v, neurons.current, sums.total = 0, shown, 0
        network.run(steps * brian2.second)
        outputs[number] = sums.total / steps + last.bias
    return outputs


if __name__ == "__main__":
    np.save(sys.argv[3], simulated(nir.read(sys.argv[1]), np.load(sys.argv[2])))
