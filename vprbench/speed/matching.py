"""The benchmark of answers: queries to each method beside plain reads of memory, and matching beside libraries."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np
import psutil

from vprbench.api.method import Method
from vprbench.api.search import Search
from vprbench.api.search_indexes import faiss_module
from vprbench.errors import BadInput
from vprbench.metrics.ranking import best_places
from vprbench.runs import machine
from vprbench.speed.measure import Rates, floor_laps, interleaved, measured_rates, median, weight_bytes
from vprbench.speed.report import Planned, figures, megabytes, milliseconds, rates_text, ratio
from vprbench.speed.route import unit_vectors
from vprbench.speed.settings import TRAVERSES, Bench, Settings

_BYTES = 4  # of a float32
_BURST = 0.1  # seconds of calls one after the other
_BEST = 100  # references that a library's search returns

Counted = Literal["network", "matrix", "references"]

_COUNTED: dict[Counted, str] = {
    "network": "all weights of both layers",
    "matrix": "the product of both layers, places x pixels",
    "references": "the reference images, images x pixels",
}


@dataclass(frozen=True)
class QueryCell:
    """The rates of one method, and plain reads of as many bytes as its weights have."""

    method: str
    places: int
    rates: Rates
    counted: Counted
    floor_bytes: int
    floor_seconds: list[float]

    def row(self) -> dict[str, str]:
        """Return the rates of single queries and of the best batch, and matching beside the floor."""
        floor, rates = median(self.floor_seconds), self.rates
        invalid = "" if rates.valid else " INVALID"
        return {
            "method": self.method,
            "streaming Hz enc/match/total": rates_text(rates.streaming) + invalid,
            "offline Hz enc/match/total": f"{rates_text(rates.offline)} (batch {rates.offline_batch}){invalid}",
            "floor us": figures(1e6 * floor),
            "streaming match / floor": ratio(1 / rates.streaming.match, floor),
            "floor reads": f"{figures(self.floor_bytes / 1e6)} MB: {_COUNTED[self.counted]}",
        }


@dataclass(frozen=True)
class SearchCell:
    """Matching by this project and by a library, a call of each after the other."""

    method: str
    library: str
    references: int
    dimensions: int
    images_per_call: int  # of ours in blocks if there are many
    seconds: list[float]  # per call
    library_seconds: list[float]
    memory_bytes: int  # that this project's calls took beyond what was resident, at most
    peak_memory_bytes: int  # of the process meanwhile

    def row(self) -> dict[str, str]:
        """Return the median times of both and this project's memory."""
        ours, library = median(self.seconds), median(self.library_seconds)
        return {
            "method": self.method,
            "references": f"{self.references:,} x {self.dimensions:,}",
            "images a call": str(self.images_per_call),
            "ours: ms": milliseconds(ours),
            "ours: Hz": figures(self.images_per_call / ours),
            "library: ms": milliseconds(library),
            "ours / library": ratio(ours, library),
            "library": self.library,
            "memory MB": megabytes(self.memory_bytes),
            "peak MB": megabytes(self.peak_memory_bytes),
        }


def queries(bench: Bench) -> Iterator[Planned]:
    """Ask each method, VPRTempo with the networks that were trained before."""
    settings, route = bench.settings, bench.route

    def sad() -> Method:
        return bench.make("sad", settings.device, **settings.seen()).fit(*route.references(settings.places, TRAVERSES))

    def trained(rules: str) -> Method:
        if rules not in bench.networks:
            raise BadInput("its network could not be trained, see above")
        return bench.networks[rules]

    def in_8_bits(rules: str) -> Method:
        return bench.vprtempo(rules, settings.places, "vprtempo_int8").restore(trained(rules).state())

    def ensemble() -> Method:
        arguments = {"members": settings.members, "epochs": 1}
        network = bench.vprtempo("reference", settings.places, "vprtempo_ensemble", **arguments)
        return network.fit(*route.references(settings.places, 1))

    contestants: list[tuple[str, Callable[[], Method], Counted, int]] = [
        ("sad", sad, "references", 1 if settings.device == "cpu" else _BYTES),  # on the CPU its frames stay 8 bits
        ("vprtempo paper", partial(trained, "paper"), "network", _BYTES),
        ("vprtempo reference", partial(trained, "reference"), "matrix", _BYTES),
        ("vprtempo_int8 paper", partial(in_8_bits, "paper"), "network", 1),
        ("vprtempo_int8 reference", partial(in_8_bits, "reference"), "matrix", 1),
        (f"vprtempo_ensemble reference members={settings.members}", ensemble, "matrix", _BYTES),
    ]
    for contestant in contestants:
        yield {"method": contestant[0]}, partial(_query_cell, bench, *contestant)


def _query_cell(bench: Bench, label: str, fitted: Callable[[], Method], counted: Counted, bytes_each: int) -> QueryCell:
    settings = bench.settings
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


def search(bench: Bench) -> Iterator[Planned]:
    """Search descriptors beside faiss, a traverse of them as a run does, and match SAD's images beside PyTorch."""
    settings = bench.settings
    for title, n_queries in (
        ("exact search", 1),
        ("exact search", settings.batch),
        ("exact search, best 100", settings.search_queries),
    ):
        what = {"method": "exact search", "images a call": str(n_queries)}
        yield what, partial(_exact_search_cell, settings, title, n_queries)
    yield {"method": "sad"}, partial(_sad_cell, bench)


def _exact_search_cell(settings: Settings, title: str, n_queries: int) -> SearchCell:
    """Search random references for random codes; if the best are wanted too, in blocks as a run does."""
    faiss = faiss_module()
    generator = np.random.default_rng(settings.seed)
    codes = unit_vectors(n_queries, settings.search_dimensions, generator)
    references = unit_vectors(settings.search_references, settings.search_dimensions, generator)
    library = faiss.IndexFlatIP(settings.search_dimensions)
    library.add(references)
    exact, best = Search(references, np.arange(len(references))), min(_BEST, len(references))

    def named() -> None:
        for first in range(0, len(codes), settings.batch):
            best_places(exact.scores(codes[first : first + settings.batch]), best)

    ours: Callable[[], object] = named if "best" in title else lambda: exact.scores(codes)
    what = (title, "faiss.IndexFlatIP", *references.shape, n_queries)
    return _beside(settings, what, ours, lambda: library.search(codes, best))


def _sad_cell(bench: Bench) -> SearchCell:
    import torch

    settings, route = bench.settings, bench.route
    references, places = route.references(settings.places, 1)
    sad = bench.make("sad", "cpu", **settings.seen()).fit(references, places)
    code = sad.encode(route.queries(settings.places, 1)[0])
    floats, query = (torch.from_numpy(levels).float() for levels in (sad.encode(references), code))
    what = ("sad", "torch.cdist", *floats.shape, 1)
    return _beside(settings, what, lambda: sad.match(code), lambda: torch.cdist(query, floats, p=1))


def _beside(
    settings: Settings,
    what: tuple[str, str, int, int, int],
    ours: Callable[[], object],
    library: Callable[[], object],
) -> SearchCell:
    machine.reset_peak_memory()
    before = psutil.Process().memory_info().rss
    ours()
    peak = machine.peak_memory_bytes()
    library()
    calls = {"ours": lambda _: ours(), "library": lambda _: library()}
    laps = interleaved(calls, settings.rounds, settings.minimum_seconds, burst=_BURST)
    return SearchCell(*what, laps["ours"], laps["library"], max(0, peak - before), peak)
