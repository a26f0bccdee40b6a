"""The compiled simulation of VPRSNN equals the direct one, in spikes exactly; and what a presentation counts."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pytest
from direct_vprsnn import simulate

from vprbench.methods.vprsnn.arguments import Arguments
from vprbench.methods.vprsnn.arrays import Synapses, Train, pack_neurons, unpack_neurons
from vprbench.methods.vprsnn.model import Model, Module
from vprbench.methods.vprsnn.simulation import normalise_weights

NEVER = -(1 << 60)  # the step of a spike that has not come
BRIEF = {"presentation_ms": 150.0, "rest_ms": 30.0}

Floats = npt.NDArray[np.float64]
Spikes = npt.NDArray[np.bool_]  # (n_steps, n_inputs)


def silence(n_steps, n_inputs):
    return np.zeros((n_steps, n_inputs), np.bool_)


@dataclass(frozen=True)
class Given:
    """A module and what it is shown."""

    weights: Floats  # (n_inputs, n_neurons)
    delays: npt.NDArray[np.int64]  # (n_inputs, n_neurons) steps
    images: list[Spikes]
    values: Arguments
    theta: float | Floats = 20.0

    @classmethod
    def drawn(cls, seed, n_neurons=12, n_inputs=40, longest=100, share=0.0125, n_images=4, **changes):
        """Draw weights, delays and images, whose inputs spike in up to twice `share` of the steps."""
        random = np.random.default_rng(seed)
        values = Arguments(**{**BRIEF, **changes})
        n_steps = round(values.presentation_ms / values.time_step_ms)
        return cls(
            0.8 * random.random((n_inputs, n_neurons)),
            random.integers(0, longest + 1, (n_inputs, n_neurons)),
            [random.random((n_steps, n_inputs)) < 2 * share * random.random(n_inputs) for _ in range(n_images)],
            values,
        )


def agreed(given, learning=True, weight_sum=None):
    """Show the images to both simulations, insist that they agree, and return the direct one's run."""
    n_inputs, n = given.weights.shape
    theta = np.zeros(n) + given.theta
    delay = float(given.delays.max() * given.values.time_step_ms)
    model = Model.of(given.values, height=1, width=n_inputs, n_excitatory=n, input_delay_max_ms=delay)
    run = simulate(given.weights, given.delays, theta, given.images, given.values, learning, weight_sum)
    synapses = Synapses.of(given.weights, given.delays.astype(np.int16))
    module = Module(model, synapses, theta, model.make_scratch(learning), learning)
    module.rest()
    state = module.state
    counts = []
    for image in given.images:
        if weight_sum is not None:
            normalise_weights(synapses.weights, weight_sum)
        module.show(Train(*(array.astype(np.int32) for array in np.nonzero(image))))
        counts.append(state.counts[:n].copy())
    np.testing.assert_array_equal(counts, run.counts)
    for fired, spikes in ((state.fired, run.excitatory), (state.fired_i, run.inhibitory)):
        last = np.where(spikes.any(axis=0), len(spikes) - 1 - spikes[::-1].argmax(axis=0), NEVER)
        np.testing.assert_array_equal(fired[:n], last)
    close = {"rtol": 0, "atol": 1e-9}
    np.testing.assert_allclose(unpack_neurons(synapses.weights, n), run.weights, **close)
    np.testing.assert_allclose(state.theta[:n], run.theta, **close)
    np.testing.assert_allclose(state.v[:n], run.potentials[-1], **close)
    for found, expected in ((state.ge, run.ge), (state.gi, run.gi), (state.ge_i, run.ge_i)):
        np.testing.assert_allclose(found[:n], expected, rtol=0, atol=1e-12)
    acted_on = state.ge_i[:n] > 0  # the potential of others is reckoned when they are next acted on
    np.testing.assert_allclose(state.v_i[:n][acted_on], run.v_i[acted_on], **close)
    return run


ALONE = {"weight_sum": None}
ASKED = {"learning": False, "weight_sum": None}


