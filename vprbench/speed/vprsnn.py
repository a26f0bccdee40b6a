"""What the benchmark of speed measures of VPRSNN: a module's training, its parts, and queries to many modules."""

from __future__ import annotations

import importlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from itertools import count
from types import ModuleType
from typing import Any

import numpy as np
import numpy.typing as npt
import psutil

from vprbench import progress
from vprbench.api.method import Method
from vprbench.errors import BadInput
from vprbench.progress import listening
from vprbench.run import machine
from vprbench.run.stopwatch import Protocol, Stopwatch
from vprbench.speed.measure import Fit, Make, rounded, timed_fit
from vprbench.speed.route import Route
from vprbench.speed.settings import LOOKED, TRAVERSES, VPRSNN, AskingCell, ModuleCell, Part, Settings

_PLUG_IN = "vprbench.methods.vprsnn"  # the contract of methods does not show the parts of a training
_LITTLE = {"places_per_module": 2, "epochs": 1, "n_excitatory": 8}  # a training that only compiles
_COPIES = 4  # of a module's weights at most in memory at once


def module_cell(settings: Settings, make: Make, route: Route, modules: dict[str, Method], method: str) -> ModuleCell:
    """Train a module on one core, several times and once more part by part; the last is left in `modules`."""
    references, places = route.references(settings.vprsnn_places, TRAVERSES)
    fits: list[Fit] = []
    with _on_cores(1, settings):
        _warm_up(settings, make, route, method)
        for turn in range(settings.vprsnn_rounds):
            title = f"{method}, round {turn + 1} of {settings.vprsnn_rounds}"
            module = make(method, "cpu", **settings.vprsnn())
            fits.append(timed_fit(title, module, references, places, "cpu"))
        modules[method] = module
        with watched() as watch:
            timed_fit(f"{method}, parts", make(method, "cpu", **settings.vprsnn()), references, places, "cpu")
    return ModuleCell(
        method,
        watch.presentations,
        settings.vprsnn_neurons,
        fits,
        watch.input_spikes,
        watch.excitatory_spikes,
        {part: rounded(laps) for part, laps in watch.laps.items()},
    )


def asking_cell(
    settings: Settings, make: Make, route: Route, modules: dict[str, Method], wanted: int, threads: int
) -> AskingCell:
    """Ask `wanted` copies of a trained module, or as many as memory has room for; trains one where there is none."""
    progress.report(f"vprsnn queries, modules={wanted}, cores={threads}", 0.0)
    states = {method: _trained(settings, make, route, modules, method).state() for method in VPRSNN}
    n_modules = affordable(wanted, sum(state["weights"].nbytes for state in states.values()) // len(states))
    asked = {}
    for method, state in states.items():
        asked[method] = make(method, "cpu", **settings.vprsnn()).restore(copies(state, n_modules))
    singles = list(route.queries(settings.places, settings.sample)[0].blocks(1))
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
    """Return how many modules of so many bytes are asked; raises BadInput where memory has no room for one."""
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


class Watch:
    """Counts the spikes of a training, and times the parts of the presentations that are looked at.

    Its functions stand in for those that a training calls; they do the same. Before a presentation that is looked at
    what arrives is summed once by itself, and the presentation is shown once to a copy of the state, without learning.
    """

    def __init__(self, own: Mapping[str, Any], sum_arrivals: Any) -> None:
        """Take the functions of VPRSNN's training by name, and the sum of arrivals of its simulation."""
        self.presentations = self.input_spikes = self.excitatory_spikes = 0
        self.laps: dict[Part, list[float]] = {
            "input": [],
            "normalising": [],
            "arrivals": [],
            "without learning": [],
            "with learning": [],
        }
        self._stopwatch = Stopwatch(Protocol())
        self._own, self._sum_arrivals = own, sum_arrivals

    def spike_train(self, *arguments: Any) -> Any:
        """Draw the input of a presentation."""
        with self._part("input"):
            train = self._own["spike_train"](*arguments)
        self.input_spikes += len(train.step)
        return train

    def normalise(self, *arguments: Any) -> None:
        """Scale the weights of a presentation."""
        with self._part("normalising"):
            self._own["normalise"](*arguments)

    def present(self, synapses: Any, state: Any, train: Any, room: Any, *arguments: Any) -> None:
        """Show an image; the last two arguments say whether it is learnt, and whether a rest follows."""
        *others, learning, resting = arguments
        if self._looking:
            copy = type(state)(*(array.copy() for array in state))
            with self._part("arrivals"):
                self._sum_arrivals(synapses, train, room.ring, room.drive)
            with self._part("without learning"):
                self._own["present"](synapses, copy, train, room, *others, False, resting)
        with self._part("with learning"):
            self._own["present"](synapses, state, train, room, *others, learning, resting)
        self.excitatory_spikes += int(state.counts.sum())
        self.presentations += 1

    @property
    def _looking(self) -> bool:
        return self.presentations % LOOKED == 0

    @contextmanager
    def _part(self, part: Part) -> Iterator[None]:
        with self._stopwatch.lap() as lap:
            yield
        if self._looking:
            self.laps[part] += lap


@contextmanager
def watched() -> Iterator[Watch]:
    """Watch the trainings of single modules inside the block."""
    recipe, training, simulation = (_module(name) for name in ("recipe", "training", "simulation"))
    homes = {"spike_train": recipe, "normalise": training, "present": training}
    own = {name: getattr(home, name) for name, home in homes.items()}
    watch = Watch(own, simulation._sum_arrivals)
    for name, home in homes.items():
        setattr(home, name, getattr(watch, name))
    try:
        yield watch
    finally:
        for name, home in homes.items():
            setattr(home, name, own[name])


def _module(name: str) -> ModuleType:
    return importlib.import_module(f"{_PLUG_IN}.{name}")


def _trained(settings: Settings, make: Make, route: Route, modules: dict[str, Method], method: str) -> Method:
    if method not in modules:
        module = make(method, "cpu", **settings.vprsnn())
        modules[method] = module.fit(*route.references(settings.vprsnn_places, TRAVERSES))
    return modules[method]


def _warm_up(settings: Settings, make: Make, route: Route, method: str) -> None:
    """Let all loops be compiled, those of the parts too."""
    references, places = route.references(1, TRAVERSES)
    with listening(lambda *_: None), watched():
        make(method, "cpu", **{**settings.vprsnn(), **_LITTLE}).fit(references, places)


@contextmanager
def _on_cores(threads: int, settings: Settings) -> Iterator[None]:
    machine.pin_threads(threads)
    try:
        yield
    finally:
        machine.pin_threads(settings.threads or len(machine.cores()))
