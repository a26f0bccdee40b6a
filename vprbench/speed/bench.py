"""The benchmark of speed: training, preprocessing, queries and how they grow, measured in one run on one machine."""

from __future__ import annotations

import gc
import logging
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from itertools import count
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt
import psutil

from vprbench import progress
from vprbench.api.method import Method
from vprbench.api.preprocess import Engine, PatchNormalisation
from vprbench.api.search import Search
from vprbench.api.search_indexes import faiss_module
from vprbench.errors import BadInput
from vprbench.metrics.ranking import best_places
from vprbench.progress import listening
from vprbench.run import machine
from vprbench.run.stopwatch import Protocol, Stopwatch
from vprbench.speed.measure import Fit, Make, floor_laps, measured_rates, rounded, timed_fit, weight_bytes
from vprbench.speed.reading import frame_files, in_own_process, reading_cell
from vprbench.speed.route import Route
from vprbench.speed.settings import (
    ENGINES,
    FRAME,
    PATCH,
    RULES,
    TRAVERSES,
    VPRSNN,
    AskingCell,
    Counted,
    Failed,
    FitCell,
    ModuleCell,
    PreprocessingCell,
    QueryCell,
    ReadingCell,
    Report,
    ScalingCell,
    SearchCell,
    Settings,
    TrainingCell,
)
from vprbench.speed.vprsnn import asking_cell, module_cell

Cell = TypeVar("Cell")

_LITTLE = 8  # places of a fit that only compiles; too few to be judged as diverged
_SHORT = 2.0  # seconds; a shorter fit is repeated
_BYTES = 4  # of a float32
_TURN = 0.1  # seconds of calls one after the other
_PAUSE = 0.01  # seconds after which the waiting threads of another library have gone to sleep
_BEST = 100  # references that a library's search returns


def measure(settings: Settings, make: Make) -> Report:
    """Measure all sections; what cannot be measured becomes a cell that says why."""
    started = time.perf_counter()
    surroundings = machine.capture(settings.device, settings.threads or len(machine.cores()))
    machine.canary_seconds()  # an idle processor needs a while to find its clock
    canary = {"start": machine.canary_seconds()}
    places = max(settings.places, settings.max_module, settings.vprsnn_places, *settings.sizes)
    route = Route.drawn(places, *FRAME, settings.seed)
    networks: dict[str, Method] = {}
    modules: dict[str, Method] = {}
    sections: dict[str, Callable[[], Iterator[Any]]] = {
        "training": partial(_training, settings, make, route),
        "fits": partial(_fits, settings, make, route, networks),
        "reading": partial(_reading, settings),
        "preprocessing": partial(_preprocessing, settings),
        "queries": partial(_queries, settings, make, route, networks),
        "search": partial(_search, settings, make, route),
        "scaling": partial(_scaling, settings, make, route),
        "vprsnn_training": partial(_vprsnn_training, settings, make, route, modules),
        "vprsnn_queries": partial(_vprsnn_queries, settings, make, route, modules),
    }
    cells = {}
    for name, section in sections.items():
        gc.collect()  # what an earlier section left counts as no memory of this one
        cells[name] = list(section()) if name in settings.sections else []
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


def _attempt(what: dict[str, str], measured: Callable[[], Cell]) -> Cell | Failed:
    """Return what is measured, or why it could not be: one cell never ends the others."""
    try:
        return measured()
    except Exception as error:
        reason = str(error) if isinstance(error, BadInput) else f"{type(error).__name__}: {error}"
        logging.warning("%s failed: %s", " ".join(what.values()), reason)
        return Failed(what, reason.splitlines()[0])


def _warm_up(settings: Settings, make: Make, route: Route, rules: str, **arguments: Any) -> None:
    """Let an engine compile what it needs for a fit."""
    references, places = route.references(min(_LITTLE, len(route.frames)), TRAVERSES)
    little = {**settings.vprtempo(rules, int(places.max()) + 1), "epochs": 1, **arguments}
    with listening(lambda *_: None):
        make("vprtempo", settings.device, **little).fit(references, places)


def _training(settings: Settings, make: Make, route: Route) -> Iterator[TrainingCell | Failed]:
    for rules in RULES:
        yield _attempt({"rules": rules}, partial(_training_cell, settings, make, route, rules))


