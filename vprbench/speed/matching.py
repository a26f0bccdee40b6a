"""The benchmark of answers: queries to each method beside plain reads of memory, and matching beside libraries."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt
import psutil

from vprbench import progress
from vprbench.api.method import Method
from vprbench.api.search import Search
from vprbench.api.search_indexes import faiss_module
from vprbench.errors import BadInput
from vprbench.metrics.ranking import best_places
from vprbench.run import machine
from vprbench.run.stopwatch import Protocol, Stopwatch
from vprbench.speed.cells import Counted, Failed, QueryCell, SearchCell, attempt
from vprbench.speed.measure import floor_laps, measured_rates, rounded, weight_bytes
from vprbench.speed.settings import PATCH, TRAVERSES, Bench, Settings

_BYTES = 4  # of a float32
_TURN = 0.1  # seconds of calls one after the other
_PAUSE = 0.01  # seconds after which the waiting threads of another library have gone to sleep
_BEST = 100  # references that a library's search returns


def queries(bench: Bench) -> Iterator[QueryCell | Failed]:
    """Ask each method, VPRTempo with the networks that were trained before."""
    settings = bench.settings

    def sad() -> Method:
        seen = {"height": settings.pixels, "width": settings.pixels, "patch": PATCH}
        return bench.make("sad", settings.device, **seen).fit(*bench.route.references(settings.places, TRAVERSES))

    def trained(rules: str) -> Method:
        if rules not in bench.networks:
            raise BadInput("its network could not be trained, see above")
        return bench.networks[rules]

    def in_8_bits(rules: str) -> Method:
        arguments = {**settings.vprtempo(rules, settings.places), "epochs": settings.epochs}
        return bench.make("vprtempo_int8", settings.device, **arguments).restore(trained(rules).state())

    def ensemble() -> Method:
        arguments = {**settings.vprtempo("reference", settings.places), "members": settings.members, "epochs": 1}
        network = bench.make("vprtempo_ensemble", settings.device, **arguments)
        return network.fit(*bench.route.references(settings.places, 1))

    contestants: list[tuple[str, Callable[[], Method], Counted, int]] = [
        ("sad", sad, "references", 1 if settings.device == "cpu" else _BYTES),  # on the CPU its frames stay 8 bits
        ("vprtempo paper", partial(trained, "paper"), "network", _BYTES),
        ("vprtempo reference", partial(trained, "reference"), "matrix", _BYTES),
        ("vprtempo_int8 paper", partial(in_8_bits, "paper"), "network", 1),
        ("vprtempo_int8 reference", partial(in_8_bits, "reference"), "matrix", 1),
        (f"vprtempo_ensemble reference members={settings.members}", ensemble, "matrix", _BYTES),
    ]
    for contestant in contestants:
        yield attempt({"method": contestant[0]}, partial(_query_cell, bench, *contestant))


def _query_cell(bench: Bench, label: str, fitted: Callable[[], Method], counted: Counted, bytes_each: int) -> QueryCell:
    settings = bench.settings
    progress.report(f"query, {label}", 0.0)
    method = fitted()
    if counted == "network":
        n_bytes = weight_bytes(method, bytes_each)
    else:
        rows = settings.places * (TRAVERSES if counted == "references" else 1)
        n_bytes = rows * settings.pixels**2 * bytes_each
    asked, _ = bench.route.queries(settings.places, settings.sample)
    rates = measured_rates(f"query, {label}", method, asked, settings.protocol(), settings.device)
    device = settings.device if bytes_each == _BYTES else "cpu"  # where 8-bit networks answer
    floor = floor_laps("read", n_bytes, device, settings.minimum_seconds / 4)
    return QueryCell(label, settings.places, rates, counted, n_bytes, floor)


def search(bench: Bench) -> Iterator[SearchCell | Failed]:
    """Search descriptors beside faiss, a traverse of them as a run does, and match SAD's images beside PyTorch."""
    settings = bench.settings
    for images_per_call in (1, settings.batch):
        what = {"method": "exact search", "images a call": str(images_per_call)}
        yield attempt(what, partial(_exact_search_cell, settings, images_per_call))
    what = {"method": "exact search", "images a call": str(settings.search_queries)}
    yield attempt(what, partial(_traverse_search_cell, settings))
    yield attempt({"method": "sad"}, partial(_sad_cell, bench))


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


def _sad_cell(bench: Bench) -> SearchCell:
    import torch

    settings, route = bench.settings, bench.route
    progress.report("sad beside torch.cdist", 0.0)
    references, places = route.references(settings.places, 1)
    sad = bench.make("sad", "cpu", height=settings.pixels, width=settings.pixels, patch=PATCH).fit(references, places)
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
