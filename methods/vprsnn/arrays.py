"""One module of VPRSNN as the compiled loops see it: synapses, state, input spikes, and memory to work in."""

from __future__ import annotations

from typing import Any, NamedTuple, Self

import numpy as np
import numpy.typing as npt

from .physics import Physics

Floats = npt.NDArray[np.float64]
Steps = npt.NDArray[np.int64]
Counts = npt.NDArray[np.int32]

SIDE = 8  # neurons whose weights lie side by side: a line of the cache
STRETCH = 512  # steps for which the input of a neuron that fired lately is summed
TILE = 64  # steps that are simulated from one look for silence to the next
NEVER = -(1 << 60)  # the step of an event that has not happened yet


class Synapses(NamedTuple):
    """The synapses from the input, (n_blocks, n_inputs, SIDE): neuron SIDE * block + k; those past the last weigh 0."""

    weights: Floats
    delays: npt.NDArray[np.int16]  # steps

    @classmethod
    def of(cls, weights: Floats, delays: npt.NDArray[np.int16]) -> Self:
        """Return the synapses of (n_inputs, n_neurons) weights and delays."""
        return cls(pack_neurons(weights), pack_neurons(delays))


class State(NamedTuple):
    """The state that a module carries from one presentation to the next; `NEVER`: an event has not happened."""

    v: Floats  # (n_padded,) mV, of excitatory neurons
    ge: Floats
    gi: Floats
    theta: Floats  # mV; infinite for neurons past the last, which thus never fire
    fired: Steps  # the step of each one's last spike
    v_i: Floats  # (n_padded,) mV, of inhibitory neurons
    ge_i: Floats
    fired_i: Steps
    left_i: Steps  # the step of which `v_i` is, where nothing acts on the neuron
    heard: Steps  # (n_inputs,) the step of each input's last spike
    counts: Counts  # (n_padded,) spikes of the last presentation and of the rest before it
    late: Counts  # spikes of the rest after it
    counts_i: Counts  # spikes of inhibitory neurons, as `counts`
    late_i: Counts

    @classmethod
    def at_rest(cls, physics: Physics, theta: Floats, n_inputs: int) -> Self:
        """Return a module whose neurons, of thresholds `theta` (mV), have been silent for ever."""
        n = pad_count(len(theta))
        return cls(
            v=np.full(n, physics.e_rest),
            ge=np.zeros(n),
            gi=np.zeros(n),
            theta=np.concatenate([theta, np.full(n - len(theta), np.inf)]),
            fired=np.full(n, NEVER),
            v_i=np.full(n, physics.i_rest),
            ge_i=np.zeros(n),
            fired_i=np.full(n, NEVER),
            left_i=np.zeros(n, np.int64),
            heard=np.full(n_inputs, NEVER),
            counts=np.zeros(n, np.int32),
            late=np.zeros(n, np.int32),
            counts_i=np.zeros(n, np.int32),
            late_i=np.zeros(n, np.int32),
        )


class Train(NamedTuple):
    """Input spikes of one presentation."""

    step: npt.NDArray[np.int32]  # (n_spikes,) rising
    source: npt.NDArray[np.int32]  # (n_spikes,) the input of each


class Scratch(NamedTuple):
    """Memory that a simulation works in; its earlier content does not matter."""

    drive: Floats  # (n_blocks, n_steps, SIDE) the input that arrives at each neuron
    tile: Floats  # (TILE, n_padded) the same for steps that come next
    row: Floats  # (n_steps,) the input that arrives at one neuron
    change: Floats  # (n_steps,) by how much its weights change with an arrival
    running: Floats  # (n_padded, n_inputs) weights that change, after all arrivals before step `until`
    settled: Floats  # (n_padded, n_inputs) the same before step `since`
    since: Steps  # (n_padded,)
    until: Steps  # (n_padded,) 0 for a neuron whose weights do not change
    passed: Steps  # (n_inputs,) the step of each input's last spike that has arrived everywhere
    last: Steps  # (n_inputs,)
    changing: Steps  # (n_padded,) neurons whose weights change
    waiting: Steps  # (n_padded,) neurons that may not fire yet
    firing: Steps
    largest: Floats  # (n_padded,) weight of each neuron: one above the limit is cut at its next arrival
    inhibiting: Steps  # (n_padded,) inhibitory neurons on which something acts
    limits: Floats  # (n_padded,) theta when the presentation began; infinite for those that may not fire

    @classmethod
    def of(cls, physics: Physics, n_neurons: int, n_inputs: int, longest_delay: int, learning: bool) -> Self:
        """Return memory for modules of this size."""
        n = pad_count(n_neurons)
        changing, n_steps = n if learning else 0, physics.shown + longest_delay
        return cls(
            drive=np.empty((n // SIDE, n_steps, SIDE)),
            tile=np.empty((TILE, n)),
            row=np.empty(n_steps),
            change=np.empty(n_steps),
            running=np.empty((changing, n_inputs)),
            settled=np.empty((changing, n_inputs)),
            since=np.empty(n, np.int64),
            until=np.empty(n, np.int64),
            passed=np.empty(n_inputs, np.int64),
            last=np.empty(n_inputs, np.int64),
            changing=np.empty(n, np.int64),
            waiting=np.empty(n, np.int64),
            firing=np.empty(n, np.int64),
            largest=np.empty(n),
            inhibiting=np.empty(n, np.int64),
            limits=np.empty(n),
        )


def pad_count(n_neurons: int) -> int:
    """Return the number of neurons rounded up to whole blocks of SIDE."""
    return -(-n_neurons // SIDE) * SIDE


def unpack_neurons(blocks: npt.NDArray[Any], n_neurons: int) -> npt.NDArray[Any]:
    """Return the array (n_inputs, n_neurons) that `pack_neurons` packed."""
    return np.ascontiguousarray(blocks.transpose(1, 0, 2).reshape(blocks.shape[1], -1)[:, :n_neurons])


def pack_neurons(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return (n_blocks, n_inputs, SIDE) of (n_inputs, n_neurons); neurons past the last are zero."""
    n_inputs, n_neurons = array.shape
    whole = np.zeros((n_inputs, pad_count(n_neurons)), array.dtype)
    whole[:, :n_neurons] = array
    return np.ascontiguousarray(whole.reshape(n_inputs, -1, SIDE).transpose(1, 0, 2))
