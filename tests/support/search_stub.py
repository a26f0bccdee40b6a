"""Stands in for training in tests of the search: a known recall for any settings, and ways to fail."""

from dataclasses import dataclass

import numpy as np

from vprbench.tuning.trial import Hits


def recall(values):
    """Best at f_min 0.4, which matters most; P_exc matters a little, nothing else does."""
    return 0.8 - abs(values["rate_min"] - 0.4) - 0.1 * abs(values["p_excitatory"] - 0.2)


@dataclass
class Stub:
    """What a process of the search does instead of training."""

    fails_above: float = 2.0  # rate_max
    diverges_above: float = 2.0  # rate_max
    shifts_by_seed: float = 0.0  # how much less recall a seed has than the one before
    killed_at: int | None = None  # the training that an interruption ends
    trained: int = 0

    def __call__(self, values, stretch="searched", seed=0):
        if self.trained == self.killed_at:
            raise KeyboardInterrupt
        self.trained += 1
        if values["rate_max"] > self.fails_above:
            raise MemoryError("no room")
        if values["rate_max"] > self.diverges_above:
            return Hits(np.zeros(1), "one output neuron wins for all")
        return Hits(np.array([recall(values) - seed * self.shifts_by_seed]))
