"""What the benchmark of speed measures of VPRSNN: a module's training, its parts, and queries to many modules."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt
import psutil

from vprbench.api.method import Method
from vprbench.errors import BadInput
from vprbench.plugins import registry
from vprbench.progress import listening
from vprbench.runs import machine
from vprbench.runs.stopwatch import Protocol, Stopwatch
from vprbench.speed.measure import Fit, interleaved, median, rounded, timed_fit
from vprbench.speed.report import Planned, figures, milliseconds, ratio
from vprbench.speed.settings import TRAVERSES, VPRSNN, Bench, Settings
from vprbench.speed.training import fit_seconds

_LITTLE = {"places_per_module": 2, "epochs": 1, "n_excitatory": 8}  # a training that only compiles
_WHOLE = ("input", "normalising", "with learning")  # parts that make up a presentation
_COPIES = 4  # of a module's weights at most in memory at once


@dataclass(frozen=True)
class ModuleCell:
    """One module of VPRSNN, trained on one core several times, and once more to see where the time goes."""

    method: str
    presentations: int
    neurons: int  # excitatory ones
    fits: list[Fit]
    input_spikes: int  # of one training
    excitatory_spikes: int
    parts: dict[str, list[float]]  # seconds, one element for each presentation that was looked at

    def row(self) -> dict[str, str]:
        """Return the median seconds of the trainings, their number, and what happens in one."""
        seconds = fit_seconds(self.fits)
        return {
            "method": self.method,
            "fit s": f"{figures(seconds)} ({len(self.fits)})",
            "presentations": f"{self.presentations:,}",
            "ms each": milliseconds(seconds / self.presentations),
            "input spikes": f"{self.input_spikes:,}",
            "synaptic arrivals": f"{figures(self.input_spikes * self.neurons / 1e6)} million",
            "arrivals a second": f"{figures(self.input_spikes * self.neurons / seconds / 1e6)} million",
            "excitatory spikes": f"{self.excitatory_spikes:,}",
        }

    def parts_row(self) -> dict[str, str]:
        """Return where the time of the presentations that were looked at goes, in percent of all of it."""
        seconds = {part: sum(laps) for part, laps in self.parts.items()}
        looked, whole = len(self.parts["with learning"]), sum(seconds[part] for part in _WHOLE)
        shares = {
            "drawing input spikes": seconds["input"],
            "summing arrivals": seconds["arrivals"],
            "rest of the simulation": seconds["without learning"] - seconds["arrivals"],
            "learning": seconds["with learning"] - seconds["without learning"],
            "normalising weights": seconds["normalising"],
        }
        return {
            "method": self.method,
            "presentations": f"{looked:,}",
            "ms each": milliseconds(whole / looked),
            **{part: f"{100 * each / whole:.1f} %" for part, each in shares.items()},
        }


@dataclass(frozen=True)
class AskingCell:
    """One image after the other by copies of a trained module, with and without delays in turn."""

    modules: int
    wanted: int  # more than `modules` if memory is short
    places: int
    threads: int
    seconds: dict[str, list[float]]  # per query, by method

    def row(self) -> dict[str, str]:
        """Return the median times of a query by each method."""
        seconds = {method: median(laps) for method, laps in self.seconds.items()}
        return {
            "modules": str(self.modules) + f" of {self.wanted}: memory is short" * (self.modules < self.wanted),
            "places": f"{self.places:,}",
            "cores": str(self.threads),
            **{f"{method}: ms": milliseconds(each) for method, each in seconds.items()},
            **{f"{method}: Hz": figures(1 / each) for method, each in seconds.items()},
            " / ".join(VPRSNN): ratio(*(seconds[method] for method in VPRSNN)),
        }


def training(bench: Bench) -> Iterator[Planned]:
    """Train a module of each method; they are left in `bench.modules`."""
    for method in VPRSNN:
        yield {"method": method}, partial(module_cell, bench, method)


def queries(bench: Bench) -> Iterator[Planned]:
    """Ask copies of a trained module, on one core and on all."""
    for wanted in bench.settings.vprsnn_modules:
        for threads in sorted({1, bench.settings.threads or len(machine.cores())}):
            yield {"modules": str(wanted), "cores": str(threads)}, partial(asking_cell, bench, wanted, threads)


def module_cell(bench: Bench, method: str) -> ModuleCell:
    """Train a module on one core, several times and once more part by part; the last is left in `bench.modules`."""
    settings = bench.settings
    references, places = bench.route.references(settings.vprsnn_places, TRAVERSES)
    watched = partial(
        registry.beside(registry.entries("method")[method], "benchmark").watched, Stopwatch(Protocol()).lap
    )
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
    """Ask `wanted` copies of a trained module, or as many as memory has room for; trains one if there is none."""
    settings = bench.settings
    states = {method: _trained(bench, method).state() for method in VPRSNN}
    n_modules = affordable(wanted, sum(state["weights"].nbytes for state in states.values()) // len(states))
    singles = list(bench.route.queries(settings.places, settings.sample)[0].blocks(1))

    def by(method: str, state: Mapping[str, npt.NDArray[Any]]) -> Callable[[int], object]:
        network = bench.vprsnn(method).restore(copies(state, n_modules))
        return lambda turn: network.query(singles[turn % len(singles)])

    asked = {method: by(method, state) for method, state in states.items()}
    with _on_cores(threads, settings):
        for query in asked.values():
            query(0)
        seconds = interleaved(asked, settings.rounds, settings.minimum_seconds)
    return AskingCell(n_modules, wanted, n_modules * settings.vprsnn_places, threads, seconds)


def affordable(wanted: int, module_bytes: int) -> int:
    """Return how many modules of so many bytes are asked; raises BadInput if memory has no room for one."""
    free = psutil.virtual_memory().available
    room = int(free // (_COPIES * module_bytes))
    if room < 1:
        raise BadInput(f"one module takes {_COPIES * module_bytes / 1e6:.0f} MB, and {free / 1e6:.0f} MB are free")
    return min(wanted, room)


def copies(state: Mapping[str, npt.NDArray[Any]], n_modules: int) -> dict[str, npt.NDArray[Any]]:
    """Return the state of a network of `n_modules` copies of the module in `state`, each with places of its own."""
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
