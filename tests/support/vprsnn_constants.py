"""The published constants of VPRSNN's neurons and synapses (QVPR/VPRSNN), as tests want them."""

from types import SimpleNamespace


def constants(**changes: float) -> SimpleNamespace:
    """Return the published values, some of them changed."""
    published = {
        "time_step_ms": 0.1,
        "presentation_ms": 350.0,
        "rest_ms": 150.0,
        "excitatory_rest_mv": -65.0,
        "excitatory_reset_mv": -65.0,
        "excitatory_tau_ms": 100.0,
        "excitatory_refractory_ms": 5.0,
        "excitatory_threshold_mv": -72.0,  # theta - 20 - 52
        "excitatory_minimum_interval_ms": 50.0,
        "theta_start_mv": 20.0,
        "theta_plus_mv": 0.05,
        "theta_tau_ms": 1e7,
        "inhibitory_rest_mv": -60.0,
        "inhibitory_reset_mv": -45.0,
        "inhibitory_tau_ms": 10.0,
        "inhibitory_refractory_ms": 2.0,
        "inhibitory_threshold_mv": -40.0,
        "excitation_reversal_mv": 0.0,
        "excitatory_inhibition_reversal_mv": -100.0,
        "excitation_tau_ms": 1.0,
        "inhibition_tau_ms": 0.5,
        "excitatory_to_inhibitory_weight": 10.4,
        "inhibitory_to_excitatory_weight": 17.0,
        "pre_trace_tau_ms": 20.0,
        "post_trace_tau_ms": 20.0,
        "slow_post_trace_tau_ms": 40.0,
        "pre_rate": 1e-4,
        "post_rate": 0.01,
        "weight_max": 1.0,
    }
    if unknown := set(changes) - set(published):
        raise KeyError(f"no constant of VPRSNN: {sorted(unknown)}")
    return SimpleNamespace(**{**published, **changes})