@pytest.mark.parametrize(
    ("drawn", "how"),
    [
        *(({"seed": 2, "n_neurons": n_neurons}, {}) for n_neurons in (1, 2, 12)),
        ({"seed": 3, "n_neurons": 20}, ASKED),
        ({"seed": 4, "n_images": 3, "presentation_ms": 350.0, "rest_ms": 150.0}, {}),  # as published
        *(({"seed": 5, "longest": longest, "n_images": 3}, {}) for longest in (0, 1, 300)),
        pytest.param({"seed": 20}, {"weight_sum": 40.0}, id="weights above the maximum"),  # few are lifted past 1
        ({"seed": 10, "n_neurons": 6, "n_inputs": 1, "share": 0.3, "n_images": 2}, ALONE),
        ({"seed": 21, "excitatory_minimum_interval_ms": 0.0}, ALONE),  # the refractory period is longer
        ({"seed": 21, "excitatory_minimum_interval_ms": 2.05}, ASKED),
        *(({"seed": 11, "share": share, "n_images": 2, "presentation_ms": 60.0}, ALONE) for share in (0.25, 1.0)),
        *(
            pytest.param({"seed": 6, **changes}, ALONE, id="-".join(changes))
            for changes in (
                {"excitatory_minimum_interval_ms": 6.95, "pre_rate": -0.02, "post_rate": 0.1},
                {"inhibitory_to_excitatory_weight": 0.0},
                {"excitatory_to_inhibitory_weight": 30.0, "inhibitory_refractory_ms": 40.0},
                {"excitation_tau_ms": 5.0, "inhibition_tau_ms": 30.0},
                {"post_trace_tau_ms": 2.0, "pre_trace_tau_ms": 300.0, "slow_post_trace_tau_ms": 500.0},
                {"theta_plus_mv": 2.0, "theta_tau_ms": 1000.0},
                {"time_step_ms": 0.2},
                {"excitatory_reset_mv": -70.0, "excitatory_rest_mv": -60.0, "inhibitory_reset_mv": -80.0},
                {"rest_ms": 10.0, "presentation_ms": 51.2},
                # No whole numbers of steps: the nearest ones
                {"rest_ms": 30.06},
                {"excitatory_refractory_ms": 5.06, "inhibitory_refractory_ms": 2.04},
            )
        ),
    ],
)
def test_a_module_equals_the_direct_simulation_whatever_its_constants_delays_and_rates(drawn, how):
    run = agreed(Given.drawn(**drawn), **{"weight_sum": 16.0, **how})
    assert run.counts.sum() > 5


def test_the_last_step_of_a_presentation_and_of_its_rest_may_bring_a_spike():
    # Neurons below rest fire in steps 0, 501, 1002: the image ends after step 501, its rest after step 1002.
    values = Arguments(presentation_ms=50.2, rest_ms=50.1, theta_plus_mv=0.0)
    image = silence(502, 2)
    image[[480, 501], [0, 1]] = True
    given = Given(np.full((2, 3), 0.3), np.full((2, 3), 5), [image] * 3, values, 0.0)
    run = agreed(given)
    assert np.flatnonzero(run.excitatory[:, 0]).tolist() == [501 * k for k in range(7)]
    assert run.counts[:, 0].tolist() == [2, 2, 2]


def test_a_threshold_is_a_limit_that_must_be_passed():
    values, none = Arguments(presentation_ms=10.0), np.zeros((1, 1))
    for theta, count in ((7.0, 0), (7.0 - 1e-9, 1)):  # theta - 72 is the potential at rest
        given = Given(none, none.astype(int), [silence(100, 1)], values, theta)
        assert agreed(given, learning=False).counts.tolist() == [[count]]


@pytest.mark.parametrize("n_neurons", [1, 8, 11])
def test_normalised_columns_sum_to_78_and_keep_their_proportions_and_one_without_weights_stays(n_neurons):
    weights = 0.3 * (np.random.default_rng(1).random((784, n_neurons)) + 0.01)
    weights[:, 1:2] = 0
    padded = pack_neurons(weights)
    normalise_weights(padded, 78.0)
    found, full = unpack_neurons(padded, n_neurons), weights.any(axis=0)
    assert found.sum(axis=0) == pytest.approx(78.0 * full, rel=1e-12)
    assert found[:, full] / found[0, full] == pytest.approx(weights[:, full] / weights[0, full], rel=1e-12)
