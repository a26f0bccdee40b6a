"""What trained modules answer: all of them see the same image, and nothing is learnt."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
import numpy.typing as npt
import torch

from vprbench.api import progress

from . import batched
from .input import generator_of_image, spike_train
from .module import Room, State, Synapses, Train, side_by_side, unpadded
from .network import Network
from .recipe import Recipe
from .scoring import hyperactive, labels
from .simulation import present
from .threads import Tell, for_each_module

_TOGETHER = 256  # images whose reactions are counted together: bounds the memory


@dataclass(frozen=True)
class Answers:
    """How often each neuron fired."""

    excitatory: npt.NDArray[np.int32]  # (n_images, n_modules, n_neurons)
    inhibitory: npt.NDArray[np.int32]


@dataclass(frozen=True)
class Asked:
    """A trained network with the delays of its input, ready to be asked."""

    recipe: Recipe
    network: Network
    modules: Sequence[Synapses]
    labels: npt.NDArray[np.int64]  # (n_modules, n_neurons) the place that each neuron speaks for; -1: none

    @classmethod
    def of(cls, recipe: Recipe, network: Network, new_delays: bool, first: int) -> Self:
        """Draw the delays, `new_delays` or those of the training, of modules whose numbers begin with `first`."""
        modules = [
            Synapses(weights, side_by_side(recipe.delays(first + number, new_delays)))
            for number, weights in enumerate(network.weights)
        ]
        return cls(recipe, network, modules, labels(network.learnt))

    @cached_property
    def stacked(self) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.int16]]:
        """Weights and delays as PyTorch simulates them, (n_modules, n_inputs, n_neurons)."""
        n = self.recipe.n_neurons
        return (
            np.stack([unpadded(module.weights, n) for module in self.modules]),
            np.stack([unpadded(module.delays, n) for module in self.modules]),
        )

    @property
    def silenced(self) -> npt.NDArray[np.bool_]:
        """Which neurons are hyperactive, (n_modules, n_neurons)."""
        if self.network.reactions is None:
            return np.zeros(self.network.theta.shape, np.bool_)
        return hyperactive(self.network.reactions, self.network.threshold)

    def input_counts(self, levels: npt.NDArray[np.uint8]) -> npt.NDArray[np.int64]:
        """Return the input spikes of images, (n_images, n_inputs)."""
        return np.array([np.diff(train.first) for train in _input_of(self.recipe, levels)])


def ask(
    asked: Asked,
    levels: npt.NDArray[np.uint8],
    carried: bool,
    device: torch.device | None,
    stage: str | None = None,
    within: tuple[float, float] = (0.0, 1.0),
) -> Answers:
    """Return the answers to images (n_images, n_inputs), which are the part `within` of the progress called `stage`.

    Each image finds the neurons at rest. Where `carried` it finds them as the image before left them, as VPRSNN's
    authors have it: after 150 ms of silence, potentials still have 22 % of their deviation. On a `device` PyTorch
    simulates, else the compiled loops.
    """
    recipe, network = asked.recipe, asked.network
    trains = _input_of(recipe, levels)
    if device is not None:
        return _asked_at_once(asked, trains, carried, device, stage, within)
    shape = (len(trains), len(asked.modules), recipe.n_neurons)
    answers = Answers(np.empty(shape, np.int32), np.empty(shape, np.int32))
    rooms: list[Room] = []

    def one(module: int, tell: Tell) -> None:
        try:
            room = rooms.pop()
        except IndexError:  # the others are in use
            room = _room(recipe)
        theta = network.theta[module]
        state, now = recipe.started(theta)
        for image, train in enumerate(trains):
            if not carried:
                state, now = State.at_rest(recipe.physics, theta, recipe.n_inputs), 0
            present(asked.modules[module], state, train, room, recipe.physics, recipe.traces, now, False, carried)
            now += recipe.physics.shown + recipe.physics.rest
            answers.excitatory[image, module] = state.counts[: recipe.n_neurons]
            answers.inhibitory[image, module] = state.counts_i[: recipe.n_neurons]
            tell((image + 1) / len(trains))
        rooms.append(room)

    for_each_module(one, len(asked.modules), stage, within)
    return answers


def _asked_at_once(
    asked: Asked,
    trains: Sequence[Train],
    carried: bool,
    device: torch.device,
    stage: str | None,
    within: tuple[float, float],
) -> Answers:
    recipe, theta = asked.recipe, asked.network.theta

    def report(share: float) -> None:
        if stage is not None:
            progress.report(stage, within[0] + (within[1] - within[0]) * share)

    return Answers(
        *batched.ask(
            *asked.stacked,
            theta,
            recipe.physics,
            trains,
            device,
            report,
            recipe.started(theta[0]) if carried else None,
        )
    )


def reactions(
    asked: Asked,
    levels: npt.NDArray[np.uint8],
    carried: bool,
    device: torch.device | None,
    stage: str,
    within: tuple[float, float] = (0.0, 1.0),
) -> npt.NDArray[np.int64]:
    """Return for how many images each neuron fires, (n_modules, n_neurons)."""
    fired = np.zeros((len(asked.modules), asked.recipe.n_neurons), np.int64)
    start, span = within[0], (within[1] - within[0]) / len(levels)
    together = len(levels) if carried else _TOGETHER
    for first in range(0, len(levels), together):
        block = levels[first : first + together]
        part = (start + span * first, start + span * (first + len(block)))
        fired += np.count_nonzero(ask(asked, block, carried, device, stage, part).excitatory, axis=0)
    return fired


def _input_of(recipe: Recipe, levels: npt.NDArray[np.uint8]) -> list[Train]:
    """Return the input spikes of images: the same for all modules, as of one camera."""
    physics = recipe.physics
    return [
        spike_train(row, generator_of_image(recipe.seed, row), recipe.intensity, physics.shown, physics.step_ms)
        for row in levels
    ]


def _room(recipe: Recipe) -> Room:
    return Room.of(recipe.physics, recipe.n_neurons, recipe.n_inputs, round(recipe.longest_delay), False)
