"""Stands in for training in tests of the search: a known recall for any settings, and ways to fail."""

from dataclasses import dataclass

import numpy as np

from vprbench.tuning.objective import Tried
from vprbench.tuning.workers import Answer


def recall(values):
    """Best at f_min 0.4, which matters most; P_exc matters a little, nothing else does."""
    return 0.8 - abs(values["rate_min"] - 0.4) - 0.1 * abs(values["p_excitatory"] - 0.2)


@dataclass(frozen=True)
class Stub:
    """What a process of the search does instead of training."""

    fails_above: float = 2.0  # rate_max
    diverges_above: float = 2.0  # rate_max
    shifts_by_seed: float = 0.0  # how much less recall a seed has than the one before

    def __call__(self, task):
        values, seed = task.values, task.seed or 0
        if values["rate_max"] > self.fails_above:
            raise MemoryError("no room")
        nothing = np.zeros(1)
        if values["rate_max"] > self.diverges_above:
            return Tried(nothing, nothing, "one output neuron wins for all")
        return Tried(np.array([recall(values) - seed * self.shifts_by_seed]), nothing)


class Here:
    """In place of processes: tries in this one."""

    def __init__(self, attempt, count=1, killed_at=None):
        self.attempt, self.started, self.killed_at = attempt, count, killed_at

    def __enter__(self):
        return self

    def __exit__(self, *_):
        """Nothing was started."""

    def answers(self, tasks, begins):
        for number, task in enumerate(tasks):
            begins(number)
            if number == self.killed_at:
                raise KeyboardInterrupt
            try:
                answer = Answer(number, self.attempt(task))
            except Exception as error:
                answer = Answer(number, None, f"{type(error).__name__}: {error}")
            yield answer
