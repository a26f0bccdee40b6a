"""How VPRSNN's modules are made and trained, and all that is drawn for them by chance."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from .input import generator_for, spike_train
from .module import State, Train
from .physics import Physics, Traces

_INPUT, _WEIGHTS, _DELAYS, _NEW_DELAYS = range(4)  # purposes of random numbers; an image's is 4


@dataclass(frozen=True)
class Recipe:
    """How modules are made and trained; durations in steps."""

    physics: Physics
    traces: Traces
    seed: int
    n_inputs: int
    n_neurons: int
    intensity: float  # grey levels for each Hz of the input
    longest_delay: float  # steps; 0: none
    weight_scale: float
    weight_offset: float
    weight_sum: float
    theta_start: float  # mV
    v_start: float  # mV
    v_start_inhibitory: float
    first_rest: int
    epochs: int
    recorded: int  # presentations, the last ones, by which neurons are assigned

    def weights(self, module: int) -> npt.NDArray[np.float64]:
        """Return the weights before the training, (n_inputs, n_neurons)."""
        drawn = generator_for(self.seed, _WEIGHTS, module).random((self.n_inputs, self.n_neurons))
        return self.weight_scale * (drawn + self.weight_offset)

    def delays(self, module: int, new: bool = False) -> npt.NDArray[np.int16]:
        """Return the delays from the input, (n_inputs, n_neurons) steps: uniform, rounded; `new` ones for asking."""
        generator = generator_for(self.seed, _NEW_DELAYS if new else _DELAYS, module)
        drawn = generator.random((self.n_inputs, self.n_neurons)) * self.longest_delay
        return np.floor(drawn + 0.5).astype(np.int16)

    def spikes(self, module: int, images: Iterable[npt.NDArray[np.uint8]]) -> Iterator[Train]:
        """Yield the input spikes of one presentation after the other, of images (n_inputs,)."""
        generator = generator_for(self.seed, _INPUT, module)
        for levels in images:
            yield spike_train(levels, generator, self.intensity, self.physics.shown, self.physics.step_ms)

    def untrained(self) -> tuple[State, int]:
        """Return a module that is about to be trained, and the step: in the silence theta decays as it does later."""
        theta = self.theta_start * self.physics.theta_keep**self.first_rest
        return self.started(np.full(self.n_neurons, theta))

    def started(self, theta: npt.NDArray[np.float64]) -> tuple[State, int]:
        """Return a module after the silence that comes first, and the step that is then reached."""
        physics = self.physics
        state = State.at_rest(physics, theta, self.n_inputs)
        state.v[:] = physics.e_rest + (self.v_start - physics.e_rest) * (1 - physics.e_gain) ** self.first_rest
        state.v_i[:] = self.v_start_inhibitory
        state.left_i[:] = -1
        return state, self.first_rest
