"""Whether a GPU gives the networks that the CPU gives, and how fast it is: the check to run where there is one."""

from __future__ import annotations

import importlib.metadata
import math
import os
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from vprbench import progress
from vprbench.api.arrays import Scores
from vprbench.api.images import Images
from vprbench.api.method import Method
from vprbench.errors import BadInput
from vprbench.run import machine
from vprbench.run.document import document
from vprbench.run.stopwatch import Protocol, Stopwatch, synchroniser
from vprbench.speed.cells import Failed, attempt
from vprbench.speed.format import publish, rates_text, table
from vprbench.speed.measure import Make, Rates, measured_rates
from vprbench.speed.route import Route
from vprbench.speed.settings import FRAME, PATCH, RULES, TRAVERSES

TOLERANCE = 1e-4  # of the largest weight or score
TARGET_FIT_SECONDS = 2.0  # on an H200
TARGET_OFFLINE_HZ = 100_000.0


@dataclass(frozen=True)
class Settings:
    """What to compare and to time; raises BadInput where nothing would be."""

    check_places: int = 200
    places: int = 3300  # of what is timed
    max_module: int = 1100  # places
    epochs: int = 4
    pixels: int = 28  # height and width of what a network reads
    batch_sizes: list[int] = field(default_factory=lambda: [1, 128, 1024, 8192])
    minimum_seconds: float = 2.0  # of each rate
    quick: bool = False  # tiny sizes: everything runs, no time means anything
    seed: int = 0
    device: str = "cuda"
    threads: int | None = None  # None: all cores this process may use
    results: str = "results"

    def __post_init__(self) -> None:
        """Check that something will be compared and timed."""
        for name in ("check_places", "places", "max_module", "epochs", "pixels"):
            if getattr(self, name) < 1:
                raise BadInput(f"{name}={getattr(self, name)}: give at least 1")
        if not self.batch_sizes or min(self.batch_sizes) < 1:
            raise BadInput(f"batch_sizes={self.batch_sizes}: give numbers of images, as in batch_sizes=[1,128]")
        if not 0 <= self.minimum_seconds < math.inf:
            raise BadInput(f"minimum_seconds={self.minimum_seconds}: give seconds")

    def vprtempo(self, rules: str, n_places: int) -> dict[str, Any]:
        """Return the arguments of a VPRTempo network of so many places."""
        seen = {"height": self.pixels, "width": self.pixels, "patch": PATCH}
        return {"rules": rules, "max_module": min(n_places, self.max_module), "epochs": self.epochs, **seen}


QUICK: Mapping[str, Any] = {
    "check_places": 12,
    "places": 20,
    "max_module": 10,
    "epochs": 2,
    "pixels": 12,
    "batch_sizes": [1, 4],
    "minimum_seconds": 0.0,
}


@dataclass(frozen=True)
class Comparison:
    """How far two ways to the same answer lie apart."""

    rules: str
    what: str
    of: Literal["weight", "score"]
    difference: float  # the largest, as a share of an array's largest weight or of a query's largest score
    other_places: int  # queries whose best place here is not among the best there, but for the tolerance
    queries: int

    @property
    def holds(self) -> bool:
        """Whether both are the same but for rounding."""
        return self.difference <= TOLERANCE and self.other_places == 0


@dataclass(frozen=True)
class Timed:
    """The times of one rule set on the GPU."""

    rules: str
    first_fit_seconds: float  # what Triton compiles included
    second_fit_seconds: float
    rates: Rates


@dataclass(frozen=True)
class Report:
    """Everything that one check found."""

    settings: Settings
    environment: dict[str, Any]
    triton: str
    timed: list[Timed | Failed]
    comparisons: list[Comparison | Failed]

    @property
    def correct(self) -> bool:
        """Whether all comparisons were made and hold, and nothing ended with an error."""
        return all(isinstance(each, Comparison) and each.holds for each in self.comparisons) and not any(
            isinstance(each, Failed) for each in self.timed
        )


