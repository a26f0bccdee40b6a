"""Trainings for the tests of what is kept of them, some in processes that are started, ended and killed."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Mapping
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from vprbench.api import checkpoints

WHAT = {"method": "walks", "seed": 3}
MODULES = 5


def module(number: int) -> dict[str, npt.NDArray[Any]]:
    """What is learnt in one module."""
    generator = np.random.default_rng(number)
    return {"weights": generator.random((20, 30)), "spikes": generator.integers(0, 9, 30)}


def whole(number: int, found: Mapping[str, npt.NDArray[Any]]) -> bool:
    """Whether arrays are those of one module, to the last bit."""
    wanted = module(number)
    return found.keys() == wanted.keys() and all(np.array_equal(found[name], wanted[name]) for name in wanted)


def train(root: Path) -> tuple[list[int], bool]:
    """Train all modules that are not kept; returns which, and whether all are right in the end."""
    trained, right = [], True
    with checkpoints.training(WHAT, root) as kept:
        for number in range(MODULES):
            found = kept.get(f"module-{number}")
            if found is None:
                found = module(number)
                kept.put(f"module-{number}", found)
                trained.append(number)
            right &= whole(number, found)
    return trained, right


def train_and_die(root: Path, step: int) -> None:
    """Train, killed right before so many steps that change or open something on disk are done."""
    steps = count()

    def die(event: str, _: object) -> None:
        if event in ("open", "os.mkdir", "os.rename", "os.remove", "os.rmdir") and next(steps) == step:
            os.kill(os.getpid(), signal.SIGKILL)

    sys.addaudithook(die)
    train(root)
