"""Stands in for training in tests of the search: a known recall for any settings, and ways to fail."""

from __future__ import annotations

import itertools
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from multiprocessing import parent_process
from multiprocessing.connection import wait
from pathlib import Path
from typing import Self

import numpy as np

from vprbench.tuning.objective import Task, Tried
from vprbench.tuning.search import explore
from vprbench.tuning.space import Values
from vprbench.tuning.study import opened
from vprbench.tuning.workers import Answer, Workers

HALTS = "halts"
CALLS = itertools.count(1)  # of this process


def recall(values: Values) -> float:
    """Best at f_min 0.4, which matters most; P_exc matters a little, nothing else does."""
    return 0.8 - abs(values["rate_min"] - 0.4) - 0.1 * abs(values["p_excitatory"] - 0.2)


@dataclass(frozen=True)
class Stub:
    """What a process of the search does instead of training."""

    fails_above: float = 2.0  # rate_max
    diverges_above: float = 2.0  # rate_max
    shifts_by_seed: float = 0.0  # how much less recall a seed has than the one before
    halts_at_call: int | None = None  # says so, and goes on when the search was killed

    def __call__(self, task: Task) -> Tried:
        if next(CALLS) == self.halts_at_call:
            parent = parent_process()
            assert parent is not None
            print(HALTS, flush=True)
            wait([parent.sentinel])
        values, seed = task.values, task.seed or 0
        if values["rate_max"] > self.fails_above:
            raise MemoryError("no room")
        nothing = np.zeros(1)
        if values["rate_max"] > self.diverges_above:
            return Tried(nothing, nothing, "one output neuron wins for all")
        return Tried(np.array([recall(values) - seed * self.shifts_by_seed]), nothing)


class Here:
    """In place of processes: tries in this one."""

    def __init__(self, attempt: Callable[[Task], Tried], count: int = 1) -> None:
        self.attempt, self.started = attempt, count

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Nothing was started."""

    def answers(self, tasks: Sequence[Task], begins: Callable[[int], None]) -> Iterator[Answer[Tried]]:
        for number, task in enumerate(tasks):
            begins(number)
            try:
                answer = Answer(number, self.attempt(task))
            except Exception as error:
                answer = Answer(number, None, f"{type(error).__name__}: {error}")
            yield answer


def search_on(folder: Path, trials: int, halts_at_call: int) -> None:
    with opened(folder) as study, Workers(Stub(halts_at_call=halts_at_call), 1) as workers:
        explore(study, workers, trials, seed=0)


if __name__ == "__main__":
    search_on(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))
