"""Single neurons of VPRSNN against closed forms: potentials, spike times, the minimum interval, winner-take-all."""

from __future__ import annotations

import math

import numpy as np
import pytest
from vprsnn_modules import Floats, Module, Spikes, silence

from vprbench.methods.vprsnn.arguments import Arguments

GAIN, GAIN_I = 0.1 / 100, 0.1 / 10  # step over membrane time constant, excitatory and inhibitory
UNREACHABLE = 1000.0  # mV of theta


class Driven(Module):
    """Neurons under a constant conductance: an input that spikes in every step replaces the tenth that decays."""

    def __init__(self, ge: float, theta: float | Floats = 20.0, n_neurons: int = 1, **replaced: float) -> None:
        super().__init__(np.full((1, n_neurons), ge / 10), theta, learning=False)
        self.state.ge[:n_neurons] = ge
        self.physics = self.physics._replace(**replaced)

    def fires(self, n_steps: int) -> list[list[int]]:
        return self.fire_times(constantly(n_steps))


def constantly(n_steps: int) -> Spikes:
    return np.ones((n_steps, 1), np.bool_)


def steps_to(threshold: float, start: float, rest: float, ge: float, gain: float) -> int:
    """Euler steps until a neuron is past its threshold: v - v_inf shrinks by 1 - gain (1 + ge) in each."""
    target = rest / (1 + ge)
    return math.floor(math.log((threshold - target) / (start - target)) / math.log(1 - gain * (1 + ge))) + 1


@pytest.mark.parametrize(("ge", "gi"), [(0.0, 0.0), (0.4, 0.0), (3.0, 0.0), (0.0, 2.0), (1.5, 5.0)])
@pytest.mark.parametrize("n_steps", [1, 33, 700, 3500])
def test_a_potential_under_constant_conductances_follows_its_closed_form(ge, gi, n_steps):
    module = Driven(ge, UNREACHABLE, gi_keep=1.0)
    module.state.gi[:] = gi
    module.state.v[:] = -80.0
    module.show(constantly(n_steps), resting=False)
    target = (-65 + gi * -100) / (1 + ge + gi)
    euler = target + (-80 - target) * (1 - GAIN * (1 + ge + gi)) ** n_steps
    assert module.v[0] == pytest.approx(euler, abs=1e-9)


@pytest.mark.parametrize("ge", [0.26, 0.3, 0.5, 2.5, 40.0])
def test_spikes_come_in_the_steps_that_the_closed_form_and_the_timer_say(ge):
    # The timer grows by 1e-5 s a step and must be past 5e-3 s. In exact numbers 500 steps reach the limit, so that 501
    # are past it; the sum of floating-point numbers agrees. A slow neuron integrates anew after 50 refractory steps.
    timer = np.cumsum(np.full(501, 1e-5))
    assert timer[499] <= 5e-3 < timer[500]
    ascent = steps_to(-52, -65, -65, ge, GAIN)
    period = max(501, 49 + ascent)
    assert Driven(ge).fires(ascent + 3 * period) == [[ascent - 1 + period * k for k in range(4)]]


def test_a_threshold_is_a_limit_that_must_be_passed():
    at_rest = Module(np.zeros((1, 1)), 7.0, learning=False)  # theta - 72 is the potential at rest
    assert at_rest.fire_times(silence(100, 1)) == [[]]
    below = Module(np.zeros((1, 1)), 7.0 - 1e-9, learning=False)
    assert below.fire_times(silence(100, 1)) == [[0]]


# --- Inhibition -------------------------------------------------------------------------------------------------


def test_an_inhibitory_neuron_under_constant_conductance_fires_as_its_closed_form_says():
    ge = 10.4
    module = Module(np.zeros((1, 1)), UNREACHABLE, learning=False)
    module.physics = module.physics._replace(ge_keep=1.0)
    module.state.ge_i[0] = ge
    first = steps_to(-40, -60, -60, ge, GAIN_I) - 1
    again = 19 + steps_to(-40, -45, -60, ge, GAIN_I)  # 20 refractory steps, of which the last may be the first ascent
    times = []
    for step in range(first + 3 * again + 1):
        module.show(silence(1, 1), resting=False)
        if module.state.counts_i[0]:
            times.append(step)
    assert times == [first + again * k for k in range(4)]


def test_a_spike_makes_its_partner_fire_five_steps_later_and_inhibit_all_others_but_not_the_neuron_itself():
    # The second neuron fires in step 0 alone.
    # v_i by hand: -60, -53.76, -48.79, -44.79, -41.55, -38.90 with ge_i 10.4, 9.36, 8.42, 7.58, 6.82.
    module = Module(np.zeros((1, 4)), np.array([20.0, 5.0, 20.0, 20.0]), learning=False)
    module.show(silence(5, 1), resting=False)
    assert module.state.gi.max() == 0
    assert module.state.v_i[1] == pytest.approx(-41.55, abs=0.005)
    module.show(silence(1, 1), resting=False)
    assert module.state.counts_i[:4].tolist() == [0, 1, 0, 0]
    assert module.state.v_i[1] == -45
    assert module.state.gi[:4].tolist() == [17, 0, 17, 17]
    module.show(silence(60, 1), resting=False)
    expected = -65.0
    for step in range(60):
        expected += GAIN * ((-65 - expected) + 17 * 0.8**step * (-100 - expected))
    assert expected == pytest.approx(-67.7, abs=0.1)
    assert module.v == pytest.approx([expected, -65, expected, expected])


def test_the_winner_takes_all():
    # All are driven alike and the first has the lowest threshold; its spike keeps the others from theirs.
    theta = np.array([20.0, 20.5, 20.5, 20.6])
    first = steps_to(-52, -65, -65, 0.6, GAIN) - 1
    inhibited = Driven(0.6, theta, 4)
    free = Driven(0.6, theta, 4, i_to_e=0.0)
    assert inhibited.fires(first + 200) == [[first], [], [], []]
    assert all(free.fires(first + 200))


@pytest.mark.parametrize("n_neurons", [1, 8, 9])
def test_places_in_the_arrays_past_the_last_neuron_never_fire(n_neurons):
    module = Module(np.ones((2, n_neurons)), 0.0, values=Arguments(presentation_ms=100.0, rest_ms=20.0))
    for _ in range(3):
        module.show(np.ones((1000, 2), bool))
        assert (module.state.counts[:n_neurons] > 0).all()
        assert not module.state.counts[n_neurons:].any()
        assert not module.state.late[n_neurons:].any()
