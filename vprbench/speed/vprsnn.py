"""What the benchmark of speed measures of VPRSNN: a module's training, its parts, and queries to many modules."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from itertools import count
from typing import Any

import numpy as np
import numpy.typing as npt
import psutil

from vprbench import progress
from vprbench.api.method import Method
from vprbench.errors import BadInput
from vprbench.plugins import registry
from vprbench.progress import listening
from vprbench.run import machine
from vprbench.run.stopwatch import Protocol, Stopwatch
from vprbench.speed.cells import AskingCell, Failed, ModuleCell, attempt
from vprbench.speed.measure import Fit, rounded, timed_fit
from vprbench.speed.settings import TRAVERSES, VPRSNN, Bench, Settings

_LITTLE = {"places_per_module": 2, "epochs": 1, "n_excitatory": 8}  # a training that only compiles
_COPIES = 4  # of a module's weights at most in memory at once


def training(bench: Bench) -> Iterator[ModuleCell | Failed]:
    """Train a module of each method; they are left in `bench.modules`."""
    for method in VPRSNN:
        yield attempt({"method": method}, partial(module_cell, bench, method))


def queries(bench: Bench) -> Iterator[AskingCell | Failed]:
    """Ask copies of a trained module, on one core and on all."""
    for wanted in bench.settings.vprsnn_modules:
        for threads in sorted({1, bench.settings.threads or len(machine.cores())}):
            what = {"modules": str(wanted), "cores": str(threads)}
            yield attempt(what, partial(asking_cell, bench, wanted, threads))


def module_cell(bench: Bench, method: str) -> ModuleCell:
    """Train a module on one core, several times and once more part by part; the last is left in `bench.modules`."""
    settings = bench.settings
    references, places = bench.route.references(settings.vprsnn_places, TRAVERSES)
    watched = partial(registry.entries("method")[method].beside("benchmark").watched, Stopwatch(Protocol()).lap)
    fits: list[Fit] = []
    with _on_cores(1, settings):
        with listening(lambda *_: None), watched():  # lets all loops be compiled, those of the parts too
            bench.vprsnn(method, **_LITTLE).fit(*bench.route.references(1, TRAVERSES))
        for turn in range(settings.vprsnn_rounds):
            title = f"{method}, round {turn + 1} of {settings.vprsnn_rounds}"
            module = bench.vprsnn(method)
            fits.append(timed_fit(title, module, references, places, "cpu"))
        bench.modules[method] = module
        with watched() as watch:
            timed_fit(f"{method}, parts", bench.vprsnn(method), references, places, "cpu")
    return ModuleCell(
        method,
        watch.presentations,
        settings.vprsnn_neurons,
        fits,
        watch.input_spikes,
        watch.excitatory_spikes,
        {part: rounded(laps) for part, laps in watch.laps.items()},
    )


def asking_cell(bench: Bench, wanted: int, threads: int) -> AskingCell:
    """Ask `wanted` copies of a trained module, or as many as memory has room for; trains one where there is none."""
    settings = bench.settings
    progress.report(f"vprsnn queries, modules={wanted}, cores={threads}", 0.0)
    states = {method: _trained(bench, method).state() for method in VPRSNN}
    n_modules = affordable(wanted, sum(state["weights"].nbytes for state in states.values()) // len(states))
    asked = {method: bench.vprsnn(method).restore(copies(state, n_modules)) for method, state in states.items()}
    singles = list(bench.route.queries(settings.places, settings.sample)[0].blocks(1))
    watch = Stopwatch(Protocol())
    laps: dict[str, list[float]] = {method: [] for method in asked}
    with _on_cores(threads, settings):
        for network in asked.values():
            network.query(singles[0])
        for turn in count(1):
            for method, network in asked.items():
                with watch.lap() as lap:
                    network.query(singles[turn % len(singles)])
                laps[method] += lap
            if turn >= settings.rounds and sum(map(sum, laps.values())) >= settings.minimum_seconds:
                break
    seconds = {method: rounded(each) for method, each in laps.items()}
    return AskingCell(n_modules, wanted, n_modules * settings.vprsnn_places, threads, seconds)


def affordable(wanted: int, module_bytes: int) -> int:
    """Return how many modules of so many bytes are asked; raises BadInput if memory has no room for one."""
    free = psutil.virtual_memory().available
    room = int(free // (_COPIES * module_bytes))
    if room < 1:
        raise BadInput(f"one module takes {_COPIES * module_bytes / 1e6:.0f} MB, and {free / 1e6:.0f} MB are free")
    return min(wanted, room)


def copies(state: Mapping[str, npt.NDArray[Any]], n_modules: int) -> dict[str, npt.NDArray[Any]]:
    """Return the state of a network of `n_modules` that are all the one of `state`, each of places of its own."""
    several = {
        name: array if array.ndim == 0 else np.broadcast_to(array[0], (n_modules, *array.shape[1:]))
        for name, array in state.items()
    }
    n_places = state["places"].shape[1]
    several["places"] = state["places"] + n_places * np.arange(n_modules)[:, None]
    return several


def _trained(bench: Bench, method: str) -> Method:
    if method not in bench.modules:
        references, places = bench.route.references(bench.settings.vprsnn_places, TRAVERSES)
        bench.modules[method] = bench.vprsnn(method).fit(references, places)
    return bench.modules[method]


@contextmanager
def _on_cores(threads: int, settings: Settings) -> Iterator[None]:
    machine.pin_threads(threads)
    try:
        yield
    finally:
        machine.pin_threads(settings.threads or len(machine.cores()))