def _training_cell(settings: Settings, make: Make, route: Route, rules: str) -> TrainingCell:
    places = settings.max_module
    references, shown = route.references(places, TRAVERSES)
    for engine in ENGINES:
        _warm_up(settings, make, route, rules, engine=engine)
    fits: dict[Engine, list[Fit]] = {engine: [] for engine in ENGINES}
    floor: list[float] = []
    n_bytes = 0
    for turn in range(settings.rounds):
        for engine in ENGINES:
            title = f"training step, {rules}, {engine}, round {turn + 1} of {settings.rounds}"
            network = make("vprtempo", settings.device, engine=engine, epochs=1, **settings.vprtempo(rules, places))
            fits[engine].append(timed_fit(title, network, references, shown, settings.device))
            n_bytes = 2 * weight_bytes(network, _BYTES)
        floor += floor_laps("pass", n_bytes, settings.device, settings.minimum_seconds / 4)
    return TrainingCell(rules, places, len(shown), fits, n_bytes, floor)


def _fits(settings: Settings, make: Make, route: Route, networks: dict[str, Method]) -> Iterator[FitCell | Failed]:
    """Yield the fits; the trained networks are left in `networks`."""
    references, places = route.references(settings.places, TRAVERSES)
    for rules in RULES:

        def measured(rules: str = rules) -> FitCell:
            _warm_up(settings, make, route, rules)
            network = make(
                "vprtempo", settings.device, epochs=settings.epochs, **settings.vprtempo(rules, settings.places)
            )
            fit = timed_fit(f"fit, {rules}", network, references, places, settings.device)
            networks[rules] = network
            return FitCell(rules, settings.places, settings.epochs, fit)

        yield _attempt({"rules": rules}, measured)


def _reading(settings: Settings) -> Iterator[ReadingCell | Failed]:
    frame = {"frame": f"{settings.frame[1]}x{settings.frame[0]}"}
    with tempfile.TemporaryDirectory(prefix="vprbench-") as folder:
        paths = _attempt(frame, partial(frame_files, settings, Path(folder)))
        if isinstance(paths, Failed):
            yield paths
            return
        progress.report(f"reading {len(paths)} files", 0.0)
        yield _attempt(frame, partial(in_own_process, reading_cell, settings, paths))


def _preprocessing(settings: Settings) -> Iterator[PreprocessingCell | Failed]:
    for height, width in (FRAME, tuple(settings.frame)):
        for images_per_call in (1, settings.batch):
            what = {"frame": f"{width}x{height}", "images a call": str(images_per_call)}
            yield _attempt(what, partial(_preprocessing_cell, settings, height, width, images_per_call))


def _preprocessing_cell(settings: Settings, height: int, width: int, images_per_call: int) -> PreprocessingCell:
    progress.report(f"preprocessing, {width}x{height}, {images_per_call} a call", 0.0)
    images, _ = Route.drawn(settings.batch, height, width, settings.seed).references(settings.batch, 1)
    parts = list(images.blocks(images_per_call))
    engines = {engine: PatchNormalisation("C", settings.pixels, settings.pixels, PATCH, engine) for engine in ENGINES}
    for normalise in engines.values():
        normalise(parts[0])
    watch = Stopwatch(Protocol())
    laps: dict[Engine, list[float]] = {engine: [] for engine in ENGINES}
    for turn in count(1):
        for engine, normalise in engines.items():
            with watch.lap() as lap:
                normalise(parts[turn % len(parts)])
            laps[engine] += lap
        if turn >= settings.rounds and sum(laps["readable"]) >= settings.minimum_seconds:
            break
    return PreprocessingCell(
        height, width, images_per_call, {engine: rounded(seconds) for engine, seconds in laps.items()}
    )


