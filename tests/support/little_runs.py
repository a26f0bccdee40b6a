"""Runs of a method on a few small images, without what makes a run long: the canary and the look at the machine."""

import functools
import gc
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from vprbench.plugins.networks import Files
from vprbench.runs import descriptors, identity, machine, run, watch
from vprbench.runs.experiment import Experiment
from vprbench.runs.identity import hash_frames
from vprbench.runs.request import RunRequest
from vprbench.runs.stopwatch import Protocol
from vprbench.runs.timing_lock import share_host

CONFIG: dict[str, Any] = {
    "method": {"_target_": "little.Lookup", "window": 5, "device": "cpu"},
    "dataset": {"name": "journey"},
    "frames": False,
    "seed": 0,
    "device": "cpu",
    "depth": 3,
}
QUICK = Protocol(minimum_seconds=0, minimum_queries=5, sample=16, warmup_queries=2, batch_sizes=[1, 4])


hash_class = functools.cache(identity.hash_class)


def run_of(method, dataset, protocol=QUICK, **changes):
    return execute(asked_for(method, dataset, protocol, **changes))


def execute(experiment):
    with share_host() as lock:
        return run.execute(experiment, "key", lock)


def asked_for(
    method,
    dataset,
    /,
    protocol=QUICK,
    threads=1,
    files=Files(),  # noqa: B008 - it is frozen
    cache=None,
    **changes,
):
    """Return the experiment of a little run; `changes` are made to its request."""
    given = {**CONFIG, "timing": protocol, "threads": threads, **changes}
    request = RunRequest(method_name="little", dataset_name=dataset.name, **given)
    return Experiment(request, method, dataset, "fingerprint", hash_frames(dataset)[1], dataset, files, cache=cache)


def table(n_queries, n_places, levels=1000):
    return np.random.default_rng(1).integers(0, levels, (n_queries, n_places)).astype(np.float32)


@contextmanager
def quiet_surroundings():
    """Leave out of runs what is tested on its own and takes long; yields the surroundings that they see instead."""
    quick = {
        "describe_machine": lambda device, threads: {"processor": "Abacus 9", "time_utc": "2025-01-31T12:00:00Z"},
        "time_canary": lambda: 1.0,
        "read_cpu_wait_seconds": lambda: None,
    }
    with pytest.MonkeyPatch.context() as patch:
        stand_in = SimpleNamespace(**{**vars(machine), **quick})
        patch.setattr(watch, "machine", stand_in)
        patch.setattr(run, "hash_code", lambda method: method.__qualname__)  # a class here has many files behind it
        for module in (identity, descriptors):
            patch.setattr(module, "hash_class", hash_class)
        gc.freeze()  # a measurement collects garbage first, which takes long among all that a test session imports
        try:
            yield stand_in
        finally:
            gc.unfreeze()


def kinds(run):
    return [note.kind for note in run.notes]