def require_gpu(device: str) -> None:
    """Raise BadInput where PyTorch sees no GPU."""
    import torch

    if torch.cuda.device_count() == 0:
        raise BadInput(
            f"PyTorch {torch.__version__} sees no GPU here: gpu-check needs one and a build with CUDA (a version that "
            "ends in +cpu has none), nothing was written"
        )
    if not device.startswith("cuda"):
        raise BadInput(f"device={device}: gpu-check compares a GPU with the CPU, give cuda or cuda:1")


def measure(settings: Settings, make: Make) -> Report:
    """Time the GPU, then compare it with the CPU."""
    surroundings = machine.capture(settings.device, settings.threads or len(machine.cores()))
    route = Route.drawn(max(settings.check_places, settings.places), *FRAME, settings.seed)
    comparisons: list[Comparison | Failed] = []
    with _nothing_compiled():  # timed before anything else makes Triton compile
        timed = [attempt({"rules": rules}, partial(_timed, settings, make, route, rules)) for rules in RULES]
        for rules in RULES:
            found = attempt({"rules": rules}, partial(compared, settings, make, route, rules))
            comparisons += [found] if isinstance(found, Failed) else found
    return Report(settings, surroundings, _triton(), timed, comparisons)


def write(report: Report, results: Path) -> None:
    """Print the report as Markdown, and leave it in gpu.md of the folder `results`."""
    publish(results, gpu_md=text_of(report))


def text_of(report: Report) -> str:
    """Return a report as Markdown."""
    return document(
        Path(__file__).with_name("gpu.md.j2"),
        report=report,
        settings=report.settings,
        comparisons=table(report.comparisons, _comparison_row),
        training=table(report.timed, _training_row),
        queries=[row for each in report.timed for row in _query_rows(each)],
        places=f"{report.settings.places:,}",
        machine=machine.machine_lines(report.environment),
        **{"TOLERANCE": TOLERANCE, "TRAVERSES": TRAVERSES},
    )


def _comparison_row(each: Comparison) -> dict[str, str]:
    return {
        "rules": each.rules,
        "compared": each.what,
        "difference": f"{each.difference:.1e} of the largest {each.of}",
        "other best places": f"{each.other_places} of {each.queries}",
        "result": "same" if each.holds else "FAILED",
    }


def _training_row(each: Timed) -> dict[str, str]:
    return {
        "rules": each.rules,
        "first fit s": f"{each.first_fit_seconds:.2f}",
        "second fit s": f"{each.second_fit_seconds:.2f}",
        "target s": f"{TARGET_FIT_SECONDS:g}, {_met(each.second_fit_seconds <= TARGET_FIT_SECONDS)} by the second",
    }


def _query_rows(each: Timed | Failed) -> Iterator[dict[str, str]]:
    if isinstance(each, Failed):
        yield {**each.what, "failed": each.reason}
        return
    rates = each.rates
    note = "" if rates.valid else " INVALID"
    yield {"rules": each.rules, "scenario": "streaming", "Hz enc/match/total": rates_text(rates.streaming) + note}
    for laps in rates.offline_laps:
        offline = laps.offline_rates()
        yield {
            "rules": each.rules,
            "scenario": f"offline, batch {laps.images_per_call:,}",
            "Hz enc/match/total": rates_text(offline) + note,
            "target Hz": f"{TARGET_OFFLINE_HZ:,.0f}, {_met(offline.total >= TARGET_OFFLINE_HZ)}",
        }


def _met(reached: bool) -> str:
    return "met" if reached else "missed"