def _queries(
    settings: Settings, make: Make, route: Route, networks: Mapping[str, Method]
) -> Iterator[QueryCell | Failed]:
    references, places = route.references(settings.places, TRAVERSES)
    seen = {"height": settings.pixels, "width": settings.pixels, "patch": PATCH}

    def sad() -> Method:
        return make("sad", settings.device, **seen).fit(references, places)

    def trained(rules: str) -> Method:
        if rules not in networks:
            raise BadInput("its network could not be trained, see above")
        return networks[rules]

    def in_8_bits(rules: str) -> Method:
        arguments = {**settings.vprtempo(rules, settings.places), "epochs": settings.epochs}
        return make("vprtempo_int8", settings.device, **arguments).restore(trained(rules).state())

    def ensemble() -> Method:
        arguments = {**settings.vprtempo("reference", settings.places), "members": settings.members, "epochs": 1}
        return make("vprtempo_ensemble", settings.device, **arguments).fit(*route.references(settings.places, 1))

    contestants: list[tuple[str, Callable[[], Method], Counted, int]] = [
        ("sad", sad, "references", 1 if settings.device == "cpu" else _BYTES),  # on the CPU its frames stay 8 bits
        ("vprtempo paper", partial(trained, "paper"), "network", _BYTES),
        ("vprtempo reference", partial(trained, "reference"), "matrix", _BYTES),
        ("vprtempo_int8 paper", partial(in_8_bits, "paper"), "network", 1),
        ("vprtempo_int8 reference", partial(in_8_bits, "reference"), "matrix", 1),
        (f"vprtempo_ensemble reference members={settings.members}", ensemble, "matrix", _BYTES),
    ]
    for label, fitted, counted, bytes_each in contestants:
        yield _attempt({"method": label}, partial(_query_cell, settings, route, label, fitted, counted, bytes_each))


def _query_cell(
    settings: Settings, route: Route, label: str, fitted: Callable[[], Method], counted: Counted, bytes_each: int
) -> QueryCell:
    progress.report(f"query, {label}", 0.0)
    method = fitted()
    if counted == "network":
        n_bytes = weight_bytes(method, bytes_each)
    else:
        rows = settings.places * (TRAVERSES if counted == "references" else 1)
        n_bytes = rows * settings.pixels**2 * bytes_each
    queries, _ = route.queries(settings.places, settings.sample)
    rates = measured_rates(f"query, {label}", method, queries, settings.protocol(), settings.device)
    device = settings.device if bytes_each == _BYTES else "cpu"  # where 8-bit networks answer
    floor = floor_laps("read", n_bytes, device, settings.minimum_seconds / 4)
    return QueryCell(label, settings.places, rates, counted, n_bytes, floor)


def _search(settings: Settings, make: Make, route: Route) -> Iterator[SearchCell | Failed]:
    for images_per_call in (1, settings.batch):
        what = {"method": "exact search", "images a call": str(images_per_call)}
        yield _attempt(what, partial(_exact_search_cell, settings, images_per_call))
    what = {"method": "exact search", "images a call": str(settings.search_queries)}
    yield _attempt(what, partial(_traverse_search_cell, settings))
    yield _attempt({"method": "sad"}, partial(_sad_cell, settings, make, route))


def _exact_search_cell(settings: Settings, images_per_call: int) -> SearchCell:
    progress.report(f"exact search, {images_per_call} a call", 0.0)
    codes, exact, library, best = _searched(settings, images_per_call)
    return _beside(
        settings,
        ("exact search", "faiss.IndexFlatIP", *exact.references.shape, images_per_call),
        lambda: exact.scores(codes),
        lambda: library.search(codes, best),
    )


def _traverse_search_cell(settings: Settings) -> SearchCell:
    """Search a whole traverse in blocks as a run does, and name the best places of each query."""
    progress.report("exact search, a traverse", 0.0)
    codes, exact, library, best = _searched(settings, settings.search_queries)

    def named() -> None:
        for first in range(0, len(codes), settings.batch):
            best_places(exact.scores(codes[first : first + settings.batch]), best)

    return _beside(
        settings,
        ("exact search, best 100", "faiss.IndexFlatIP", *exact.references.shape, len(codes)),
        named,
        lambda: library.search(codes, best),
    )


def _searched(settings: Settings, n_queries: int) -> tuple[npt.NDArray[np.float32], Search, Any, int]:
    """Return random codes, both searches of random references, and how many of the best are wanted."""
    faiss = faiss_module()
    generator = np.random.default_rng(settings.seed)
    codes, references = (
        generator.standard_normal((n, settings.search_dimensions), np.float32)
        for n in (n_queries, settings.search_references)
    )
    for vectors in (codes, references):
        vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
    library = faiss.IndexFlatIP(settings.search_dimensions)
    library.add(references)
    return codes, Search(references, np.arange(len(references))), library, min(_BEST, len(references))


