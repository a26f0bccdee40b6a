"""The benchmark of speed: training, preprocessing, queries and how they grow, measured in one run on one machine."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Iterator
from typing import Any

import psutil

from vprbench.run import machine
from vprbench.speed import frames, matching, training, vprsnn
from vprbench.speed.cells import Report
from vprbench.speed.measure import Make
from vprbench.speed.route import Route
from vprbench.speed.settings import FRAME, Bench, Settings

_SECTIONS: dict[str, Callable[[Bench], Iterator[Any]]] = {
    "training": training.training,
    "fits": training.fits,
    "reading": frames.reading,
    "preprocessing": frames.preprocessing,
    "queries": matching.queries,
    "search": matching.search,
    "scaling": training.scaling,
    "vprsnn_training": vprsnn.training,
    "vprsnn_queries": vprsnn.queries,
}


def measure(settings: Settings, make: Make) -> Report:
    """Measure all sections; what cannot be measured becomes a cell that says why."""
    started = time.perf_counter()
    surroundings = machine.capture(settings.device, settings.threads or len(machine.cores()))
    machine.canary_seconds()  # an idle processor needs a while to find its clock
    canary = {"start": machine.canary_seconds()}
    places = max(settings.places, settings.max_module, settings.vprsnn_places, *settings.sizes)
    bench = Bench(settings, make, Route.drawn(places, *FRAME, settings.seed))
    cells = {}
    for name, section in _SECTIONS.items():
        gc.collect()  # what an earlier section left counts as no memory of this one
        cells[name] = list(section(bench)) if name in settings.sections else []
        canary[name] = machine.canary_seconds()
    return Report(
        settings,
        surroundings,
        canary,
        list(psutil.getloadavg()),
        machine.cpu_pressure(),
        time.perf_counter() - started,
        **cells,
    )
