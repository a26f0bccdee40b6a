"""What is done to all synapses of a VPRSNN module before a presentation, by compiled loops."""

from __future__ import annotations

import numpy as np

from vprbench.api import compiled

from .arrays import SIDE


@compiled()
def normalise(weights, total):  # type: ignore[no-untyped-def]
    """Scale the weights of each neuron to the sum `total`, in place; one without weights stays without."""
    for block in range(weights.shape[0]):
        sums = np.zeros(SIDE)
        for i in range(weights.shape[1]):
            for k in range(SIDE):
                sums[k] += weights[block, i, k]
        for k in range(SIDE):
            sums[k] = total / sums[k] if sums[k] > 0 else 1.0
        for i in range(weights.shape[1]):
            for k in range(SIDE):
                weights[block, i, k] *= sums[k]


@compiled()
def sum_arrivals(synapses, train, drive):  # type: ignore[no-untyped-def]
    """Fill `drive` (n_blocks, n_steps, SIDE) with the weights that arrive at each neuron in each step."""
    for block in range(len(drive)):
        weights, delays, arriving = synapses.weights[block], synapses.delays[block], drive[block]
        arriving[:] = 0
        for spike in range(len(train.step)):
            step, source = np.uint64(train.step[spike]), np.uint64(train.source[spike])
            for k in range(SIDE):
                arriving[step + np.uint64(delays[source, k]), k] += weights[source, k]


@compiled()
def find_largest(weights, largest):  # type: ignore[no-untyped-def]
    """Write the largest weight of each neuron."""
    for block in range(weights.shape[0]):
        most = largest[block * SIDE : (block + 1) * SIDE]
        most[:] = 0.0
        for i in range(weights.shape[1]):
            for k in range(SIDE):
                most[k] = weights[block, i, k] if weights[block, i, k] > most[k] else most[k]
