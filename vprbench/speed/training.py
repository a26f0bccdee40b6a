"""The benchmark of VPRTempo's training: a step of each engine, the fit that users ask for, growth with the places."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import psutil

from vprbench.api.preprocess import Engine
from vprbench.errors import BadInput
from vprbench.progress import listening
from vprbench.speed.measure import Fit, Rates, floor_laps, measured_rates, median, timed_fit, weight_bytes
from vprbench.speed.report import Planned, figures, hertz, megabytes, milliseconds, ratio
from vprbench.speed.settings import ENGINES, RULES, TRAVERSES, Bench

_LITTLE = 8  # places of a fit that only compiles; too few to be judged as diverged
_SHORT = 2.0  # seconds; a shorter fit is repeated
_BYTES = 4  # of a float32


@dataclass(frozen=True)
class TrainingCell:
    """One module trained by both engines, a round of each after the other."""

    rules: str
    places: int
    steps: int
    fits: dict[Engine, list[Fit]]
    floor_bytes: int  # excitation and inhibition of both layers
    floor_seconds: list[float]  # of plain in-place passes over as many

    def row(self) -> dict[str, str]:
        """Return the seconds of a fit and of a step by each engine, beside the floor."""
        steps = {
            engine: median(fit.training_seconds for fit in fits) / self.steps for engine, fits in self.fits.items()
        }
        fits = {engine: fit_seconds(fits) for engine, fits in self.fits.items()}
        floor = median(self.floor_seconds)
        return {
            "rules": self.rules,
            **{f"{engine}: fit s": figures(seconds) for engine, seconds in fits.items()},
            "fit, readable / fused": ratio(fits["readable"], fits["fused"]),
            **{f"{engine}: step ms": milliseconds(seconds) for engine, seconds in steps.items()},
            "step, readable / fused": ratio(steps["readable"], steps["fused"]),
            f"floor ms ({figures(self.floor_bytes / 1e6)} MB)": milliseconds(floor),
            **{f"{engine} / floor": ratio(seconds, floor) for engine, seconds in steps.items()},
        }


@dataclass(frozen=True)
class FitCell:
    """The fit that users ask for."""

    rules: str
    places: int
    epochs: int
    fit: Fit

    def row(self) -> dict[str, str]:
        """Return the seconds of the fit and of its stages, and its memory."""
        stages = {f"{stage} s": figures(seconds) for stage, seconds in self.fit.stages.items()}
        return {"rules": self.rules, "fit s": figures(self.fit.seconds), **stages, **_memory(self.fit)}


@dataclass(frozen=True)
class ScalingCell:
    """Fit and rates at one number of places."""

    rules: str
    places: int
    epochs: int
    fits: list[Fit]
    rates: Rates

    def row(self) -> dict[str, str]:
        """Return the median seconds of the fits, their number and memory, and the rates of queries."""
        return {
            "rules": self.rules,
            "places": f"{self.places:,}",
            "fit s": f"{figures(fit_seconds(self.fits))} ({len(self.fits)})",
            "streaming Hz": hertz(self.rates.streaming.total),
            "offline Hz": f"{hertz(self.rates.offline.total)} (batch {self.rates.offline_batch})",
            **_memory(self.fits[0]),
        }


def fit_seconds(fits: Iterable[Fit]) -> float:
    """Return the median seconds of fits."""
    return median(fit.seconds for fit in fits)


def _memory(fit: Fit) -> dict[str, str]:
    on_device = fit.peak_device_memory_bytes
    return {
        "peak MB": megabytes(fit.peak_memory_bytes),
        "resident before MB": megabytes(fit.memory_before_bytes),
        **({} if on_device is None else {"peak device MB": megabytes(on_device)}),
    }


def training(bench: Bench) -> Iterator[Planned]:
    """Train one module by both engines."""
    for rules in RULES:
        yield {"rules": rules}, partial(_training_cell, bench, rules)


def fits(bench: Bench) -> Iterator[Planned]:
    """Train the networks that users ask for; they are left in `bench.networks`."""
    for rules in RULES:
        yield {"rules": rules}, partial(_fit_cell, bench, rules)


def scaling(bench: Bench) -> Iterator[Planned]:
    """Train and ask networks of growing size."""
    for rules in RULES:
        smaller: list[ScalingCell] = []
        for places in sorted(set(bench.settings.sizes)):
            what = {"rules": rules, "places": f"{places:,}"}
            yield what, partial(_scaling_cell, bench, rules, places, smaller)


def _warm_up(bench: Bench, rules: str, **arguments: Any) -> None:
    """Let an engine compile what it needs for a fit."""
    references, places = bench.route.references(min(_LITTLE, len(bench.route.frames)), TRAVERSES)
    with listening(lambda *_: None):
        bench.vprtempo(rules, int(places.max()) + 1, **{"epochs": 1, **arguments}).fit(references, places)


def _training_cell(bench: Bench, rules: str) -> TrainingCell:
    settings, places = bench.settings, bench.settings.max_module
    references, shown = bench.route.references(places, TRAVERSES)
    for engine in ENGINES:
        _warm_up(bench, rules, engine=engine)
    fits: dict[Engine, list[Fit]] = {engine: [] for engine in ENGINES}
    floor: list[float] = []
    n_bytes = 0
    for turn in range(settings.rounds):
        for engine in ENGINES:
            title = f"training step, {rules}, {engine}, round {turn + 1} of {settings.rounds}"
            network = bench.vprtempo(rules, places, engine=engine, epochs=1)
            fits[engine].append(timed_fit(title, network, references, shown, settings.device))
            n_bytes = 2 * weight_bytes(network, _BYTES)
        floor += floor_laps("pass", n_bytes, settings.device, settings.minimum_seconds / 4)
    return TrainingCell(rules, places, len(shown), fits, n_bytes, floor)


def _fit_cell(bench: Bench, rules: str) -> FitCell:
    settings = bench.settings
    references, places = bench.route.references(settings.places, TRAVERSES)
    _warm_up(bench, rules)
    network = bench.vprtempo(rules, settings.places)
    fit = timed_fit(f"fit, {rules}", network, references, places, settings.device)
    bench.networks[rules] = network
    return FitCell(rules, settings.places, settings.epochs, fit)


def _scaling_cell(bench: Bench, rules: str, places: int, smaller: list[ScalingCell]) -> ScalingCell:
    """Train and ask a network if memory has room for it; its cell is added to those of the `smaller` ones."""
    settings = bench.settings
    if smaller:
        check_memory(places, smaller[-1])
    else:
        _warm_up(bench, rules)
    title = f"growth, {rules}, {places} places"
    references, shown = bench.route.references(places, 1)
    fits: list[Fit] = []
    while len(fits) < (settings.rounds if fits and fits[0].seconds < _SHORT else 1):
        network = bench.vprtempo(rules, places, epochs=settings.scaling_epochs)
        fits.append(timed_fit(title, network, references, shown, settings.device))
    queries, _ = bench.route.queries(places, settings.sample)
    rates = measured_rates(title, network, queries, settings.protocol(), settings.device)
    smaller.append(ScalingCell(rules, places, settings.scaling_epochs, fits, rates))
    return smaller[-1]


def check_memory(places: int, smaller: ScalingCell) -> None:
    """Raise BadInput if a fit would take more memory than is free, going by what a smaller one took."""
    took = smaller.fits[0].peak_memory_bytes - smaller.fits[0].memory_before_bytes
    needed, free = took * places / smaller.places, psutil.virtual_memory().available
    if needed > free:
        raise BadInput(
            f"{smaller.places:,} places took {took / 1e9:.1f} GB, and {free / 1e9:.1f} GB are free: not tried"
        )