def compared(settings: Settings, make: Make, route: Route, rules: str) -> list[Comparison]:
    """Train the same network three times, and compare what they learnt and answer."""
    references, places = route.references(settings.check_places, TRAVERSES)
    queries, _ = route.queries(settings.check_places, settings.check_places)
    networks = {}
    for title, device, engine in (
        ("CPU, fused", "cpu", "fused"),
        ("GPU, fused", settings.device, "fused"),
        ("GPU, readable", settings.device, "readable"),
    ):
        progress.report(f"comparison, {rules}: {title}", 0.0)
        arguments = settings.vprtempo(rules, settings.check_places)
        arguments["max_module"] = max(1, 2 * settings.check_places // 5)  # two whole modules and a smaller one
        networks[title] = make("vprtempo", device, engine=engine, **arguments).fit(references, places)
    found = [
        _networks_apart(rules, first, networks[first], second, networks[second], queries)
        for first, second in (("GPU, fused", "CPU, fused"), ("GPU, fused", "GPU, readable"))
    ]
    gpu = networks["GPU, fused"]
    together = gpu.query(queries)
    one_by_one = np.concatenate([gpu.query(queries[i : i + 1]) for i in range(len(queries))])
    title = "GPU, fused: a batch against single queries"
    difference, other_places = _scores_apart(together, one_by_one)
    return [*found, Comparison(rules, title, "score", difference, other_places, len(queries))]


def _networks_apart(rules: str, first: str, one: Method, second: str, other: Method, queries: Images) -> Comparison:
    here, there = one.state(), other.state()
    weights = max(_apart(here[name], there[name]) for name in there)
    _, other_places = _scores_apart(one.query(queries), other.query(queries))
    return Comparison(rules, f"{first} against {second}", "weight", weights, other_places, len(queries))


def _apart(here: npt.NDArray[Any], there: npt.NDArray[Any]) -> float:
    """Return the largest difference as a share of the largest number, infinite where that is no number."""
    share = float(np.abs(here - there).max()) / (float(np.abs(there).max()) or 1.0)
    return share if math.isfinite(share) else math.inf


def _scores_apart(here: Scores, there: Scores) -> tuple[float, int]:
    """Return the largest difference as a share of a query's largest score, and how many queries name other places."""
    largest = np.abs(there).max(1, keepdims=True)
    share = float((np.abs(here - there) / np.where(largest == 0, 1, largest)).max())
    named = np.take_along_axis(there, here.argmax(1)[:, None], axis=1)
    best = there.max(1, keepdims=True)
    return share if math.isfinite(share) else math.inf, int((~(named >= best - TOLERANCE * largest)).sum())


def _timed(settings: Settings, make: Make, route: Route, rules: str) -> Timed:
    references, places = route.references(settings.places, TRAVERSES)
    watch = Stopwatch(Protocol(), synchronise=synchroniser(settings.device))
    fits = []
    for number in ("first", "second"):
        progress.report(f"{rules}: {number} fit", 0.0)
        network = make("vprtempo", settings.device, engine="fused", **settings.vprtempo(rules, settings.places))
        with watch.lap() as lap:
            network.fit(references, places)
        fits += lap
    queries, _ = route.queries(settings.places, max(settings.batch_sizes))
    protocol = Protocol(
        minimum_seconds=settings.minimum_seconds,
        maximum_seconds=max(30.0, settings.minimum_seconds),
        sample=len(queries),
        batch_sizes=settings.batch_sizes,
    )
    rates = measured_rates(f"{rules}: queries", network, queries, protocol, settings.device)
    return Timed(rules, fits[0], fits[1], rates)


@contextmanager
def _nothing_compiled() -> Iterator[None]:
    """Give Triton an empty cache, so that the first fit compiles."""
    kept = os.environ.get("TRITON_CACHE_DIR")
    with tempfile.TemporaryDirectory() as folder:
        os.environ["TRITON_CACHE_DIR"] = folder
        try:
            yield
        finally:
            del os.environ["TRITON_CACHE_DIR"]
            if kept is not None:
                os.environ["TRITON_CACHE_DIR"] = kept


def _triton() -> str:
    try:
        return importlib.metadata.version("triton")
    except importlib.metadata.PackageNotFoundError:
        return "missing"
