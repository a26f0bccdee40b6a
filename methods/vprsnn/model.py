"""One network of VPRSNN: its arguments, and all that is drawn by chance from its seed."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from .arguments import Arguments
from .arrays import Scratch, State, Synapses, Train
from .input import generator_for, generator_of_image, spike_train
from .module import Module
from .physics import Physics, Traces, physics_of, steps, traces_of

_INPUT, _WEIGHTS, _DELAYS, _NEW_DELAYS = range(4)  # purposes of random numbers; an image's is 4


@dataclass
class Model(Arguments):
    """How the modules of one network are made, trained and asked; it is not changed once it is made."""

    @classmethod
    def of(cls, arguments: Arguments, **changes: Any) -> Self:
        """Return the model of these arguments, some of them changed."""
        return cls(**{**{each.name: getattr(arguments, each.name) for each in fields(Arguments)}, **changes})

    @cached_property
    def physics(self) -> Physics:
        """The constants in steps and factors."""
        return physics_of(self)

    @cached_property
    def traces(self) -> Traces:
        """The traces of plasticity."""
        return traces_of(self)

    @property
    def n_inputs(self) -> int:
        """The number of pixels."""
        return self.height * self.width

    @property
    def longest_delay(self) -> float:
        """The longest delay from the input in steps; 0: none."""
        return 0.0 if self.fast else self.input_delay_max_ms / self.time_step_ms

    def weights(self, module: int) -> npt.NDArray[np.float64]:
        """Return the weights before the training, (n_inputs, n_neurons)."""
        drawn = generator_for(self.seed, _WEIGHTS, module).random((self.n_inputs, self.n_excitatory))
        return self.weight_scale * (drawn + self.weight_offset)

    def delays(self, module: int, new: bool = False) -> npt.NDArray[np.int16]:
        """Return the delays from the input, (n_inputs, n_neurons) steps: uniform, rounded; `new` ones for queries."""
        generator = generator_for(self.seed, _NEW_DELAYS if new else _DELAYS, module)
        drawn = generator.random((self.n_inputs, self.n_excitatory)) * self.longest_delay
        return np.floor(drawn + 0.5).astype(np.int16)

    def spikes(self, module: int, images: Iterable[npt.NDArray[np.uint8]]) -> Iterator[Train]:
        """Yield the input spikes of one presentation after the other, of images (n_inputs,)."""
        generator = generator_for(self.seed, _INPUT, module)
        for levels in images:
            yield self._train(levels, generator)

    def query_spikes(self, images: Iterable[npt.NDArray[np.uint8]]) -> list[Train]:
        """Return the input spikes of queries, images (n_inputs,): the same for all modules, as of one camera."""
        return [self._train(levels, generator_of_image(self.seed, levels)) for levels in images]

    def _train(self, levels: npt.NDArray[np.uint8], generator: np.random.Generator) -> Train:
        return spike_train(levels, generator, self.levels_per_hz, self.physics.shown, self.physics.step_ms)

    def untrained(self) -> tuple[State, int]:
        """Return a module that is about to be trained, and the step: in the silence theta decays as it does later."""
        theta = self.theta_start_mv * self.physics.theta_keep ** steps(self.first_rest_ms, self.time_step_ms)
        return self.started(np.full(self.n_excitatory, theta))

    def started(self, theta: npt.NDArray[np.float64]) -> tuple[State, int]:
        """Return a module of thresholds `theta` (mV) after the silence that comes first, and the step then reached."""
        physics, silence = self.physics, steps(self.first_rest_ms, self.time_step_ms)
        state = State.at_rest(physics, theta, self.n_inputs)
        relaxed = (self.excitatory_start_mv - physics.e_rest) * (1 - physics.e_gain) ** silence
        state.v[:] = physics.e_rest + relaxed
        state.v_i[:] = self.inhibitory_start_mv
        state.left_i[:] = -1
        return state, silence

    def scratch(self, learning: bool) -> Scratch:
        """Return memory to simulate a module in."""
        return Scratch.of(self.physics, self.n_excitatory, self.n_inputs, round(self.longest_delay), learning)

    def module(self, synapses: Synapses, start: tuple[State, int], scratch: Scratch, learning: bool) -> Module:
        """Return a module that is to be simulated from a state and step on."""
        return Module(self.physics, self.traces, synapses, *start, scratch, learning)
