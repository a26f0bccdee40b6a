"""The arguments of VPRSNN: every constant with its unit in its name and the published value as default."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, fields
from typing import Any, Literal

import numpy as np

from vprbench.api import BadInput

from ..parts.filters.patches import Variant

# More than 0, as all time constants
_POSITIVE = {"places_per_module", "n_excitatory", "epochs", "recorded_presentations", "levels_per_hz"}
_POSITIVE |= {"time_step_ms", "presentation_ms", "weight_sum", "weight_max"}
# 0 or more, as all durations
_NOT_NEGATIVE = {"weight_scale", "weight_offset", "excitatory_to_inhibitory_weight", "inhibitory_to_excitatory_weight"}
_CHOICES = {
    "module_order": ("contiguous", "shuffled"),
    "assignment": ("standard", "weighted"),
    "delays_at_query": ("new", "trained"),
}


@dataclass
class Arguments:
    """What VPRSNN is constructed with; the values of VPRSNN's public code (QVPR/VPRSNN)."""

    preprocessing: Variant = "A"
    height: int = 28  # pixels
    width: int = 28
    patch: int = 7
    places_per_module: int = 25
    module_order: Literal["contiguous", "shuffled"] = "contiguous"
    calibration_places: int = 0  # set aside before the rest were shuffled
    n_excitatory: int = 400  # neurons a module, and as many inhibitory ones
    epochs: int = 30
    recorded_presentations: int = 250  # the last ones of the training, by which neurons are assigned
    assignment: Literal["standard", "weighted"] = "standard"
    probabilities: bool = False  # scores of a query less their lowest, as parts of their sum
    hyperactive_threshold: int | None = None  # references
    hyperactive_candidates: list[int] = field(default_factory=lambda: [0, 5, 10, 20, *range(40, 301, 20)])
    fast: bool = False
    carried_potentials: bool = False
    delays_at_query: Literal["new", "trained"] = "new"
    published_weights: str | None = None  # folder
    levels_per_hz: float = 4.0
    time_step_ms: float = 0.1
    first_rest_ms: float = 500.0
    presentation_ms: float = 350.0
    rest_ms: float = 150.0
    input_delay_max_ms: float = 10.0
    weight_scale: float = 0.3
    weight_offset: float = 0.01
    weight_sum: float = 78.0
    weight_max: float = 1.0
    excitatory_start_mv: float = -105.0
    excitatory_rest_mv: float = -65.0
    excitatory_reset_mv: float = -65.0
    excitatory_threshold_mv: float = -72.0  # without theta
    excitatory_tau_ms: float = 100.0
    excitatory_refractory_ms: float = 5.0
    excitatory_minimum_interval_ms: float = 50.0
    theta_start_mv: float = 20.0
    theta_plus_mv: float = 0.05
    theta_tau_ms: float = 1e7
    inhibitory_start_mv: float = -100.0
    inhibitory_rest_mv: float = -60.0
    inhibitory_reset_mv: float = -45.0
    inhibitory_threshold_mv: float = -40.0
    inhibitory_tau_ms: float = 10.0
    inhibitory_refractory_ms: float = 2.0
    excitation_reversal_mv: float = 0.0
    excitatory_inhibition_reversal_mv: float = -100.0  # nothing inhibits inhibitory neurons
    excitation_tau_ms: float = 1.0
    inhibition_tau_ms: float = 0.5
    excitatory_to_inhibitory_weight: float = 10.4
    inhibitory_to_excitatory_weight: float = 17.0
    pre_trace_tau_ms: float = 20.0
    post_trace_tau_ms: float = 20.0
    slow_post_trace_tau_ms: float = 40.0
    pre_rate: float = 1e-4  # added: VPRSNN's port has a plus where Diehl and Cook subtract
    post_rate: float = 0.01
    seed: int = 0

    def given(self) -> dict[str, Any]:
        """Return the arguments by name."""
        return {each.name: getattr(self, each.name) for each in fields(self) if each.init}

    def check(self) -> None:
        """Raise BadInput for arguments under which there is no network."""
        for complaints in (self._wrong_by_itself(), self._wrong_beside_others()):
            for name, advice in complaints:
                raise BadInput(f"method.{name}={getattr(self, name)}: {advice}")

    def _wrong_by_itself(self) -> Iterator[tuple[str, str]]:
        """Yield each argument whose value no network has, and what to give."""
        for name, value in self.given().items():
            is_time_constant = name.endswith("_tau_ms")
            if isinstance(value, float) and not math.isfinite(value):
                yield name, "give a finite number"
            elif (name in _POSITIVE or is_time_constant) and value <= 0:
                yield name, "give more than 0"
            elif (name in _NOT_NEGATIVE or name.endswith("_ms")) and value < 0:
                yield name, "give 0 or more"
            elif is_time_constant and value <= self.time_step_ms:
                step = f"method.time_step_ms={self.time_step_ms}"
                yield name, f"a time constant has to be longer than {step}, or the steps of Euler's method run away"
            elif name in _CHOICES and value not in _CHOICES[name]:
                yield name, f"there are {', '.join(map(str, _CHOICES[name]))}"
        if not 0 <= self.seed < 2**32:
            yield "seed", f"give 0 to {2**32 - 1}"
        if self.hyperactive_threshold is not None and self.hyperactive_threshold < 0:
            yield "hyperactive_threshold", "give 0 references or more"
        if not self.hyperactive_candidates or min(self.hyperactive_candidates) < 0:
            yield "hyperactive_candidates", "give at least one, 0 or more each"

    def _wrong_beside_others(self) -> Iterator[tuple[str, str]]:
        """Yield each argument that another one bounds and that is beyond its bound, and what to give."""
        step, most_steps = f"method.time_step_ms={self.time_step_ms}", np.iinfo(np.int16).max
        if self.levels_per_hz * 1000 <= 255 * self.time_step_ms:
            yield "levels_per_hz", f"a level of 255 would fire in every step of {step}: give more"
        if self.input_delay_max_ms > self.rest_ms:
            rest = f"method.rest_ms={self.rest_ms}"
            yield "input_delay_max_ms", f"spikes would still be under way after {rest}: give at most that"
        if self.input_delay_max_ms > most_steps * self.time_step_ms:
            yield "input_delay_max_ms", f"give at most {most_steps} steps of {step}"
        if self.first_rest_ms < self.excitatory_minimum_interval_ms:
            interval = f"method.excitatory_minimum_interval_ms={self.excitatory_minimum_interval_ms}"
            yield "first_rest_ms", f"neurons are not ready to fire before {interval}: give at least that"
        if self.presentation_ms < self.time_step_ms:
            yield "presentation_ms", f"give at least {step}"
        if self.theta_start_mv + self.excitatory_threshold_mv <= self.excitatory_rest_mv:
            threshold = f"method.excitatory_threshold_mv={self.excitatory_threshold_mv}"
            rest = f"rest, {self.excitatory_rest_mv} mV"
            yield "theta_start_mv", f"with {threshold} neurons would fire at {rest}: give more"
        if self.inhibitory_threshold_mv <= self.inhibitory_rest_mv:
            rest = f"rest, {self.inhibitory_rest_mv} mV"
            yield "inhibitory_threshold_mv", f"inhibitory neurons would fire at {rest}: give more"
        if self.calibration_places < 0 or (self.calibration_places and self.module_order == "contiguous"):
            meaning = "it tells how many places were set aside before the others were shuffled"
            yield "calibration_places", f"{meaning}; give 0, or more with method.module_order=shuffled"
