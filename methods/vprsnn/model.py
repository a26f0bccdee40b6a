"""One network of VPRSNN: its arguments, all that its seed draws, and a module that is shown images."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from .arguments import Arguments
from .arrays import Scratch, State, Synapses, Train
from .input import draw_spike_train, make_generator, make_image_generator
from .physics import Physics, Traces, count_steps, make_physics, make_traces
from .simulation import find_largest, present, sum_arrivals

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
        return make_physics(self)

    @cached_property
    def traces(self) -> Traces:
        """The traces of plasticity."""
        return make_traces(self)

    @property
    def n_inputs(self) -> int:
        """The number of pixels."""
        return self.height * self.width

    @property
    def longest_delay(self) -> float:
        """The longest delay from the input in steps; 0: none."""
        return 0.0 if self.fast else self.input_delay_max_ms / self.time_step_ms

    def draw_weights(self, module: int) -> npt.NDArray[np.float64]:
        """Return the weights before the training, (n_inputs, n_neurons)."""
        drawn = make_generator(self.seed, _WEIGHTS, module).random((self.n_inputs, self.n_excitatory))
        return self.weight_scale * (drawn + self.weight_offset)

    def draw_delays(self, module: int, new: bool = False) -> npt.NDArray[np.int16]:
        """Return the delays from the input, (n_inputs, n_neurons) steps: uniform, rounded; `new` ones for queries."""
        generator = make_generator(self.seed, _NEW_DELAYS if new else _DELAYS, module)
        drawn = generator.random((self.n_inputs, self.n_excitatory)) * self.longest_delay
        return np.floor(drawn + 0.5).astype(np.int16)

    def draw_trains(self, module: int, images: Iterable[npt.NDArray[np.uint8]]) -> Iterator[Train]:
        """Yield the input spikes of one presentation after the other, of images (n_inputs,)."""
        generator = make_generator(self.seed, _INPUT, module)
        return (self._draw_train(levels, generator) for levels in images)

    def draw_query_trains(self, images: Iterable[npt.NDArray[np.uint8]]) -> list[Train]:
        """Return the input spikes of queries, images (n_inputs,): the same for all modules, as of one camera."""
        return [self._draw_train(levels, make_image_generator(self.seed, levels)) for levels in images]

    def _draw_train(self, levels: npt.NDArray[np.uint8], generator: np.random.Generator) -> Train:
        return draw_spike_train(levels, generator, self.levels_per_hz, self.physics.shown, self.physics.step_ms)

    def make_scratch(self, learning: bool) -> Scratch:
        """Return memory to simulate a module in."""
        return Scratch.of(self.physics, self.n_excitatory, self.n_inputs, round(self.longest_delay), learning)


class Module:
    """A module with its state at step `now`, and whether it learns from what it is shown."""

    def __init__(
        self,
        model: Model,
        synapses: Synapses,
        theta: npt.NDArray[np.float64] | None,
        scratch: Scratch,
        learning: bool,
    ) -> None:
        """Begin with the silence before all images, from thresholds `theta` (n_neurons,) mV; None: the untrained ones.

        In this silence untrained thresholds decay as they do later.
        """
        self._model, self._scratch, self._learning = model, scratch, learning
        self.synapses, self.now = synapses, count_steps(model.first_rest_ms, model.time_step_ms)
        physics = model.physics
        if theta is None:
            theta = np.full(model.n_excitatory, model.theta_start_mv * physics.theta_keep**self.now)
        self.theta = theta
        self.state = State.at_rest(physics, theta, model.n_inputs)
        relaxed = (model.excitatory_start_mv - physics.e_rest) * (1 - physics.e_gain) ** self.now
        self.state.v[:] = physics.e_rest + relaxed
        self.state.v_i[:] = model.inhibitory_start_mv
        self.state.left_i[:] = -1

    def rest(self) -> None:
        """Bring the module to rest at step 0, with the thresholds that it began with."""
        self.state, self.now = State.at_rest(self._model.physics, self.theta, self._model.n_inputs), 0

    def show(self, train: Train, resting: bool = True) -> None:
        """Show one image and, if `resting`, the rest that follows; `state` then has the counts."""
        physics, scratch = self._model.physics, self._scratch
        sum_arrivals(self.synapses, train, scratch.drive)
        if self._learning:
            find_largest(self.synapses.weights, scratch.largest)
        choices = self._learning, resting
        present(self.synapses, self.state, train, scratch, physics, self._model.traces, self.now, *choices)
        self.now += physics.shown + physics.rest if resting else physics.shown
