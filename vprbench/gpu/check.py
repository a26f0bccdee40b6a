"""Whether a GPU gives the networks that the CPU gives, and how fast it is: the check to run where there is one."""

from __future__ import annotations

import math
import os
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Self
from unittest.mock import patch

import cv2
import numpy as np
import numpy.typing as npt

from vprbench import progress
from vprbench.api.arrays import Places, Scores
from vprbench.api.images import Images
from vprbench.api.method import Method
from vprbench.errors import BadInput
from vprbench.runs import machine
from vprbench.runs.rows import document
from vprbench.runs.stopwatch import Protocol, StageRates, Stopwatch, Timing, synchroniser
from vprbench.text import format_rate

_PIXELS_PER_CELL = 4  # of the coarse grid that a frame is blown up from
_NOISE = 12  # grey levels to either side that a copy of a frame differs by
_QUERIES = 1_000_000  # a traverse number that no reference has


@dataclass(frozen=True)
class Route:
    """Frames, one a place; a further traverse shows each of them with noise of its own."""

    frames: npt.NDArray[np.uint8]  # (n_places, height, width)
    seed: int

    @classmethod
    def drawn(cls, n_places: int, height: int = 32, width: int = 64, seed: int = 0) -> Self:
        """Draw the frames of a route."""
        generator = np.random.default_rng(seed)
        frames = np.empty((n_places, height, width), np.uint8)
        for frame in frames:
            coarse = generator.uniform(0, 255, (-(-height // _PIXELS_PER_CELL), -(-width // _PIXELS_PER_CELL)))
            blown_up = cv2.resize(coarse.astype(np.float32), (width, height), interpolation=cv2.INTER_CUBIC)
            np.clip(blown_up, 0, 255, out=frame, casting="unsafe")
        return cls(frames, seed)

    def references(self, n_places: int, traverses: int = 1) -> tuple[Images, Places]:
        """Return `traverses` traverses of the first places, and the place that each image shows."""
        shown = [self.frames[:n_places], *(self._noisy(np.arange(n_places), n) for n in range(1, traverses))]
        return Images.from_arrays([*np.concatenate(shown)]), np.tile(np.arange(n_places), traverses)

    def queries(self, n_places: int, count: int) -> Images:
        """Return `count` noisy frames, evenly spread over the first places."""
        return Images.from_arrays([*self._noisy(np.linspace(0, n_places - 1, count).astype(np.int64), _QUERIES)])

    def _noisy(self, places: Places, traverse: int) -> npt.NDArray[np.uint8]:
        generator = np.random.default_rng([self.seed, traverse])
        chosen = self.frames[places]
        noise = generator.integers(-_NOISE, _NOISE + 1, chosen.shape, np.int16)
        return np.asarray(np.clip(chosen + noise, 0, 255), np.uint8)


TRAINED = "efficientnet"  # the descriptor that is compared and timed too
TOLERANCE = 1e-4  # of the largest weight or score
TARGET_FIT_SECONDS = 2.0  # on an H200
TARGET_OFFLINE_HZ = 100_000.0
RULES = ("paper", "reference")
TRAVERSES = 2
_PATCH = 7  # pixels
_POSITIVE = ("places", "max_module", "epochs", "pixels", "check_places")

Make = Callable[..., Method]  # of a method's name, a device and arguments other than those of its yaml
Row = dict[str, str]


@dataclass(frozen=True, kw_only=True)
class Settings:
    """What to compare and to time; raises BadInput if nothing would be."""

    places: int = 3300  # of the fit and the queries
    check_places: int = 200  # of the comparison
    max_module: int = 1100  # places
    epochs: int = 4
    pixels: int = 28  # height and width of what a network reads
    batch_sizes: list[int] = field(default_factory=lambda: [1, 128, 1024, 8192])  # of offline queries
    minimum_seconds: float = 2.0  # of each rate
    device: str = "cuda"
    quick: bool = False  # tiny sizes: everything runs, no time means anything
    seed: int = 0
    threads: int | None = None  # None: all cores this process may use
    results: str = "results"

    def __post_init__(self) -> None:
        """Check the numbers."""
        for name in _POSITIVE:
            if getattr(self, name) < 1:
                raise BadInput(f"{name}={getattr(self, name)}: give at least 1")
        if not self.batch_sizes or min(self.batch_sizes) < 1:
            raise BadInput(f"batch_sizes={self.batch_sizes}: give numbers of at least 1, as in batch_sizes=[1,128]")
        if not 0 <= self.minimum_seconds < math.inf:
            raise BadInput(f"minimum_seconds={self.minimum_seconds}: give seconds")

    def vprtempo(self, rules: str, n_places: int) -> dict[str, Any]:
        """Return the arguments of a VPRTempo network of so many places."""
        seen = {"height": self.pixels, "width": self.pixels, "patch": _PATCH}
        return {"rules": rules, "max_module": min(n_places, self.max_module), "epochs": self.epochs, **seen}


QUICK = {
    **{"places": 20, "check_places": 12, "max_module": 10, "epochs": 2, "pixels": 12},
    **{"batch_sizes": [1, 4], "minimum_seconds": 0.0},
}


@dataclass(frozen=True)
class Report:
    """Rows of what a check found; what ended with an error has a row with the reason under `failed`."""

    settings: Settings
    environment: dict[str, Any]
    timing: list[Row]
    queries: list[Row]
    comparison: list[Row]
    correct: bool  # all comparisons were made and hold, and nothing ended with an error


@dataclass(frozen=True)
class Comparison:
    """How far two ways to the same answer lie apart."""

    rules: str
    what: str
    of: str  # weight or score
    difference: float  # the largest, as a share of an array's largest weight or of a query's largest score
    other_places: int  # queries whose best place here is not among the best there, but for the tolerance
    queries: int

    @property
    def holds(self) -> bool:
        """Whether both are the same but for rounding."""
        return self.difference <= TOLERANCE and self.other_places == 0

    def row(self) -> Row:
        """Return the difference, and whether it holds."""
        return {
            "rules": self.rules,
            "compared": self.what,
            "difference": f"{self.difference:.1e} of the largest {self.of}",
            "other best places": f"{self.other_places} of {self.queries}",
            "result": "same" if self.holds else "FAILED",
        }


def require_gpu(device: str) -> None:
    """Raise BadInput if PyTorch sees no GPU."""
    import torch

    if torch.cuda.device_count() == 0:
        raise BadInput(
            f"PyTorch {torch.__version__} sees no GPU here: gpu-check needs one and a build with CUDA (a version that "
            "ends in +cpu has none), nothing was written"
        )
    if not device.startswith("cuda"):
        raise BadInput(f"device={device}: gpu-check compares a GPU with the CPU, give cuda or cuda:1")


def check_gpu(settings: Settings, make: Make) -> Report:
    """Time the GPU, then compare it with the CPU; an error ends its own part alone."""
    surroundings = machine.capture(settings.device, settings.threads or len(machine.cores()))
    route = Route.drawn(max(settings.check_places, settings.places), seed=settings.seed)
    timing: list[Row] = []
    queries: list[Row] = []
    comparison: list[Row] = []
    correct = True
    # Triton begins with an empty cache, and is timed before anything else makes it compile.
    with tempfile.TemporaryDirectory() as empty, patch.dict(os.environ, TRITON_CACHE_DIR=empty):
        for rules in RULES:
            try:
                trained, asked = timed(settings, make, route, rules)
                timing.append(trained)
                queries += asked
            except Exception as error:  # whatever CUDA or Triton raise
                correct = False
                timing.append(_failed(rules, error))
                queries.append(_failed(rules, error))
        for rules in RULES:
            try:
                found = compared(settings, make, route, rules)
                correct &= all(each.holds for each in found)
                comparison += [each.row() for each in found]
            except Exception as error:  # whatever CUDA or Triton raise
                correct = False
                comparison.append(_failed(rules, error))
        try:
            descriptors = compare_descriptors(settings, make, route)
            correct &= descriptors.holds
            comparison.append(descriptors.row())
            queries += time_descriptors(settings, make, route)
        except Exception as error:  # whatever CUDA raises
            correct = False
            comparison.append(_failed(TRAINED, error))
    return Report(settings, surroundings, timing, queries, comparison, correct)


def to_text(report: Report) -> str:
    """Return a report as Markdown."""
    try:
        triton = version("triton")
    except PackageNotFoundError:
        triton = "missing"
    return document(
        Path(__file__).with_name("check.md.j2"),
        report=report,
        settings=report.settings,
        machine=machine.machine_lines(report.environment),
        triton=triton,
        **{"TOLERANCE": TOLERANCE, "TRAVERSES": TRAVERSES},
    )


def compared(settings: Settings, make: Make, route: Route, rules: str) -> list[Comparison]:
    """Train the same network three times, and compare what they learnt and answer."""
    references, places = route.references(settings.check_places, TRAVERSES)
    queries = route.queries(settings.check_places, settings.check_places)
    networks = {}
    for title, device, engine in (
        ("CPU, fused", "cpu", "fused"),
        ("GPU, fused", settings.device, "fused"),
        ("GPU, readable", settings.device, "readable"),
    ):
        progress.report(f"comparison, {rules}: {title}", 0.0)
        arguments = settings.vprtempo(rules, settings.check_places)
        arguments["max_module"] = max(1, 2 * settings.check_places // 5)  # three modules
        networks[title] = make("vprtempo", device, engine=engine, **arguments).fit(references, places)
    gpu = networks["GPU, fused"]
    together, found = gpu.query(queries), []
    for other in ("CPU, fused", "GPU, readable"):
        here, there = gpu.state(), networks[other].state()
        difference = max(_largest_difference(here[name], there[name]) for name in there)
        _, other_places = _score_difference(together, networks[other].query(queries))
        title = f"GPU, fused against {other}"
        found.append(Comparison(rules, title, "weight", difference, other_places, len(queries)))
    one_by_one = np.concatenate([gpu.query(queries[i : i + 1]) for i in range(len(queries))])
    title = "GPU, fused: a batch against single queries"
    return [*found, Comparison(rules, title, "score", *_score_difference(together, one_by_one), len(queries))]


def compare_descriptors(settings: Settings, make: Make, route: Route) -> Comparison:
    """Describe the same frames by a trained network on the GPU and on the CPU, and compare what they find."""
    progress.report(f"comparison, {TRAINED}", 0.0)
    references, places = route.references(settings.check_places)
    queries = route.queries(settings.check_places, settings.check_places)
    here, there = (make(TRAINED, device).fit(references, places) for device in (settings.device, "cpu"))
    difference = _largest_difference(here.encode(queries), there.encode(queries))
    _, other_places = _score_difference(here.query(queries), there.query(queries))
    return Comparison(TRAINED, "GPU against CPU", "number of a descriptor", difference, other_places, len(queries))


def time_descriptors(settings: Settings, make: Make, route: Route) -> list[Row]:
    """Return the rates of queries to a trained network's descriptors."""
    progress.report(f"{TRAINED}, queries", 0.0)
    network = make(TRAINED, settings.device).fit(*route.references(settings.check_places))
    queries = route.queries(settings.check_places, max(settings.batch_sizes))
    return _query_rows(TRAINED, _stopwatch(settings, len(queries)).measure(network, queries))


def _stopwatch(settings: Settings, sample: int) -> Stopwatch:
    protocol = Protocol(
        minimum_seconds=settings.minimum_seconds,
        maximum_seconds=max(30.0, settings.minimum_seconds),
        sample=sample,
        batch_sizes=settings.batch_sizes,
    )
    return Stopwatch(protocol, synchronise=synchroniser(settings.device))


def _query_rows(rules: str, timing: Timing) -> list[Row]:
    """Return the rates of single queries and of each batch."""
    note = "" if all(laps.valid for laps in (timing.streaming, *timing.offline)) else " INVALID"
    rates = [("streaming", StageRates.streaming(timing.streaming))]
    rates += [(f"offline, batch {laps.images_per_call:,}", StageRates.offline(laps)) for laps in timing.offline]
    return [{"rules": rules, "scenario": name, "Hz enc/match/total": _rates(each) + note} for name, each in rates]


def timed(settings: Settings, make: Make, route: Route, rules: str) -> tuple[Row, list[Row]]:
    """Fit a network twice and ask it; returns the row of the fits, and those of single queries and of each batch."""
    references, places = route.references(settings.places, TRAVERSES)
    queries = route.queries(settings.places, max(settings.batch_sizes))
    stopwatch = _stopwatch(settings, len(queries))
    fits = []
    for number in ("first", "second"):  # what Triton compiles is part of the first
        progress.report(f"{rules}, {number} fit", 0.0)
        network = make("vprtempo", settings.device, engine="fused", **settings.vprtempo(rules, settings.places))
        with stopwatch.lap() as lap:
            network.fit(references, places)
        fits += lap
    timing = stopwatch.measure(network, queries)
    reached = _met(fits[1] <= TARGET_FIT_SECONDS)
    trained = {"rules": rules, "first fit s": f"{fits[0]:.2f}", "second fit s": f"{fits[1]:.2f}"}
    asked = _query_rows(rules, timing)
    for row, laps in zip(asked[1:], timing.offline, strict=True):
        offline = StageRates.offline(laps)
        row["target Hz"] = f"{format_rate(TARGET_OFFLINE_HZ)}, {_met(offline.total >= TARGET_OFFLINE_HZ)}"
    return {**trained, "target s": f"{TARGET_FIT_SECONDS:g}, {reached} by the second"}, asked


def _rates(rates: StageRates) -> str:
    return " / ".join(map(format_rate, (rates.encode, rates.match, rates.total)))


def _met(reached: bool) -> str:
    return "met" if reached else "missed"


def _failed(rules: str, error: Exception) -> Row:
    return {"rules": rules, "failed": f"{type(error).__name__}: {error}".splitlines()[0]}


def _largest_difference(here: npt.NDArray[Any], there: npt.NDArray[Any]) -> float:
    """Return the largest difference as a share of the largest number, infinite if the share is no number."""
    share = float(np.abs(here - there).max()) / (float(np.abs(there).max()) or 1.0)
    return share if math.isfinite(share) else math.inf


def _score_difference(here: Scores, there: Scores) -> tuple[float, int]:
    """Return the largest difference as a share of a query's largest score, and how many queries name other places."""
    largest = np.abs(there).max(1, keepdims=True)
    share = float((np.abs(here - there) / np.where(largest == 0, 1, largest)).max())
    named = np.take_along_axis(there, here.argmax(1)[:, None], axis=1)
    best = there.max(1, keepdims=True)
    return share if math.isfinite(share) else math.inf, int((~(named >= best - TOLERANCE * largest)).sum())
