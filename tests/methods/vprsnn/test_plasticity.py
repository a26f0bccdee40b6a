"""VPRSNN's learning against hand arithmetic: pairs of spikes, the threshold that grows, weights and their sums.

A neuron whose threshold lies below its rest fires in steps 0, 501, 1002 and so on without any input: so the times of
its spikes are known, and an input spike can be placed before or after them.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from vprsnn_modules import Floats, Module, spikes_at

from vprbench.methods.vprsnn.arguments import Arguments

RESTLESS = 0.0  # mV of theta: a threshold of -72 mV
KEEP = 1 - 1e-8  # of theta in a step of 0.1 ms, by a time constant of 1e7 ms


def restless(weights: object, delays: object = 0, values: Arguments | None = None) -> Module:
    """Neurons that fire in steps 0, 501, 1002 and so on."""
    weights = np.array(weights, float, ndmin=2)
    delays = np.broadcast_to(np.array(delays), weights.shape)
    return Module(weights, RESTLESS, delays, values=values)


def only_at_spikes_of_neurons(**changes: float) -> Arguments:
    return Arguments(pre_rate=0.0, **changes)


def only_at_arrivals(**changes: float) -> Arguments:
    return Arguments(post_rate=0.0, **changes)


def pair(before: float, interval: float) -> float:
    """Change by an arrival `before` steps before a spike, `interval` steps after the neuron's last."""
    return 0.01 * math.exp(-before / 200) * math.exp(-interval / 400)


# --- At a spike of the neuron -----------------------------------------------------------------------------------


@pytest.mark.parametrize("before", [0, 1, 50, 200, 500])
def test_a_spike_after_an_arrival_adds_the_pair_rule(before):
    module = restless([[0.3]], values=only_at_spikes_of_neurons())
    module.show(spikes_at(600, 1, (501 - before, 0)), resting=False)
    assert module.counts.tolist() == [2]
    assert module.weights[0, 0] - 0.3 == pytest.approx(pair(before, 501), abs=1e-11)


def test_the_first_spike_of_a_neuron_changes_no_weight():
    module = restless([[0.3]], values=only_at_spikes_of_neurons())
    module.show(spikes_at(400, 1, (0, 0)), resting=False)
    assert module.counts.tolist() == [1]
    assert module.weights[0, 0] == 0.3


def test_of_several_arrivals_the_last_alone_counts():
    module = restless([[0.3]], values=only_at_spikes_of_neurons())
    module.show(spikes_at(600, 1, (300, 0), (400, 0), (480, 0)), resting=False)
    assert module.weights[0, 0] - 0.3 == pytest.approx(pair(21, 501), abs=1e-11)


def test_an_arrival_after_the_spike_has_no_part_in_it():
    module = restless([[0.3], [0.3]], values=only_at_spikes_of_neurons())
    module.show(spikes_at(600, 2, (502, 0), (400, 1), (502, 1)), resting=False)
    assert module.weights[:, 0] - 0.3 == pytest.approx([0, pair(101, 501)], abs=1e-11)


def test_each_synapse_counts_from_its_own_arrival():
    delays = np.array([[0, 1, 30, 100], [70, 71, 72, 99]])
    module = restless(np.full((2, 4), 0.3), delays, only_at_spikes_of_neurons())
    module.show(spikes_at(3500, 2, (401, 0), (430, 1)))
    # Input 1 reaches the second neuron in the step of its spike, and the two others after it.
    first = np.array([[100, 99, 70, 0], [1, 0, np.inf, np.inf]])
    # All fire again 501 steps later, and so on to step 3006 and, in the rest, to 4509.
    arrivals = np.array([401, 430])[:, None] + delays
    expected = np.exp(-first / 200) * math.exp(-501 / 400)
    for spike in range(1002, 5000, 501):
        expected += np.exp(-(spike - arrivals) / 200) * math.exp(-501 / 400)
    assert module.weights - 0.3 == pytest.approx(0.01 * expected, abs=1e-10)


