"""A compiled VPRSNN module as tests handle it: boolean input spikes, unpadded arrays, spikes with their steps."""

from types import SimpleNamespace

import numpy as np
import numpy.typing as npt
from vprsnn_constants import constants

from vprbench.methods.vprsnn.input import train_of
from vprbench.methods.vprsnn.module import Room, State, Synapses, Train, unpadded
from vprbench.methods.vprsnn.physics import physics_of, traces_of
from vprbench.methods.vprsnn.simulation import normalise, present

Floats = npt.NDArray[np.float64]
Spikes = npt.NDArray[np.bool_]  # (n_steps, n_inputs)
PIECE = 100  # steps in which no neuron can fire twice


class Module:
    """A module that is shown one image after the other, from a silence without beginning."""

    def __init__(
        self,
        weights: Floats,  # (n_inputs, n_neurons)
        theta: float | Floats = 20.0,
        delays: npt.NDArray[np.integer] | None = None,  # none: all arrive at once
        learning: bool = True,
        values: SimpleNamespace | None = None,
    ) -> None:
        values = constants() if values is None else values
        n_inputs, self.n = weights.shape
        delays = np.zeros(weights.shape, np.int16) if delays is None else delays.astype(np.int16)
        self.physics, self.traces, self.learning = physics_of(values), traces_of(values), learning
        self.synapses = Synapses.of(weights.astype(np.float64), delays)
        self.state = State.at_rest(self.physics, np.zeros(self.n) + theta, n_inputs)
        self.longest, self.n_inputs, self.now = int(delays.max()), n_inputs, 0

    @property
    def weights(self) -> Floats:
        return unpadded(self.synapses.weights, self.n)

    @property
    def theta(self) -> Floats:
        return self.state.theta[: self.n].copy()

    @property
    def v(self) -> Floats:
        return self.state.v[: self.n].copy()

    @property
    def counts(self) -> npt.NDArray[np.int32]:
        return self.state.counts[: self.n].copy()

    def normalise(self, total: float) -> None:
        normalise(self.synapses.weights, total)

    def show(self, spikes: Spikes | Train, resting: bool = True) -> npt.NDArray[np.int32]:
        """Return the counts (n_neurons,) of an image and of the rest before it.

        An image lasts as long as its `spikes`, or as the physics say where they come as a train.
        """
        physics = self.physics
        if not isinstance(spikes, Train):
            physics = physics._replace(shown=len(spikes))
            spikes = train_of(*np.nonzero(spikes), self.n_inputs, len(spikes))
        room = Room.of(physics, self.n, self.n_inputs, self.longest, self.learning)
        present(self.synapses, self.state, spikes, room, physics, self.traces, self.now, self.learning, resting)
        self.now += physics.shown + resting * physics.rest
        return self.counts

    def fire_times(self, spikes: Spikes) -> list[list[int]]:
        """Return the steps, counted from now, in which each neuron fires while an image is shown piece by piece.

        The pieces follow one another without a rest, so that no input may have a delay.
        """
        assert self.longest == 0
        fired: list[list[int]] = [[] for _ in range(self.n)]
        begin = self.now
        for first in range(0, len(spikes), PIECE):
            counts = self.show(spikes[first : first + PIECE], resting=False)
            assert counts.max() <= 1
            for j in np.flatnonzero(counts):
                fired[j].append(int(self.state.fired[j]) - begin)
        return fired


def silence(n_steps: int, n_inputs: int) -> Spikes:
    return np.zeros((n_steps, n_inputs), np.bool_)


def spikes_at(n_steps: int, n_inputs: int, *events: tuple[int, int]) -> Spikes:
    """Return input spikes given as (step, input)."""
    spikes = silence(n_steps, n_inputs)
    for step, source in events:
        spikes[step, source] = True
    return spikes
