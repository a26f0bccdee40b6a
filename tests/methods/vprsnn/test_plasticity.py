"""VPRSNN's learning against hand arithmetic: pairs of spikes, the threshold that grows, weights and their sums.

A neuron whose threshold lies below its rest fires in steps 0, 501, 1002 and so on without any input: so the times of
its spikes are known, and an input spike can be placed before or after them.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from vprsnn_modules import Module, spikes_at

from vprbench.methods.vprsnn.arguments import Arguments

RESTLESS = 0.0  # mV of theta: a threshold of -72 mV
AT_SPIKES = {"pre_rate": 0.0}  # the neurons' own
AT_ARRIVALS = {"post_rate": 0.0}
SLOW = {**AT_ARRIVALS, "excitatory_minimum_interval_ms": 300.0}  # spikes in steps 0 and 3001


def restless(weights: object, delays: object = 0, **changes: float) -> Module:
    """Neurons that fire in steps 0, 501, 1002 and so on."""
    weights = np.array(weights, float, ndmin=2)
    delays = np.broadcast_to(np.array(delays), weights.shape)
    return Module(weights, RESTLESS, delays, values=Arguments(**changes))


def pair(before: float, interval: float = 501) -> float:
    """Change by an arrival `before` steps before a spike, `interval` steps after the neuron's last."""
    return 0.01 * math.exp(-before / 200) * math.exp(-interval / 400)


def after(*steps: float, rate: float = 1e-4) -> float:
    """Change by arrivals so many steps after a spike."""
    return sum(rate * math.exp(-step / 200) for step in steps)


@pytest.mark.parametrize(
    ("changes", "arrivals", "change"),
    [
        *((AT_SPIKES, [501 - before], pair(before)) for before in (0, 1, 50, 200, 500)),
        pytest.param(AT_SPIKES, [300, 400, 480], pair(21), id="of several arrivals the last alone counts"),
        pytest.param(AT_SPIKES, [400, 502], pair(101), id="an arrival after the spike has no part in it"),
        pytest.param(AT_SPIKES, [502], 0, id="nor alone"),
        pytest.param(
            {**AT_SPIKES, "excitatory_minimum_interval_ms": 58.0}, [571], pair(10, 581), id="a longer interval"
        ),
        pytest.param({**AT_SPIKES, "excitatory_minimum_interval_ms": 80.0}, [0], 0, id="the first spike"),
        # Added, where Diehl and Cook subtract
        *((AT_ARRIVALS, [step], after(step)) for step in (1, 20, 300, 500)),
        *(({**AT_ARRIVALS, "pre_rate": r}, [10, 11, 60, 390], after(10, 11, 60, 390, rate=r)) for r in (0.02, -0.02)),
        pytest.param(AT_ARRIVALS, [0], 0, id="an arrival in the step of a spike comes before it"),
        pytest.param(AT_ARRIVALS, [501], after(501), id="of the second spike too"),
    ],
)
def test_arrivals_before_and_after_a_spike_change_the_weight_by_the_pair_rules(changes, arrivals, change):
    module = restless([[0.3]], **changes)
    module.show(spikes_at(600, 1, *((step, 0) for step in arrivals)), resting=False)
    assert module.weights[0, 0] - 0.3 == pytest.approx(change, abs=1e-11)


@pytest.mark.parametrize("late", [511, 512, 513, 1024, 1025])
@pytest.mark.parametrize("delay", [0, 100])
def test_an_arrival_counts_once_wherever_the_simulation_looks_at_it(late, delay):
    # The input of a neuron that fired is summed in stretches of 512 steps: none may be missed or counted twice.
    module = restless([[0.3], [0.2]], [[delay], [0]], **SLOW)
    module.show(spikes_at(3500, 2, (late - delay, 0)), resting=False)
    assert module.counts.tolist() == [2]
    assert module.weights[:, 0] == pytest.approx([0.3 + after(late), 0.2], abs=1e-11)


@pytest.mark.parametrize("late", [511, 512, 513, 514])
def test_an_arrival_acts_once_with_the_weight_before_its_change(late):
    module = restless([[0.3]], 7, **SLOW, pre_rate=5.0)
    module.show(spikes_at(late + 1, 1, (late - 7, 0)), resting=False)
    assert module.state.ge[0] == pytest.approx(0.3)
    assert module.weights[0, 0] == pytest.approx(0.3 + after(late, rate=5.0))


@pytest.mark.parametrize(("rate", "limit", "almost"), [(1e-4, 1, 0.99999), (-1e-4, 0, 0.00001)])
def test_weights_stop_at_1_and_at_0(rate, limit, almost):
    module = restless([[limit], [almost], [0.5]], **AT_ARRIVALS, pre_rate=rate)
    module.show(np.ones((400, 3), np.bool_), resting=False)
    assert module.weights[:2, 0].tolist() == [limit, limit]
    assert 0 < abs(module.weights[2, 0] - 0.5) < 0.5
    pairs = restless([[1.0], [0.9999], [0.5]], **AT_SPIKES)
    pairs.show(spikes_at(600, 3, (501, 0), (501, 1)), resting=False)
    assert pairs.weights[:, 0].tolist() == [1, 1, 0.5]


@pytest.mark.parametrize("n_neurons", [1, 8, 11])
def test_normalised_columns_sum_to_78_and_keep_their_proportions_and_one_without_weights_stays(n_neurons):
    weights = 0.3 * (np.random.default_rng(1).random((784, n_neurons)) + 0.01)
    weights[:, 1:2] = 0
    module = Module(weights)
    module.normalise(78.0)
    full = weights.any(axis=0)
    assert module.weights.sum(axis=0) == pytest.approx(78.0 * full, rel=1e-12)
    found = module.weights[:, full]
    assert found / found[0] == pytest.approx(weights[:, full] / weights[0, full], rel=1e-12)
