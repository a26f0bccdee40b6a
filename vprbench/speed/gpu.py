"""Whether a GPU gives the networks that the CPU gives, and how fast it is: the check to run where there is one."""

from __future__ import annotations

import math
import os
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Literal
from unittest.mock import patch

import numpy as np
import numpy.typing as npt

from vprbench import progress
from vprbench.api.arrays import Scores
from vprbench.errors import BadInput
from vprbench.runs import machine
from vprbench.runs.stopwatch import Protocol
from vprbench.speed.measure import Make, Rates, measured_rates, timed_fit
from vprbench.speed.report import Planned, Report, measured, publish, rates_text
from vprbench.speed.route import Route
from vprbench.speed.settings import FRAME, RULES, TRAVERSES, NetworkOptions, option, quick

TOLERANCE = 1e-4  # of the largest weight or score
TARGET_FIT_SECONDS = 2.0  # on an H200
TARGET_OFFLINE_HZ = 100_000.0


@dataclass(frozen=True, kw_only=True)
class Settings(NetworkOptions):
    """What to compare and to time; raises BadInput if nothing would be."""

    check_places: int = option(200, 12)
    batch_sizes: list[int] = option([1, 128, 1024, 8192], [1, 4])
    minimum_seconds: float = option(2.0, 0.0, least=None)  # of each rate
    device: str = "cuda"


QUICK = quick(Settings)


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

    def row(self) -> dict[str, str]:
        """Return the difference, and whether it holds."""
        return {
            "rules": self.rules,
            "compared": self.what,
            "difference": f"{self.difference:.1e} of the largest {self.of}",
            "other best places": f"{self.other_places} of {self.queries}",
            "result": "same" if self.holds else "FAILED",
        }


@dataclass(frozen=True)
class Timed:
    """The times of one rule set on the GPU."""

    rules: str
    first_fit_seconds: float  # what Triton compiles included
    second_fit_seconds: float
    rates: Rates

    def row(self) -> dict[str, str]:
        """Return the seconds of both fits, the second beside the target."""
        return {
            "rules": self.rules,
            "first fit s": f"{self.first_fit_seconds:.2f}",
            "second fit s": f"{self.second_fit_seconds:.2f}",
            "target s": f"{TARGET_FIT_SECONDS:g}, {_met(self.second_fit_seconds <= TARGET_FIT_SECONDS)} by the second",
        }

    def query_rows(self) -> Iterator[dict[str, str]]:
        """Yield the rates of single queries, then those of each batch size beside the target."""
        rates, note = "Hz enc/match/total", "" if self.rates.valid else " INVALID"
        yield {"rules": self.rules, "scenario": "streaming", rates: rates_text(self.rates.streaming) + note}
        for laps in self.rates.offline_laps:
            offline = laps.rates()
            yield {
                "rules": self.rules,
                "scenario": f"offline, batch {laps.images_per_call:,}",
                rates: rates_text(offline) + note,
                "target Hz": f"{TARGET_OFFLINE_HZ:,.0f}, {_met(offline.total >= TARGET_OFFLINE_HZ)}",
            }


def _met(reached: bool) -> str:
    return "met" if reached else "missed"


class Check(Report):
    """Everything that one check found."""

    @property
    def correct(self) -> bool:
        """Whether all comparisons were made and hold, and nothing ended with an error."""
        return not self.failures and all(each.holds for each in self.sections["comparison"])


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


def measure(settings: Settings, make: Make) -> Check:
    """Time the GPU, then compare it with the CPU."""
    surroundings = machine.capture(settings.device, settings.threads or len(machine.cores()))
    route = Route.drawn(max(settings.check_places, settings.places), *FRAME, settings.seed)
    # Triton begins with an empty cache, and is timed before anything else makes it compile.
    with tempfile.TemporaryDirectory() as empty, patch.dict(os.environ, TRITON_CACHE_DIR=empty):
        sections = {}
        for name, check in (("timing", _timed), ("comparison", compared)):
            planned: list[Planned] = [({"rules": each}, partial(check, settings, make, route, each)) for each in RULES]
            sections[name] = list(measured(name, planned))
    return Check(settings, surroundings, sections)


def write(report: Check, results: Path) -> None:
    """Print the report as Markdown, and leave it in gpu.md of the folder `results`."""
    publish(results, {"gpu.md": to_text(report)})


def to_text(report: Check) -> str:
    """Return a report as Markdown."""
    timed = report.sections["timing"]
    rows = [row for each in timed for row in (each.query_rows() if isinstance(each, Timed) else [each.row()])]
    try:
        triton = version("triton")
    except PackageNotFoundError:
        triton = "missing"
    return report.told("gpu.md.j2", queries=rows, triton=triton, **{"TOLERANCE": TOLERANCE, "TRAVERSES": TRAVERSES})


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
    gpu = networks["GPU, fused"]
    together, found = gpu.query(queries), []
    for other in ("CPU, fused", "GPU, readable"):
        here, there = gpu.state(), networks[other].state()
        difference = max(_apart(here[name], there[name]) for name in there)
        _, other_places = _scores_apart(together, networks[other].query(queries))
        title = f"GPU, fused against {other}"
        found.append(Comparison(rules, title, "weight", difference, other_places, len(queries)))
    one_by_one = np.concatenate([gpu.query(queries[i : i + 1]) for i in range(len(queries))])
    title = "GPU, fused: a batch against single queries"
    return [*found, Comparison(rules, title, "score", *_scores_apart(together, one_by_one), len(queries))]


def _apart(here: npt.NDArray[Any], there: npt.NDArray[Any]) -> float:
    """Return the largest difference as a share of the largest number, infinite if the share is no number."""
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
    seconds = {}
    for number in ("first", "second"):
        network = make("vprtempo", settings.device, engine="fused", **settings.vprtempo(rules, settings.places))
        fit = timed_fit(f"{rules}, {number} fit", network, references, places, settings.device)
        seconds[f"{number}_fit_seconds"] = fit.seconds
    queries, _ = route.queries(settings.places, max(settings.batch_sizes))
    protocol = Protocol(
        minimum_seconds=settings.minimum_seconds,
        maximum_seconds=max(30.0, settings.minimum_seconds),
        sample=len(queries),
        batch_sizes=settings.batch_sizes,
    )
    rates = measured_rates(f"{rules}: queries", network, queries, protocol, settings.device)
    return Timed(rules, rates=rates, **seconds)
