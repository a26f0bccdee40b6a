"""VPRTempo in time: its steps against a simulation of single neurons, and where queries end."""

import numpy as np
import pytest
from tempo_networks import QUERIES, SIZES, SMALL, double, fitted, network, shown

from vprbench.errors import BadInput
from vprbench.methods.vprtempo.latencies import LatencyQuery, VPRTempoLatencies
from vprbench.methods.vprtempo.rules import PAPER


def simulated(asked, pixels, steps):
    """Return the outputs after each step of the features' cycle, (steps, n_places), neuron by neuron."""
    clip, outputs = 0.9, []
    for module, weights in enumerate(asked.outputs):
        net = double(asked.constant[module]) - double(asked.feature_thresholds[module])
        for step in range(1, steps + 1):  # the inputs' cycle
            for pixel in np.flatnonzero(np.round((1 - pixels) * steps) + 1 == step):
                net = net + double(asked.features[module])[:, pixel] * (steps + 1 - step) / steps
        when = np.round((1 - np.clip(net, 0, clip) / clip) * steps) + 1
        potential, states = np.zeros(weights.shape[1]), []
        for step in range(1, steps + 1):  # the features' cycle
            for feature in np.flatnonzero(when == step):
                potential = potential + double(weights)[feature] * clip * (steps + 1 - step) / steps
            states.append(np.clip(potential - double(asked.output_thresholds[module]) * step / steps, 0, clip))
        outputs.append(states)
    return np.concatenate(outputs, axis=1)


@SIZES
@pytest.mark.parametrize("lead", [None, 0.1, 0.3])
def test_an_answer_is_that_of_a_simulation_of_single_neurons_where_the_query_ends(sizes, lead):
    asked, spikes = network(sizes), shown(6)
    for pixels, found in zip(spikes, LatencyQuery(asked, PAPER, 8, lead).scores(spikes), strict=True):
        states = simulated(asked, pixels.astype(np.float64), 8)
        second, first = np.sort(np.pad(states, ((0, 0), (1, 0))), axis=1)[:, -2:].T
        ends = [*np.flatnonzero(first - second > (lead or 1.0) * first), 7]
        assert found == pytest.approx(states[ends[0]], abs=1e-5)


def test_a_network_of_vprtempo_answers_in_time_with_larger_amplitudes_earlier_in_the_cycle_of_their_layer():
    tempo, codes = fitted(), fitted().encode(QUERIES)
    for given in ({"steps": 3}, {"lead": 0.0}, {"query_rule": "linear"}, {"calibrated_scores": True}):
        with pytest.raises(BadInput):
            VPRTempoLatencies(**{**SMALL, **given}).restore(tempo.state())
    timed = VPRTempoLatencies(**SMALL, steps=64).restore(tempo.state())
    assert (timed.match(codes).argmax(1) == tempo.match(codes).argmax(1)).mean() >= 0.9
    timed = VPRTempoLatencies(**SMALL, steps=10).restore(tempo.state())
    for cycle, (layer, most) in enumerate(zip(timed.spikes(codes), (1, 0.9), strict=False)):
        assert layer.times is not None
        spiked = layer.times > 0
        # A spike stands for its amplitude to within half a step of ten.
        meant = most * (1 - (layer.times - 10 * cycle - 1) / 10)
        assert spiked.any()
        assert np.abs(meant - layer.values)[spiked].max() <= most / 20 + 1e-6
        assert layer.values[~spiked].max(initial=0) <= most / 20 + 1e-6
    outputs = timed.spikes(codes)[2]
    assert outputs.times is not None
    answered = outputs.values.any(1)
    assert answered.any()
    assert (outputs.times[answered, outputs.values.argmax(1)[answered]] == 21).all()  # the first step of its cycle
