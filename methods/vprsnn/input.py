"""Grey levels as Poisson spike trains: the input of VPRSNN."""

from __future__ import annotations

import hashlib
import math

import numpy as np
import numpy.typing as npt

from vprbench.api import compiled

from .arrays import Train

_IMAGE = 4  # the purpose of its random numbers; a module's have others


def draw_spike_train(
    levels: npt.NDArray[np.uint8], generator: np.random.Generator, intensity: float, steps: int, step_ms: float
) -> Train:
    """Return spikes of `steps` steps, each input (n_inputs,) of level / `intensity` Hz, independent from step to step.

    Source: the Poisson group of VPRSNN, which spikes in a step with the probability rate times step.
    """
    hazard = -np.log1p(-levels.astype(np.float64) / intensity * (step_ms / 1000))
    drawn = np.empty((2, steps * len(levels)), np.int32)  # as large as can be: memory is taken where it is written
    n_spikes = _draw(hazard, generator, steps, *drawn)
    train = Train(np.empty(n_spikes, np.int32), np.empty(n_spikes, np.int32))
    _sort_spikes(*drawn[:, :n_spikes], np.zeros(steps + 1, np.int32), train.step, train.source)
    return train


def make_generator(seed: int, *words: int) -> np.random.Generator:
    """Return the generator of one purpose of a seed."""
    return np.random.Generator(np.random.SFC64(np.random.SeedSequence(seed, spawn_key=words)))


def make_image_generator(seed: int, levels: npt.NDArray[np.uint8]) -> np.random.Generator:
    """Return the generator of one image: the same image has the same spikes, wherever it stands among the queries."""
    words = np.frombuffer(hashlib.blake2b(levels.tobytes(), digest_size=16).digest(), np.uint32)
    return make_generator(seed, _IMAGE, *map(int, words))


@compiled()
def _draw(hazard, generator, steps, step, source):  # type: ignore[no-untyped-def]
    """Draw the spikes of one input after the other by the gaps between them; returns their number."""
    n = 0
    for i in range(len(hazard)):
        at = -1.0
        while hazard[i] > 0:
            at += 1 + math.floor(generator.standard_exponential() / hazard[i])
            if at >= steps:
                break
            step[n], source[n] = np.int32(at), i
            n += 1
    return n


@compiled()
def _sort_spikes(drawn_step, drawn_source, begins, step, source):  # type: ignore[no-untyped-def]
    """Bring the spikes of all inputs into the order of their steps."""
    for at in drawn_step:
        begins[at + 1] += 1
    for t in range(1, len(begins)):
        begins[t] += begins[t - 1]
    for spike in range(len(drawn_step)):
        at = begins[drawn_step[spike]]
        begins[drawn_step[spike]] += 1
        step[at], source[at] = drawn_step[spike], drawn_source[spike]
