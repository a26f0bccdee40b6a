"""Grey levels as Poisson spike trains: the input of VPRSNN."""

from __future__ import annotations

import hashlib
import math

import numpy as np
import numpy.typing as npt

from vprbench.api import compiled

from .arrays import Train

_IMAGE = 4  # the purpose of its random numbers; a module's have others


def spike_train(
    levels: npt.NDArray[np.uint8], generator: np.random.Generator, intensity: float, steps: int, step_ms: float
) -> Train:
    """Return spikes of `steps` steps, each input (n_inputs,) of level / `intensity` Hz, independent from step to step.

    Source: the Poisson group of VPRSNN, which spikes in a step with the probability rate times step.
    """
    probability = levels.astype(np.float64) / intensity * (step_ms / 1000)
    expected = steps * probability.sum()
    room = np.empty(int(expected + 10 * math.sqrt(expected) + len(levels)), np.int32)
    hazard = -np.log1p(-probability)
    first = np.zeros(len(levels) + 1, np.int32)
    while not _draw(hazard, generator, steps, first, room):
        room = np.empty(2 * len(room), np.int32)
    of_source = room[: first[-1]]
    step, source = np.empty_like(of_source), np.empty_like(of_source)
    _sort(first, of_source, np.zeros(steps + 1, np.int32), step, source)
    return Train(step, source, first, of_source)


def generator_for(seed: int, *words: int) -> np.random.Generator:
    """Return the generator of one purpose of a seed."""
    return np.random.Generator(np.random.SFC64(np.random.SeedSequence(seed, spawn_key=words)))


def generator_of_image(seed: int, levels: npt.NDArray[np.uint8]) -> np.random.Generator:
    """Return the generator of one image: the same image has the same spikes, whatever is asked before it."""
    words = np.frombuffer(hashlib.blake2b(levels.tobytes(), digest_size=16).digest(), np.uint32)
    return generator_for(seed, _IMAGE, *map(int, words))


@compiled()
def _draw(hazard, generator, steps, first, room):  # type: ignore[no-untyped-def]
    """Draw the spikes of each input by the gaps between them; returns whether they fitted into `room`."""
    n = 0
    for i in range(len(hazard)):
        first[i] = n
        if hazard[i] > 0:
            step = -1.0
            while True:
                step += 1 + math.floor(generator.standard_exponential() / hazard[i])
                if step >= steps:
                    break
                if n == len(room):
                    return False
                room[n] = np.int32(step)
                n += 1
    first[len(hazard)] = n
    return True


@compiled()
def _sort(first, of_source, begins, step, source):  # type: ignore[no-untyped-def]
    """Bring the spikes of all inputs into the order of their steps."""
    for spike in of_source:
        begins[spike + 1] += 1
    for t in range(1, len(begins)):
        begins[t] += begins[t - 1]
    for i in range(len(first) - 1):
        for spike in range(first[i], first[i + 1]):
            at = begins[of_source[spike]]
            begins[of_source[spike]] += 1
            step[at] = of_source[spike]
            source[at] = i
