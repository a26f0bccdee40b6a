"""VPRSNN's modules side by side in PyTorch, for CUDA: the training and the asking of many at once."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from ..arrays import State, Train, side_by_side
from ..model import Model
from ..network import ReadyNetwork
from ..physics import Physics
from ..training_sets import Lesson, Recorder
from .arrivals import Arrivals
from .learning import Learning
from .steps import ARRAYS, Modules, window_of

Counts = npt.NDArray[np.int32]

VALUES_HELD = 2**29  # 4 GiB
_OF_A_SYNAPSE = 3  # values: its weight, its delay, and where what arrives by it is summed


def modules_at_once(model: Model) -> int:
    """Return how many modules of a model, at least one, fit into memory for `VALUES_HELD` values of 8 bytes."""
    of_a_neuron = _OF_A_SYNAPSE * model.n_inputs + _values(model.physics, round(model.longest_delay))
    return max(1, VALUES_HELD // (model.n_excitatory * of_a_neuron))


def train(
    model: Model, lessons: Sequence[Lesson], device: torch.device, report: Callable[[float], None]
) -> list[Mapping[str, npt.NDArray[Any]]]:
    """Return what `training.train` returns of each lesson, all of as many images, learnt at once.

    `report` is told the share that is done, 0 to 1. Memory grows with the lessons: learn no more than `modules_at_once`
    together.
    """
    physics, n_neurons = model.physics, model.n_excitatory
    recorders = [Recorder(model, lesson) for lesson in lessons]
    n_presentations = recorders[0].presentations
    limit = model.weight_sum + model.n_inputs * physics.weight_max
    weights = np.stack([model.weights(lesson.number) for lesson in lessons])
    delays = np.stack([model.delays(lesson.number) for lesson in lessons])
    arrivals = Arrivals(weights, delays, len(lessons), window_of(physics), limit, device)
    modules = Modules(physics, arrivals, len(lessons), Learning(arrivals, physics, model.traces))
    start, now = model.untrained()
    modules.begin(np.tile(start.theta[:n_neurons], (len(lessons), 1)), start, now)
    spikes = [model.spikes(lesson.number, lesson.images(0, n_presentations)) for lesson in lessons]
    for presentation, trains in enumerate(zip(*spikes, strict=True)):
        arrivals.normalise(model.weight_sum)
        modules.present(trains, resting=True)
        if presentation >= recorders[0].first:
            for recorder, counts in zip(recorders, modules.counts[0].cpu().numpy(), strict=True):
                recorder.add(presentation, counts)
        report((presentation + 1) / n_presentations)
    learnt = zip(arrivals.weights.cpu().numpy(), modules.theta.cpu().numpy(), recorders, strict=True)
    return [
        {"weights": side_by_side(weights), "theta": theta, **recorder.arrays()} for weights, theta, recorder in learnt
    ]


def ask(
    ready: ReadyNetwork, trains: Sequence[Train], device: torch.device, report: Callable[[float], None]
) -> tuple[Counts, Counts]:
    """Return the spikes of excitatory and of inhibitory neurons, (n_images, n_modules, n_neurons).

    All modules see the same images, and learn nothing. Each image finds them at rest; with carried potentials, as the
    image before left them. `report` is told the share that is done, 0 to 1. The work needs memory for about
    `VALUES_HELD` values of 8 bytes.
    """
    model, theta = ready.model, ready.network.theta
    physics, carried = model.physics, model.carried_potentials
    weights, delays = ready.stacked
    n_modules, n_inputs, n_neurons = weights.shape
    longest = int(delays.max())
    answers = np.zeros((2, len(trains), n_modules, n_neurons), np.int32)
    of_synapses, of_steps = _OF_A_SYNAPSE * n_inputs, _values(physics, longest)
    few = min(n_modules, max(1, VALUES_HELD // (n_neurons * (of_synapses + of_steps))))
    left = VALUES_HELD // n_neurons - few * of_synapses
    together = 1 if carried else max(1, min(len(trains), left // (few * of_steps)))
    begin = model.started(theta[0]) if carried else (State.at_rest(physics, theta[0], n_inputs), 0)
    for first in range(0, n_modules, few):
        some = slice(first, min(first + few, n_modules))
        n_some, limit = some.stop - first, float(weights[some].sum(axis=1).max())
        arrivals = Arrivals(weights[some], delays[some], n_some * together, window_of(physics), limit, device)
        modules = Modules(physics, arrivals, n_some * together)
        for image in range(0, len(trains), together):
            shown = trains[image : image + together]
            missing = together - len(shown)  # in the last turn: the last image takes their place
            if image == 0 or not carried:
                modules.begin(np.tile(theta[some], (together, 1)), *begin)
            modules.present([*shown, *[shown[-1]] * missing], resting=carried)
            counts = modules.counts.view(2, together, n_some, n_neurons)[:, : len(shown)]
            answers[:, image : image + together, some] = counts.cpu().numpy()
            report((first + n_some * (image + len(shown)) / len(trains)) / n_modules)
        del arrivals, modules  # so that the next find their memory free
    return answers[0], answers[1]


def _values(physics: Physics, longest_delay: int) -> int:
    """Return how many values are held for each neuron of each group."""
    return ARRAYS * window_of(physics) + longest_delay
