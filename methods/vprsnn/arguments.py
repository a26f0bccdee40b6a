"""The arguments of VPRSNN: every constant with its unit in its name and the published value as default."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from typing import Any, Literal

import numpy as np

from vprbench.api import BadInput, Variant

Engine = Literal["compiled", "batched"]

_POSITIVE = (
    "places_per_module",
    "n_excitatory",
    "epochs",
    "recorded_presentations",
    "levels_per_hz",
    "time_step_ms",
    "presentation_ms",
    "weight_sum",
    "weight_max",
)


_CHOICES = {
    "module_order": ("contiguous", "shuffled"),
    "assignment": ("standard", "weighted"),
    "delays_at_query": ("new", "trained"),
    "engine": (None, "compiled", "batched"),
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
    engine: Engine | None = None
    seed: int = 0
    device: str = "cpu"

    def given(self) -> dict[str, Any]:
        """Return the arguments by name."""
        return {each.name: getattr(self, each.name) for each in fields(self) if each.init}

    def check(self) -> None:
        """Raise BadInput for arguments under which there is no network."""
        for name, value in self.given().items():
            if isinstance(value, float) and not math.isfinite(value):
                raise BadInput(f"method.{name}={value}: give a finite number")
        positive = [*_POSITIVE, *(name for name in self.given() if name.endswith("_tau_ms"))]
        for name in positive:
            if getattr(self, name) <= 0:
                raise BadInput(f"method.{name}={getattr(self, name)}: give more than 0")
        for name, value in self.given().items():
            if name.endswith("_ms") and name not in positive and value < 0:
                raise BadInput(f"method.{name}={value}: give 0 or more")
            if name.endswith("_tau_ms") and value <= self.time_step_ms:
                raise BadInput(
                    f"method.{name}={value}: a time constant has to be longer than method.time_step_ms="
                    f"{self.time_step_ms}, or the steps of Euler's method run away"
                )
        if self.levels_per_hz * 1000 <= 255 * self.time_step_ms:
            raise BadInput(
                f"method.levels_per_hz={self.levels_per_hz}: a level of 255 would fire in every step of "
                f"method.time_step_ms={self.time_step_ms}: give more"
            )
        if self.input_delay_max_ms > self.rest_ms:
            raise BadInput(
                f"method.input_delay_max_ms={self.input_delay_max_ms}: spikes would still be under way after "
                f"method.rest_ms={self.rest_ms}: give at most that"
            )
        if self.first_rest_ms < self.excitatory_minimum_interval_ms:
            raise BadInput(
                f"method.first_rest_ms={self.first_rest_ms}: neurons are not ready to fire before "
                f"method.excitatory_minimum_interval_ms={self.excitatory_minimum_interval_ms}: give at least that"
            )
        most_steps = np.iinfo(np.int16).max
        if self.input_delay_max_ms > most_steps * self.time_step_ms:
            raise BadInput(
                f"method.input_delay_max_ms={self.input_delay_max_ms}: give at most {most_steps} steps of "
                f"method.time_step_ms={self.time_step_ms}"
            )
        if self.presentation_ms < self.time_step_ms:
            raise BadInput(
                f"method.presentation_ms={self.presentation_ms}: give at least method.time_step_ms={self.time_step_ms}"
            )
        for name in (
            "weight_scale",
            "weight_offset",
            "excitatory_to_inhibitory_weight",
            "inhibitory_to_excitatory_weight",
        ):
            if getattr(self, name) < 0:
                raise BadInput(f"method.{name}={getattr(self, name)}: give 0 or more")
        for name, options in _CHOICES.items():
            if getattr(self, name) not in options:
                raise BadInput(f"method.{name}={getattr(self, name)}: there are {', '.join(map(str, options))}")
        if not 0 <= self.seed < 2**32:
            raise BadInput(f"method.seed={self.seed}: give 0 to {2**32 - 1}")
        if self.theta_start_mv + self.excitatory_threshold_mv <= self.excitatory_rest_mv:
            raise BadInput(
                f"method.theta_start_mv={self.theta_start_mv}: with method.excitatory_threshold_mv="
                f"{self.excitatory_threshold_mv} neurons would fire at rest, {self.excitatory_rest_mv} mV: give more"
            )
        if self.inhibitory_threshold_mv <= self.inhibitory_rest_mv:
            raise BadInput(
                f"method.inhibitory_threshold_mv={self.inhibitory_threshold_mv}: inhibitory neurons would fire at "
                f"rest, {self.inhibitory_rest_mv} mV: give more"
            )
        if self.calibration_places < 0 or (self.calibration_places and self.module_order == "contiguous"):
            raise BadInput(
                f"method.calibration_places={self.calibration_places}: it tells how many places were set aside before "
                "the others were shuffled; give 0, or more with method.module_order=shuffled"
            )
        if self.hyperactive_threshold is not None and self.hyperactive_threshold < 0:
            raise BadInput(f"method.hyperactive_threshold={self.hyperactive_threshold}: give 0 references or more")
        if not self.hyperactive_candidates or min(self.hyperactive_candidates) < 0:
            raise BadInput(
                f"method.hyperactive_candidates={[*self.hyperactive_candidates]}: give at least one, 0 or more each"
            )
