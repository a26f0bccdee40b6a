"""The answers of trained modules: all of them see the same image, and nothing is learnt."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from vprbench.api import count_operations

from .arrays import Scratch
from .model import Module
from .network import ReadyNetwork
from .parallel import Stage, Tell, for_each_module

_TOGETHER = 256  # images whose reactions are counted together: bounds the memory
Levels = npt.NDArray[np.uint8]  # (n_images, n_inputs)


class Answers(NamedTuple):
    """How often each neuron fired."""

    excitatory: npt.NDArray[np.int32]  # (n_images, n_modules, n_neurons)
    inhibitory: npt.NDArray[np.int32]


def ask(ready: ReadyNetwork, levels: Levels, stage: Stage) -> Answers:
    """Return the answers to images.

    Each image finds the neurons at rest. With carried potentials it finds them as the image before left them, as
    VPRSNN's authors have it: after 150 ms of silence, potentials still have 22 % of their deviation.
    """
    model = ready.model
    trains, carried = model.draw_query_trains(levels), model.carried_potentials
    # Each neuron takes three multiply-adds and six other operations a step, each arrival of a spike an addition.
    steps = len(trains) * (model.physics.shown + carried * model.physics.rest)
    neurons, arrivals = ready.labels.size, sum(len(train.step) for train in trains)
    count_operations(3 * steps * neurons, (6 * steps + arrivals) * neurons, kind="float64")
    shape = (len(trains), len(ready.synapses), model.n_excitatory)
    answers = Answers(np.empty(shape, np.int32), np.empty(shape, np.int32))
    free: list[Scratch] = []  # that no thread works in

    def ask_module(number: int, tell: Tell) -> None:
        try:
            scratch = free.pop()
        except IndexError:
            scratch = model.make_scratch(learning=False)
        module = Module(model, ready.synapses[number], ready.network.theta[number], scratch, learning=False)
        for image, train in enumerate(trains):
            if not carried:
                module.rest()
            module.show(train, resting=carried)
            answers.excitatory[image, number] = module.state.counts[: model.n_excitatory]
            answers.inhibitory[image, number] = module.state.counts_i[: model.n_excitatory]
            tell((image + 1) / len(trains))
        free.append(scratch)

    for_each_module(ask_module, len(ready.synapses), stage)
    return answers


def count_reactions(ready: ReadyNetwork, levels: Levels, stage: Stage) -> npt.NDArray[np.int64]:
    """Return for how many images each neuron fires, (n_modules, n_neurons)."""
    fired = np.zeros(ready.labels.shape, np.int64)
    n_images = len(levels)
    together = n_images if ready.model.carried_potentials else _TOGETHER
    for first in range(0, n_images, together):
        block = levels[first : first + together]
        part = stage.part(first / n_images, (first + len(block)) / n_images)
        fired += np.count_nonzero(ask(ready, block, part).excitatory, axis=0)
    return fired