def test_an_arrival_in_one_presentation_counts_for_a_spike_in_the_next():
    values = only_at_spikes_of_neurons(presentation_ms=40.0, rest_ms=10.0)
    module = restless([[0.3]], 60, values)
    module.show(spikes_at(400, 1, (350, 0)))
    assert module.weights[0, 0] == 0.3
    module.show(spikes_at(400, 1))
    assert module.weights[0, 0] - 0.3 == pytest.approx(pair(501 - 410, 501), abs=1e-11)


def test_a_long_interval_between_two_spikes_makes_the_change_small():
    module = restless([[0.3]], values=only_at_spikes_of_neurons())
    module.physics = module.physics._replace(e_interval=1200)
    module.show(spikes_at(1300, 1, (1190, 0)), resting=False)
    assert module.counts.tolist() == [2]
    assert module.weights[0, 0] - 0.3 == pytest.approx(pair(10, 1200), abs=1e-11)


# --- At an arrival ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("after", [1, 20, 300, 500])
def test_an_arrival_after_a_spike_adds_to_the_weight_where_diehl_and_cook_subtract(after):
    module = restless([[0.3]], values=only_at_arrivals())
    module.show(spikes_at(501, 1, (after, 0)), resting=False)
    assert module.weights[0, 0] - 0.3 == pytest.approx(1e-4 * math.exp(-after / 200), abs=1e-11)


@pytest.mark.parametrize("rate", [1e-4, 0.02, -0.02])
def test_every_arrival_after_a_spike_counts(rate):
    module = restless([[0.3]], values=only_at_arrivals(pre_rate=rate))
    module.show(spikes_at(400, 1, *((step, 0) for step in (10, 11, 60, 390))), resting=False)
    expected = sum(rate * math.exp(-after / 200) for after in (10, 11, 60, 390))
    assert module.weights[0, 0] - 0.3 == pytest.approx(expected, abs=1e-11)


def test_an_arrival_in_the_step_of_a_spike_comes_before_it():
    module = restless([[0.3], [0.3]], values=only_at_arrivals())
    module.show(spikes_at(502, 2, (0, 0), (501, 1)), resting=False)
    assert module.weights[:, 0] - 0.3 == pytest.approx([0, 1e-4 * math.exp(-501 / 200)], abs=1e-11)


@pytest.mark.parametrize("after", [511, 512, 513, 514, 1023, 1024, 1025, 1026])
@pytest.mark.parametrize("delay", [0, 1, 100])
def test_an_arrival_counts_once_wherever_the_simulation_looks_at_it(after, delay):
    # The input of a neuron that fired is summed in stretches of 512 steps: none may be missed or counted twice.
    values = only_at_arrivals(excitatory_minimum_interval_ms=300.0)
    module = restless([[0.3], [0.2]], [[delay], [0]], values)
    module.show(spikes_at(3500, 2, (after - delay, 0)), resting=False)
    assert module.counts.tolist() == [2]  # steps 0 and 3001
    assert module.weights[:, 0] == pytest.approx([0.3 + 1e-4 * math.exp(-after / 200), 0.2], abs=1e-11)


@pytest.mark.parametrize("after", [511, 512, 513, 514])
def test_an_arrival_acts_once_with_the_weight_before_its_change(after):
    values = only_at_arrivals(excitatory_minimum_interval_ms=300.0, pre_rate=5.0)
    module = restless([[0.3]], 7, values)
    module.physics = module.physics._replace(shown=after + 1)
    module.show(spikes_at(after + 1, 1, (after - 7, 0)), resting=False)
    assert module.state.ge[0] == pytest.approx(0.3)
    assert module.weights[0, 0] == pytest.approx(0.3 + 5 * math.exp(-after / 200))


def test_a_neuron_that_never_fired_learns_nothing():
    quiet = Module(np.full((2, 1), 0.3), 1000.0)
    quiet.show(np.ones((3500, 2), np.bool_))
    assert (quiet.weights == 0.3).all()


