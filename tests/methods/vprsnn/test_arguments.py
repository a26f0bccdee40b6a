"""Each of VPRSNN's arguments changes what is learnt; defaults and refusals are those of test_maps."""

import numpy as np
import pytest
from little_vprsnn import fitted

OTHERS = {  # than the published numbers, and each changes what is learnt
    **{"preprocessing": "C", "patch": 5, "places_per_module": 4, "n_excitatory": 23, "epochs": 5, "levels_per_hz": 5.0},
    **{"time_step_ms": 0.2, "first_rest_ms": 50.0, "presentation_ms": 300.0, "rest_ms": 100.0},
    "input_delay_max_ms": 5.0,
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
