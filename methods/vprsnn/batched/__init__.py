"""VPRSNN's modules side by side in PyTorch, for CUDA: the training and the asking of many at once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import torch

from ..module import State, Train
from ..physics import Physics, Traces
from .arrivals import Arrivals
from .learning import Learning
from .steps import ARRAYS, Modules, window_of

Floats = npt.NDArray[np.float64]
Delays = npt.NDArray[np.integer]
Counts = npt.NDArray[np.int32]

VALUES_HELD = 2**29  # 4 GiB
_OF_A_SYNAPSE = 3  # values: its weight, its delay, and where what arrives by it is summed


class Trained(NamedTuple):
    """What modules have learnt."""

    weights: Floats  # (n_modules, n_inputs, n_neurons)
    theta: Floats  # (n_modules, n_neurons) mV
    counts: Counts  # (n_kept, n_modules, n_neurons) spikes of the last presentations, each with the rest before it


def modules_at_once(
    physics: Physics, n_inputs: int, n_neurons: int, longest_delay: int, values_held: int = VALUES_HELD
) -> int:
    """Return how many modules of this size, at least one, fit into memory for so many values of 8 bytes."""
    return max(1, values_held // (n_neurons * (_OF_A_SYNAPSE * n_inputs + _values(physics, longest_delay))))


def train(
    weights: Floats,
    delays: Delays,
    start: State,
    now: int,
    physics: Physics,
    traces: Traces,
    weight_sum: float,
    next_trains: Callable[[int], Sequence[Train]],
    n_presentations: int,
    n_kept: int,
    device: torch.device,
    report: Callable[[float], None],
) -> Trained:
    """Train modules of (n_modules, n_inputs, n_neurons) weights and delays (steps), all at once.

    At step `now` each is as `start`, which has been silent for ever. `next_trains` is asked for the input of all
    modules in one presentation after the other, from 0. The responses to the last `n_kept` are returned. `report` is
    told the share that is done, 0 to 1. Memory grows with the modules: train no more than `modules_at_once` together.
    """
    n_modules, n_inputs, n_neurons = weights.shape
    limit = weight_sum + n_inputs * physics.weight_max
    arrivals = Arrivals(weights, delays, n_modules, window_of(physics), limit, device)
    modules = Modules(physics, arrivals, n_modules, Learning(arrivals, physics, traces))
    modules.begin(np.tile(start.theta[:n_neurons], (n_modules, 1)), start, now)
    counts = np.zeros((n_kept, n_modules, n_neurons), np.int32)
    for presentation in range(n_presentations):
        arrivals.normalise(weight_sum)
        modules.present(next_trains(presentation), resting=True)
        if (kept := presentation - n_presentations + n_kept) >= 0:
            counts[kept] = modules.counts[0].cpu().numpy()
        report((presentation + 1) / n_presentations)
    return Trained(arrivals.weights.cpu().numpy(), modules.theta.cpu().numpy(), counts)


def ask(
    weights: Floats,
    delays: Delays,
    theta: Floats,
    physics: Physics,
    trains: Sequence[Train],
    device: torch.device,
    report: Callable[[float], None],
    carried: tuple[State, int] | None = None,
    values_held: int = VALUES_HELD,
) -> tuple[Counts, Counts]:
    """Return the spikes of excitatory and of inhibitory neurons, (n_images, n_modules, n_neurons).

    All modules, whose weights and delays are (n_modules, n_inputs, n_neurons) and whose thresholds are `theta`
    (n_modules, n_neurons) mV, see the same images, and learn nothing. Each image finds them at rest; or, where
    `carried` gives the state and the step in which the first finds them, as the image before left them. `report` is
    told the share that is done, 0 to 1. The work needs memory for about `values_held` values of 8 bytes.
    """
    n_modules, n_inputs, n_neurons = weights.shape
    longest = int(delays.max())
    answers = np.zeros((2, len(trains), n_modules, n_neurons), np.int32)
    few = min(n_modules, modules_at_once(physics, n_inputs, n_neurons, longest, values_held))
    left = values_held // n_neurons - few * _OF_A_SYNAPSE * n_inputs
    together = 1 if carried else max(1, min(len(trains), left // (few * _values(physics, longest))))
    begin = carried or (State.at_rest(physics, theta[0], n_inputs), 0)
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
            modules.present([*shown, *[shown[-1]] * missing], resting=carried is not None)
            counts = modules.counts.view(2, together, n_some, n_neurons)[:, : len(shown)]
            answers[:, image : image + together, some] = counts.cpu().numpy()
            report((first + n_some * (image + len(shown)) / len(trains)) / n_modules)
        del arrivals, modules  # so that the next find their memory free
    return answers[0], answers[1]


def _values(physics: Physics, longest_delay: int) -> int:
    """Return how many values are held for each neuron of each group."""
    return ARRAYS * window_of(physics) + longest_delay
