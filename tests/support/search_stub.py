"""Stands in for training in tests of the search: a known recall for any settings, and ways to fail."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing import parent_process
from multiprocessing.connection import wait
from pathlib import Path

import numpy as np

from vprbench.tuning.objective import Task, Tried
from vprbench.tuning.search import explore
from vprbench.tuning.space import Values
from vprbench.tuning.study import opened
from vprbench.tuning.workers import Workers

HALTS = "halts"


def recall(values: Values) -> float:
    """Best at f_min 0.4, which matters most; P_exc matters a little, nothing else does."""
    return 0.8 - abs(values["rate_min"] - 0.4) - 0.1 * abs(values["p_excitatory"] - 0.2)


@dataclass(frozen=True)
class Stub:
    """What a process of the search does instead of training."""

    fails_above: float = 2.0  # rate_max
    diverges_above: float = 2.0  # rate_max
    constant: bool = False
    dies_once: Path | None = None  # the file that says that it did
    shifts_by_seed: float = 0.0  # how much less recall a seed has than the one before
    unprepared: bool = False
    halts_at_call: int | None = None  # says so, and goes on when the search was killed

    def __call__(self) -> Callable[[Task], Tried]:
        if self.unprepared:
            raise ValueError("no spikes are there")
        calls = [0]

        def tried(task: Task) -> Tried:
            calls[0] += 1
            if calls[0] == self.halts_at_call:
                parent = parent_process()
                assert parent is not None
                print(HALTS, flush=True)
                wait([parent.sentinel])
            return self.tried(task.values, task.seed or 0)

        return tried

    def tried(self, values: Values, seed: int) -> Tried:
        if self.dies_once is not None and not self.dies_once.exists():
            self.dies_once.touch()
            os._exit(7)
        if values["rate_max"] > self.fails_above:
            raise MemoryError("no room")
        nothing = np.zeros(1)
        if values["rate_max"] > self.diverges_above:
            return Tried(nothing, nothing, "one output neuron wins for all")
        return Tried(np.array([0.5 if self.constant else recall(values) - seed * self.shifts_by_seed]), nothing)


def search_on(folder: Path, trials: int, halts_at_call: int) -> None:
    with opened(folder) as study, Workers(Stub(halts_at_call=halts_at_call), 1) as workers:
        explore(study, workers, trials, seed=0)


if __name__ == "__main__":
    search_on(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))