def _sad_cell(settings: Settings, make: Make, route: Route) -> SearchCell:
    import torch

    progress.report("sad beside torch.cdist", 0.0)
    references, places = route.references(settings.places, 1)
    sad = make("sad", "cpu", height=settings.pixels, width=settings.pixels, patch=PATCH).fit(references, places)
    code = sad.encode(route.queries(settings.places, 1)[0])
    floats, query = (torch.from_numpy(levels).float() for levels in (sad.encode(references), code))
    return _beside(
        settings,
        ("sad", "torch.cdist", *floats.shape, 1),
        lambda: sad.match(code),
        lambda: torch.cdist(query, floats, p=1),
    )


def _beside(
    settings: Settings,
    what: tuple[str, str, int, int, int],
    ours: Callable[[], object],
    library: Callable[[], object],
) -> SearchCell:
    watch = Stopwatch(Protocol())
    machine.reset_peak_memory()
    before = psutil.Process().memory_info().rss
    ours()
    peak = machine.peak_memory_bytes()
    library()
    laps: list[list[float]] = [[], []]
    while len(laps[0]) < settings.rounds or sum(map(sum, laps)) < settings.minimum_seconds:
        for call, seconds in zip((ours, library), laps, strict=True):
            time.sleep(_PAUSE)
            turn: list[float] = []
            while sum(turn) < _TURN:
                with watch.lap() as lap:
                    call()
                turn += lap
            seconds += turn
    return SearchCell(*what, rounded(laps[0]), rounded(laps[1]), max(0, peak - before), peak)


def _scaling(settings: Settings, make: Make, route: Route) -> Iterator[ScalingCell | Failed]:
    for rules in RULES:
        smaller: ScalingCell | None = None
        for places in sorted(set(settings.sizes)):
            what = {"rules": rules, "places": f"{places:,}"}
            cell = _attempt(what, partial(_scaling_cell, settings, make, route, rules, places, smaller))
            if isinstance(cell, ScalingCell):
                smaller = cell
            yield cell


def _scaling_cell(
    settings: Settings, make: Make, route: Route, rules: str, places: int, smaller: ScalingCell | None
) -> ScalingCell:
    if smaller is None:
        _warm_up(settings, make, route, rules)
    else:
        _check_memory(places, smaller)
    title = f"growth, {rules}, {places} places"
    references, shown = route.references(places, 1)
    fits: list[Fit] = []
    while len(fits) < (settings.rounds if fits and fits[0].seconds < _SHORT else 1):
        arguments = {**settings.vprtempo(rules, places), "epochs": settings.scaling_epochs}
        network = make("vprtempo", settings.device, **arguments)
        fits.append(timed_fit(title, network, references, shown, settings.device))
    queries, _ = route.queries(places, settings.sample)
    rates = measured_rates(title, network, queries, settings.protocol(), settings.device)
    return ScalingCell(rules, places, settings.scaling_epochs, fits, rates)


def _check_memory(places: int, smaller: ScalingCell) -> None:
    """Raise BadInput where a fit would take more memory than is free, going by what a smaller one took."""
    took = smaller.fits[0].peak_memory_bytes - smaller.fits[0].memory_before_bytes
    needed, free = took * places / smaller.places, psutil.virtual_memory().available
    if needed > free:
        raise BadInput(
            f"{smaller.places:,} places took {took / 1e9:.1f} GB, and {free / 1e9:.1f} GB are free: not tried"
        )


def _vprsnn_training(
    settings: Settings, make: Make, route: Route, modules: dict[str, Method]
) -> Iterator[ModuleCell | Failed]:
    """Yield what trainings of a module took; the trained modules are left in `modules`."""
    for method in VPRSNN:
        yield _attempt({"method": method}, partial(module_cell, settings, make, route, modules, method))


def _vprsnn_queries(
    settings: Settings, make: Make, route: Route, modules: dict[str, Method]
) -> Iterator[AskingCell | Failed]:
    for wanted in settings.vprsnn_modules:
        for threads in sorted({1, settings.threads or len(machine.cores())}):
            what = {"modules": str(wanted), "cores": str(threads)}
            yield _attempt(what, partial(asking_cell, settings, make, route, modules, wanted, threads))
