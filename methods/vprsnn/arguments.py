"""The arguments of VPRSNN: every constant with its unit in its name and the published value as default."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from typing import Any, Literal

from vprbench.api import BadInput

from ..parts.filters.patches import Variant

_POSITIVE = (
    *("places_per_module", "n_excitatory", "epochs", "recorded_presentations", "weight_sum", "weight_max"),
    *("time_step_ms", "presentation_ms"),
)
_NOT_NEGATIVE = (
    *("weight_scale", "weight_offset", "excitatory_to_inhibitory_weight", "inhibitory_to_excitatory_weight"),
    *("first_rest_ms", "rest_ms", "excitatory_refractory_ms", "inhibitory_refractory_ms"),
    "excitatory_minimum_interval_ms",
)


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

    def list_arguments(self) -> dict[str, Any]:
        """Return the arguments by name."""
        return {each.name: getattr(self, each.name) for each in fields(self) if each.init}

    def check(self) -> None:
        """Raise BadInput for arguments under which there is no network."""
        step, given = self.time_step_ms, self.list_arguments()
        wanted: dict[str, tuple[bool, str]] = {
            **{
                name: (math.isfinite(value), "a finite number") for name, value in given.items() if type(value) is float
            },
            **{name: (0 < given[name] < math.inf, "more than 0") for name in _POSITIVE},
            **{name: (0 <= given[name] < math.inf, "0 or more") for name in _NOT_NEGATIVE},
            **{
                name: (step < value < math.inf, f"more than method.time_step_ms={step}, or Euler's steps run away")
                for name, value in given.items()
                if name.endswith("_tau_ms")
            },
            "levels_per_hz": (
                0.255 * step < self.levels_per_hz < math.inf,
                f"more than {0.255 * step:g}, or a level of 255 fires in every step of method.time_step_ms={step}",
            ),
            "input_delay_max_ms": (
                0 <= self.input_delay_max_ms <= self.rest_ms,
                f"0 to method.rest_ms={self.rest_ms}, after which no spike is under way",
            ),
            "calibration_places": (
                self.calibration_places == 0 or (self.calibration_places > 0 and self.module_order == "shuffled"),
                "0, or with method.module_order=shuffled how many places were set aside before that",
            ),
            "hyperactive_threshold": ((self.hyperactive_threshold or 0) >= 0, "0 references or more"),
            "hyperactive_candidates": (
                min(self.hyperactive_candidates, default=-1) >= 0,
                "at least one, 0 or more each",
            ),
            "seed": (0 <= self.seed < 2**32, f"0 to {2**32 - 1}"),
        }
        for name, (fits, demand) in wanted.items():
            if not fits:
                raise BadInput(f"method.{name}={given[name]}: give {demand}")
