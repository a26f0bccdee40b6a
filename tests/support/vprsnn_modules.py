"""A compiled VPRSNN module as tests handle it: boolean input spikes, unpadded arrays, spikes with their steps."""

import numpy as np
import numpy.typing as npt

from vprbench.methods.vprsnn import module
from vprbench.methods.vprsnn.arguments import Arguments
from vprbench.methods.vprsnn.arrays import Scratch, State, Synapses, Train, unpadded
from vprbench.methods.vprsnn.physics import physics_of, traces_of
from vprbench.methods.vprsnn.synapses import normalise

Floats = npt.NDArray[np.float64]
Spikes = npt.NDArray[np.bool_]  # (n_steps, n_inputs)


class Module:
    """A module that is shown one image after the other, from a silence without beginning."""

    def __init__(self, weights, theta=20.0, delays=None, learning=True, values=None):
        """Take weights and delays, (n_inputs, n_neurons); without delays all spikes arrive at once."""
        values = Arguments() if values is None else values
        n_inputs, self.n = weights.shape
        delays = np.zeros(weights.shape, np.int16) if delays is None else delays.astype(np.int16)
        self.physics, self.traces, self.learning = physics_of(values), traces_of(values), learning
        self.synapses = Synapses.of(weights.astype(np.float64), delays)
        self.state = State.at_rest(self.physics, np.zeros(self.n) + theta, n_inputs)
        self.longest, self.n_inputs, self.now = int(delays.max()), n_inputs, 0

    weights = property(lambda self: unpadded(self.synapses.weights, self.n))
    theta = property(lambda self: self.state.theta[: self.n].copy())
    v = property(lambda self: self.state.v[: self.n].copy())
    counts = property(lambda self: self.state.counts[: self.n].copy())

    def normalise(self, total):
        normalise(self.synapses.weights, total)

    def show(self, spikes, resting=True):
        """Return the counts (n_neurons,) of an image, which lasts as long as its spikes, and of the rest before it."""
        physics = self.physics._replace(shown=len(spikes))
        scratch = Scratch.of(physics, self.n, self.n_inputs, self.longest, self.learning)
        shown = module.Module(physics, self.traces, self.synapses, self.state, self.now, scratch, self.learning)
        module.show(shown, train_of(*np.nonzero(spikes), self.n_inputs), resting)
        self.now = shown.now
        return self.counts


def train_of(steps, sources, n_inputs):
    """Return spikes that are given as (n_spikes,) steps and inputs."""
    by_step, by_source = np.lexsort((sources, steps)), np.lexsort((steps, sources))
    first = np.searchsorted(sources[by_source], np.arange(n_inputs + 1))
    arrays = steps[by_step], sources[by_step], first, steps[by_source]
    return Train(*(array.astype(np.int32) for array in arrays))


def silence(n_steps, n_inputs):
    return np.zeros((n_steps, n_inputs), np.bool_)


def spikes_at(n_steps, n_inputs, *events):
    """Return input spikes given as (step, input)."""
    spikes = silence(n_steps, n_inputs)
    for step, source in events:
        spikes[step, source] = True
    return spikes
