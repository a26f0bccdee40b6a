"""The benchmark of VPRTempo's training: a step of each engine, the fit that users ask for, growth with the places."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any

import psutil

from vprbench.api.preprocess import Engine
from vprbench.errors import BadInput
from vprbench.progress import listening
from vprbench.speed.cells import Failed, FitCell, ScalingCell, TrainingCell, attempt
from vprbench.speed.measure import Fit, floor_laps, measured_rates, timed_fit, weight_bytes
from vprbench.speed.settings import ENGINES, RULES, TRAVERSES, Bench

_LITTLE = 8  # places of a fit that only compiles; too few to be judged as diverged
_SHORT = 2.0  # seconds; a shorter fit is repeated
_BYTES = 4  # of a float32


def training(bench: Bench) -> Iterator[TrainingCell | Failed]:
    """Train one module by both engines."""
    for rules in RULES:
        yield attempt({"rules": rules}, partial(_training_cell, bench, rules))


def fits(bench: Bench) -> Iterator[FitCell | Failed]:
    """Train the networks that users ask for; they are left in `bench.networks`."""
    for rules in RULES:
        yield attempt({"rules": rules}, partial(_fit_cell, bench, rules))


def scaling(bench: Bench) -> Iterator[ScalingCell | Failed]:
    """Train and ask networks of growing size."""
    for rules in RULES:
        smaller: ScalingCell | None = None
        for places in sorted(set(bench.settings.sizes)):
            what = {"rules": rules, "places": f"{places:,}"}
            cell = attempt(what, partial(_scaling_cell, bench, rules, places, smaller))
            if isinstance(cell, ScalingCell):
                smaller = cell
            yield cell


def _warm_up(bench: Bench, rules: str, **arguments: Any) -> None:
    """Let an engine compile what it needs for a fit."""
    references, places = bench.route.references(min(_LITTLE, len(bench.route.frames)), TRAVERSES)
    with listening(lambda *_: None):
        bench.vprtempo(rules, int(places.max()) + 1, epochs=1, **arguments).fit(references, places)


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
    network = bench.vprtempo(rules, settings.places, epochs=settings.epochs)
    fit = timed_fit(f"fit, {rules}", network, references, places, settings.device)
    bench.networks[rules] = network
    return FitCell(rules, settings.places, settings.epochs, fit)


def _scaling_cell(bench: Bench, rules: str, places: int, smaller: ScalingCell | None) -> ScalingCell:
    settings = bench.settings
    if smaller is None:
        _warm_up(bench, rules)
    else:
        check_memory(places, smaller)
    title = f"growth, {rules}, {places} places"
    references, shown = bench.route.references(places, 1)
    fits: list[Fit] = []
    while len(fits) < (settings.rounds if fits and fits[0].seconds < _SHORT else 1):
        network = bench.vprtempo(rules, places, epochs=settings.scaling_epochs)
        fits.append(timed_fit(title, network, references, shown, settings.device))
    queries, _ = bench.route.queries(places, settings.sample)
    rates = measured_rates(title, network, queries, settings.protocol(), settings.device)
    return ScalingCell(rules, places, settings.scaling_epochs, fits, rates)


def check_memory(places: int, smaller: ScalingCell) -> None:
    """Raise BadInput if a fit would take more memory than is free, going by what a smaller one took."""
    took = smaller.fits[0].peak_memory_bytes - smaller.fits[0].memory_before_bytes
    needed, free = took * places / smaller.places, psutil.virtual_memory().available
    if needed > free:
        raise BadInput(
            f"{smaller.places:,} places took {took / 1e9:.1f} GB, and {free / 1e9:.1f} GB are free: not tried"
        )
