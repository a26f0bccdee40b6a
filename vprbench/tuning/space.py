"""The settings that a search tries: the parameters of conf/search.yaml, drawn at random or on a grid."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
import yaml

from vprbench.plugins import registry

Values = Mapping[str, float]  # of every parameter, by the name of the method's argument

_DIGITS = 3  # significant ones, so that a person can type a setting
_STEPS = 6  # of the grid to either side, at most: 28,560 points


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

    def draw(self, generator: np.random.Generator) -> float:
        """Return a random value of its range."""
        if self.log:
            return float(np.exp(generator.uniform(np.log(self.low), np.log(self.high))))
        return float(generator.uniform(self.low, self.high))


_DECLARED = yaml.safe_load((registry.find_conf_folders()["vprbench"] / "search.yaml").read_text(encoding="utf-8"))

METHOD: str = _DECLARED["method"]
TITLE: str = _DECLARED["title"]  # of the method
SCATTERING: tuple[str, ...] = tuple(_DECLARED["scattering_protocols"])
PARAMETERS = tuple(Parameter(name, **values) for name, values in _DECLARED["parameters"].items())
PAPER: Values = {parameter.name: parameter.paper for parameter in PARAMETERS}


def draw_settings(seed: int) -> Iterator[Values]:
    """Yield settings at random, without end; the same ones for the same seed."""
    generator = np.random.default_rng(seed)
    while True:
        values = {each.name: _round(each.draw(generator)) for each in PARAMETERS}
        if _is_possible(values):
            yield values


def list_grid(best: Values) -> Iterator[Values]:
    """Yield the points of a grid around settings, nearest first: those that differ in one parameter, in two, ..."""
    stepped = {each.name: each for each in PARAMETERS if each.step is not None}
    steps = itertools.product(range(-_STEPS, _STEPS + 1), repeat=len(stepped))
    _, *others = sorted(steps, key=lambda taken: (max(map(abs, taken)), sum(map(bool, taken)), sum(map(abs, taken))))
    for taken in others:
        moved = {
            name: _round(best[name] + n * (stepped[name].step or 0)) for name, n in zip(stepped, taken, strict=True)
        }
        values = {**best, **moved}
        if _is_possible(values) and all(each.low <= values[name] <= each.high for name, each in stepped.items()):
            yield values


def _is_possible(values: Values) -> bool:
    smaller, larger = _DECLARED["ordered"]
    return values[smaller] <= values[larger]


def _round(value: float) -> float:
    return float(f"{value:.{_DIGITS}g}")