def test_nothing_is_learnt_while_asking():
    module = Module(np.full((2, 3), 0.3), RESTLESS, learning=False)
    module.show(np.ones((3500, 2), np.bool_))
    assert module.counts.min() == 7
    assert (module.weights == 0.3).all()
    assert (module.theta == RESTLESS).all()


# --- The threshold ----------------------------------------------------------------------------------------------


def test_each_spike_raises_theta_by_5_hundredths_of_a_millivolt():
    module = restless([[0.3]])
    spikes = list(range(0, 5000, 501))
    module.show(spikes_at(3500, 1))
    expected = sum(0.05 * KEEP ** (4999 - spike) for spike in spikes)
    assert len(spikes) == 10
    assert module.theta[0] == pytest.approx(expected, abs=1e-11)
    assert module.theta[0] == pytest.approx(0.5, abs=1e-4)


def test_a_rising_theta_stops_a_restless_neuron():
    # From 6.86 mV three spikes lead past 7 mV, the threshold at rest.
    module = Module(np.full((1, 1), 0.3), 6.86)
    assert module.fire_times(spikes_at(5000, 1)) == [[0, 501, 1002]]


@pytest.mark.parametrize("presentations", [1, 7])
def test_theta_decays_with_a_time_constant_of_10_000_seconds(presentations):
    module = Module(np.full((1, 2), 0.3), np.array([20.0, 35.0]))
    for _ in range(presentations):
        module.show(spikes_at(3500, 1, (5, 0)))
    n_steps = 5000 * presentations
    assert module.theta == pytest.approx(np.array([20.0, 35.0]) * KEEP**n_steps, rel=1e-12)
    assert 20 - module.theta[0] == pytest.approx(20 * n_steps * 1e-4 / 1e4, rel=1e-3)


# --- Weights and their sums -------------------------------------------------------------------------------------


def test_weights_stop_at_1_and_at_0():
    upwards = restless([[1.0], [0.99999], [0.5]], values=only_at_arrivals())
    upwards.show(np.ones((400, 3), np.bool_), resting=False)
    assert upwards.weights[:2, 0].tolist() == [1, 1]
    assert 0.5 < upwards.weights[2, 0] < 1
    pairs = restless([[1.0], [0.9999], [0.5]], values=only_at_spikes_of_neurons())
    pairs.show(spikes_at(600, 3, (501, 0), (501, 1)), resting=False)
    assert pairs.weights[:, 0].tolist() == [1, 1, 0.5]
    downwards = restless([[0.0], [0.00001], [0.5]], values=only_at_arrivals(pre_rate=-1e-4))
    downwards.show(np.ones((400, 3), np.bool_), resting=False)
    assert downwards.weights[:2, 0].tolist() == [0, 0]
    assert 0 < downwards.weights[2, 0] < 0.5


def dense(seed: int, n_inputs: int, n_neurons: int) -> tuple[Floats, np.ndarray]:
    random = np.random.default_rng(seed)
    return 0.3 * (random.random((n_inputs, n_neurons)) + 0.01), random.integers(0, 101, (n_inputs, n_neurons))


@pytest.mark.parametrize("n_neurons", [1, 8, 11])
def test_normalised_columns_sum_to_78_and_keep_their_proportions(n_neurons):
    weights, delays = dense(1, 784, n_neurons)
    module = Module(weights, delays=delays)
    module.normalise(78.0)
    assert module.weights.sum(axis=0) == pytest.approx(np.full(n_neurons, 78.0), rel=1e-12)
    assert module.weights / module.weights[0] == pytest.approx(weights / weights[0], rel=1e-12)


def test_a_column_without_weights_stays_without():
    module = Module(np.array([[0.0, 0.2], [0.0, 0.6]]))
    module.normalise(78.0)
    assert module.weights.tolist() == [[0, 19.5], [0, 58.5]]
