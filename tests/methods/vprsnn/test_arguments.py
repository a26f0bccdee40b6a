"""VPRSNN's arguments: the defaults of its yaml, what each of them changes, and which are refused."""

import re

import numpy as np
import pytest
from little_vprsnn import fitted

from vprbench.errors import BadInput
from vprbench.methods.vprsnn.ensemble import VPRSNNEnsemble
from vprbench.methods.vprsnn.method import VPRSNN
from vprbench.plugins.entries import find_entries


@pytest.mark.parametrize(
    ("name", "kind", "differs"),
    [("vprsnn", VPRSNN, {}), ("vprsnn_fast", VPRSNN, {"fast": True}), ("vprsnn_ensemble", VPRSNNEnsemble, {})],
)
def test_a_configuration_has_the_defaults_of_its_class(name, kind, differs):
    configured = find_entries("method")[name].values()
    assert configured.pop("_target_") == f"{kind.__module__}.{kind.__name__}"
    assert configured.pop("tags") == ["spiking"]
    assert configured == {**kind().list_arguments(), **differs, "seed": "${seed}"}


REFUSED = [
    *({name: 0} for name in ("places_per_module", "n_excitatory", "recorded_presentations", "height")),
    *({name: 0.0} for name in ("levels_per_hz", "time_step_ms", "presentation_ms", "weight_max", "excitatory_tau_ms")),
    *({name: -1.0} for name in ("rest_ms", "inhibitory_to_excitatory_weight", "input_delay_max_ms")),
    *({name: np.nan} for name in ("theta_start_mv", "weight_offset")),
    {"weight_scale": np.inf},
    {"inhibition_tau_ms": 0.1},  # no longer than a step
    {"input_delay_max_ms": 151.0},  # longer than the rest
    {"levels_per_hz": 0.0255},  # a white pixel in every step
    {"recorded_presentations": 9},  # fewer than a module has images
    {"patch": 4},
    *({"calibration_places": value} for value in (-1, 1)),  # without an order that is shuffled
    {"hyperactive_threshold": -1},
    *({"hyperactive_candidates": value} for value in ([], [0, -5])),
    {"published_weights": "no such folder"},
    *({"seed": value} for value in (-1, 2**32)),
]


@pytest.mark.parametrize("change", REFUSED, ids=str)
def test_an_argument_without_a_network_is_refused_by_name(change):
    ((name, value),) = change.items()
    with pytest.raises(BadInput, match=rf"^method\.{name}={re.escape(str(value))}"):
        fitted(**change)


OTHERS = {  # than the published numbers, and each changes what is learnt
    **{"preprocessing": "C", "patch": 5, "places_per_module": 4, "n_excitatory": 23, "epochs": 5, "levels_per_hz": 5.0},
    **{
        "time_step_ms": 0.2,
        "first_rest_ms": 50.0,
        "presentation_ms": 300.0,
        "rest_ms": 100.0,
        "input_delay_max_ms": 5.0,
    },
    **{"weight_scale": 0.2, "weight_offset": 0.1, "weight_sum": 60.0, "weight_max": 0.7, "theta_start_mv": 22.0},
    **{"excitatory_rest_mv": -66.0, "excitatory_reset_mv": -64.0, "excitatory_threshold_mv": -70.0},
    **{"excitatory_tau_ms": 80.0, "excitatory_refractory_ms": 6.0, "excitatory_minimum_interval_ms": 40.0},
    **{"theta_plus_mv": 0.1, "theta_tau_ms": 1e5, "inhibitory_rest_mv": -70.0, "inhibitory_threshold_mv": -30.0},
    **{"inhibitory_tau_ms": 8.0, "excitation_reversal_mv": 5.0, "excitatory_inhibition_reversal_mv": -110.0},
    **{"excitation_tau_ms": 1.2, "inhibition_tau_ms": 0.8, "excitatory_to_inhibitory_weight": 8.0},
    **{"inhibitory_to_excitatory_weight": 12.0, "pre_trace_tau_ms": 30.0, "post_trace_tau_ms": 30.0},
    **{"slow_post_trace_tau_ms": 60.0, "pre_rate": 2e-4, "post_rate": 0.02, "fast": True, "seed": 1},
}
PAIRS = [
    {"excitatory_start_mv": -95.0, "first_rest_ms": 50.0},
    {"inhibitory_refractory_ms": 0.0, "excitatory_to_inhibitory_weight": 30.0},
]


@pytest.fixture(scope="module")
def usual_weights():
    return fitted(epochs=2).state()["weights"]


@pytest.mark.parametrize("change", [*({name: value} for name, value in OTHERS.items()), *PAIRS], ids=str)
def test_every_argument_of_the_training_changes_what_is_learnt(change, usual_weights):
    one, other = usual_weights, fitted(**{"epochs": 2, **change}).state()["weights"]
    assert one.shape != other.shape or not np.array_equal(one, other)
