"""The settings that a search tries: the parameters of conf/search.yaml, drawn at random or on a grid."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import optuna
import yaml
from optuna.distributions import BaseDistribution, FloatDistribution

from vprbench.plugins import registry

optuna.logging.set_verbosity(optuna.logging.ERROR)  # or it logs every trial

Values = Mapping[str, float]  # of every parameter, by the name of the method's argument

_DIGITS = 3  # significant ones, so that a person can type a setting
_RINGS = 6  # steps of the grid to either side, at most: 28,560 points


@dataclass(frozen=True)
class Parameter:
    """An argument of the method: its value in the paper and the range that is searched."""

    name: str  # of the argument
    symbol: str
    paper: float
    low: float
    high: float
    log: bool = False
    step: float | None = None  # of the grid; None: stays at the best random value


_DECLARED = yaml.safe_load((registry.find_conf_folders()["vprbench"] / "search.yaml").read_text(encoding="utf-8"))

METHOD: str = _DECLARED["method"]
TITLE: str = _DECLARED["title"]  # of the method
SCATTERING: tuple[str, ...] = tuple(_DECLARED["scattering_protocols"])
PARAMETERS = tuple(Parameter(name, **values) for name, values in _DECLARED["parameters"].items())
PAPER: Values = {parameter.name: parameter.paper for parameter in PARAMETERS}


def draw_settings(count: int, seed: int) -> list[Values]:
    """Draw settings at random; a larger count of the same seed begins with the same ones."""
    study = optuna.create_study(sampler=optuna.samplers.RandomSampler(seed))
    ranges: dict[str, BaseDistribution] = {
        each.name: FloatDistribution(each.low, each.high, log=each.log) for each in PARAMETERS
    }
    settings: list[Values] = []
    while len(settings) < count:
        values = {name: _round(value) for name, value in study.ask(ranges).params.items()}
        if _is_possible(values):
            settings.append(values)
    return settings


def list_grid(best: Values) -> Iterator[Values]:
    """Yield the points of a grid around settings, nearest first: those that differ in one parameter, in two, ..."""
    stepped = [each for each in PARAMETERS if each.step is not None]
    for ring in range(1, _RINGS + 1):
        steps = itertools.product(range(-ring, ring + 1), repeat=len(stepped))
        outer = [taken for taken in steps if max(map(abs, taken)) == ring]
        for taken in sorted(outer, key=lambda taken: (sum(map(bool, taken)), sum(map(abs, taken)), taken)):
            moved = {
                each.name: _round(best[each.name] + n * (each.step or 0))
                for each, n in zip(stepped, taken, strict=True)
            }
            values = {**best, **moved}
            if _is_possible(values) and all(each.low <= values[each.name] <= each.high for each in stepped):
                yield values


def _is_possible(values: Values) -> bool:
    smaller, larger = _DECLARED["ordered"]
    return values[smaller] <= values[larger]


def _round(value: float) -> float:
    return float(f"{value:.{_DIGITS}g}")
