"""The learning rules of VPRTempo, in both engines for CPUs: by hand, and over 200 steps against a float64 oracle."""

import copy
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import torch
import vprtempo_oracle as oracle

from vprbench.methods.vprtempo import fused, training
from vprbench.methods.vprtempo.layer import Layer, draw_layer, ramp_rates
from vprbench.methods.vprtempo.rules import PAPER, REFERENCE, RULES, V1
from vprbench.methods.vprtempo.training import Schedule, Training, draw_schedule

# Rules, and how far a weight may be off after 200 steps: float32 keeps 1e-6 (some 5e-8 are seen). Where W+ and W- are
# apart, the oracle as v1.0.0 lifts only what is below 0 to 1e-6, the product whatever is below 1e-6.
CASES = {
    "reference": (REFERENCE, 1e-6),
    "paper": (PAPER, 2e-6),
    "v1": (V1, 2e-6),
    "divided by the rate": (replace(PAPER, stdp_divided_by_rate=True), 2e-6),
}
FEATURE_DRAW = (0.1, 0.5)  # Table I: P_exc, P_inh
OUTPUT_DRAW = (1.0, 1.0)
STDP, ITP = 0.005, 0.15  # Table I
ENGINES = pytest.mark.parametrize("engine", [fused, training], ids=["fused", "readable"])


def close_to(expected, tolerance=1e-6):
    return pytest.approx(np.asarray(expected), rel=0, abs=tolerance)


def draws(seed):
    return [torch.Generator().manual_seed(seed)]


def random_spikes(n_images, height, width, seed):
    """Blocks and noise on the grid k / 255 with some 8 % of exact zeros, as patch normalisation leaves them."""
    random = np.random.default_rng(seed)
    blocks = random.normal(size=(n_images, height // 4 + 1, width // 4 + 1))
    smooth = np.kron(blocks, np.ones((4, 4)))[:, :height, :width]
    z = np.clip(0.5 * smooth + 0.5 * random.normal(size=smooth.shape), -1, 1)
    return (np.floor(255 * (1 + z) / 2).reshape(n_images, -1) / 255).astype(np.float32)


def as_float64(tensor):
    return tensor[0].numpy().astype(np.float64)


def parts(layer):
    return as_float64(layer.excitation), as_float64(layer.inhibition), as_float64(layer.thresholds)


def exists(layer):
    """Return which excitatory and which inhibitory synapses exist."""
    return [weights[0].numpy() > 0 for weights in (layer.excitation, layer.inhibition)]


def signs_apart(w, thresholds):
    return np.maximum(w, 0), np.maximum(-w, 0), thresholds


# Places 0 to 19 twice, as two traverses, in 5 epochs: 200 steps. As no shuffle is asked of v1, its order is that.
TRAVERSES = np.tile(np.arange(20), 2)


@cache
def trained(name):
    """Both layers of 60 inputs, 120 features and 20 places, by each engine and by the oracle.

    Theta(x_j) is a jump: where rounding decides on which side of its threshold a neuron lies, one step's weights
    differ by eta * 0.5 = 2.5e-3, whoever computes. With this seed no net input comes so close to its threshold.
    """
    rules, generators, spikes = CASES[name][0], draws(0), random_spikes(40, 6, 10, seed=0)
    features = draw_layer(generators, [120], 60, FEATURE_DRAW, 0.5, rules.constant_input, rules)
    outputs = draw_layer(generators, [20], 120, OUTPUT_DRAW, 0.0, 0.0, rules)
    orders = [draw_schedule(generators, [20], TRAVERSES, 5, rules) for _ in range(2)]
    images = [order.image[:, 0].tolist() for order in orders]
    found = {"oracle": by_oracle(rules, features, outputs, spikes, images)}
    lesson = Training(torch.from_numpy(spikes), ramp_rates(120, 0.2, 0.9), rules, STDP, ITP, STDP)
    for engine in (fused, training):
        own_features, own_outputs = copy.deepcopy((features, outputs))
        engine.train_features(own_features, orders[0], lesson, lambda _: None)
        engine.train_places(own_outputs, own_features, orders[1], lesson, lambda _: None)
        found[engine] = parts(own_features), parts(own_outputs)
    return found


def by_oracle(rules, features, outputs, spikes, orders):
    """Train both layers by the oracle; its output layer sees its own features."""
    rates, constant = oracle.feature_rates(120), as_float64(features.constant)
    (plus, minus, theta), (plus_out, minus_out, theta_out) = parts(features), parts(outputs)
    if rules is REFERENCE:
        w, w_out = plus - minus, plus_out - minus_out
        w, theta = oracle.train_reference_feature(w, w > 0, w < 0, theta, rates, spikes, orders[0], 200, STDP, ITP)
        shown = np.clip(spikes.astype(np.float64) @ w.T - theta, 0, 0.9)
        w_out = oracle.train_reference_output(
            w_out, w_out > 0, w_out < 0, rates, shown, TRAVERSES, orders[1], 200, STDP
        )
        return signs_apart(w, theta), signs_apart(w_out, theta_out)
    stdp, itp = (
        oracle.learning_rates_v1(5, 40, rate) if rules is V1 else oracle.learning_rates_reference(200, 200, rate)
        for rate in (STDP, ITP)
    )
    plus, minus, theta = oracle.train_separate_feature(
        *(plus, minus, *exists(features), constant, theta, rates, spikes, orders[0], stdp, itp),
        heaviside=rules is not V1,
        divided=rules.stdp_divided_by_rate,
    )
    shown = np.clip(spikes.astype(np.float64) @ (plus - minus).T + constant - theta, 0, 0.9)
    learnt = oracle.train_separate_output(
        *(plus_out, minus_out, *exists(outputs), theta_out, rates, shown, TRAVERSES, orders[1], stdp),
        output_thresholds_learn=rules is V1,
        share=1.0 if rules is V1 else 0.5,
    )
    return (plus, minus, theta), learnt


@ENGINES
@pytest.mark.parametrize("name", CASES)
def test_200_steps_agree_with_the_oracle(name, engine):
    for found, expected in zip(trained(name)[engine], trained(name)["oracle"], strict=True):
        for own, wanted in zip(found, expected, strict=True):
            assert own == close_to(wanted, CASES[name][1])


@ENGINES
@pytest.mark.parametrize(
    ("rules", "excitation", "inhibition", "learnt"),
    [
        # a = 9.999 - 9.8 = 0.199, y = 0.199: both magnitudes grow by 0.01 * 0.301 = 0.00301, the first to its limit
        (PAPER, 9.999, 9.8, (10, 9.80301 * 1.0995, 0.12)),
        # 1 + 50 eta a = 1 + 0.5 * -5 < 0 would turn the inhibition of 5 into excitation
        (V1, 0.0, 5.0, (0, 0, 0)),
    ],
)
def test_a_weight_is_held_at_10_and_keeps_its_sign(rules, excitation, inhibition, learnt, engine):
    nothing, first = torch.zeros(1, 1), torch.zeros(1, 1, dtype=torch.int64)
    weights = [torch.tensor([[[w]]]) for w in (excitation, inhibition)]
    layer = Layer(*weights, nothing.clone(), nothing)  # a weight of 0 is no synapse
    lesson = Training(torch.ones(1, 1), torch.tensor([0.2]), rules, 0.01, 0.15, 0.01)
    engine.train_features(layer, Schedule(first, first, torch.ones(1, 1)), lesson, lambda _: None)
    found = [float(part) for part in (layer.excitation, layer.inhibition, layer.thresholds)]
    assert found == pytest.approx(learnt, rel=1e-6, abs=2e-7)


@cache
def drawn(rule_set):
    return draw_layer(draws(0), [1568], 784, FEATURE_DRAW, 0.5, 0.1, RULES[rule_set])


def test_10_and_50_percent_of_the_synapses_are_drawn_and_thresholds_and_constant_input_are_uniform():
    plus, minus = drawn("paper").excitation > 0, drawn("paper").inhibition > 0
    layer = drawn("reference")
    found = (plus, minus, plus & minus, layer.weights > 0, layer.weights < 0)
    shares = [float(part.float().mean()) for part in found]
    assert shares == pytest.approx([0.10, 0.50, 0.05, 0.10, 0.45], abs=0.002)
    assert not ((layer.excitation > 0) & (layer.inhibition > 0)).any()
    # The largest distance of 1568 uniform draws from the straight line is above 0.05 once in 1300 seeds.
    for part, highest in (("thresholds", 0.5), ("constant", 0.1)):
        values = np.sort(getattr(drawn("paper"), part)[0].numpy()) / highest
        assert values == close_to((np.arange(1568) + 0.5) / 1568, 0.05)


def test_paper_weights_are_normal_around_3_standard_deviations_with_an_l1_norm_of_1_a_neuron():
    for part in (drawn("paper").excitation[0], drawn("paper").inhibition[0]):
        assert part.sum(1).numpy() == close_to(np.ones(1568), 1e-5)
    # N(0.5, 1/6): standard deviation over mean is 1/3, whatever the divisor
    w = drawn("paper").inhibition[drawn("paper").inhibition > 0]
    assert float(w.std() / w.mean()) == pytest.approx(1 / 3, abs=0.02)


def test_reference_weights_before_adding_share_the_divisor_of_the_last_neuron():
    # N(0.5, 1/6) over one divisor: a neuron's mean weight is the same for all but for 3.8 % of chance (78
    # synapses), while its sum follows the number of its synapses. Normalised per neuron the sums would be 1.
    layer = draw_layer(draws(0), [300], 784, (0.1, 0.0), 0.5, 0.0, REFERENCE)
    w = layer.excitation[0, :-1]
    count = (w > 0).sum(1)
    assert float(layer.excitation[0, -1].sum()) == pytest.approx(1, abs=1e-5)
    assert np.corrcoef(w.sum(1), count)[0, 1] > 0.9
    assert float((w.sum(1) / count).std() / (w.sum(1) / count).mean()) == pytest.approx(0.038, abs=0.01)
    without_synapses = draw_layer(draws(0), [5], 4, (0.0, 0.0), 0.5, 0.0, REFERENCE)
    assert not without_synapses.weights.any()  # nor are they 0 / 0


@pytest.mark.parametrize(("probability", "each"), [(0.001, 1), (0.1, 6), (1.0, 60)])
def test_even_connections_give_neurons_and_inputs_equally_many(probability, each):
    layer = draw_layer(draws(0), [30], 60, (probability, 0.0), 0.5, 0.1, replace(PAPER, even_connections=True))
    excitatory, inhibitory = exists(layer)
    assert (excitatory.sum(1) == each).all()
    assert set(excitatory.sum(0)) <= {30 * each // 60, -(-30 * each // 60)}
    assert not inhibitory.any()


def untrained(n_modules, images_of):
    """Return layers of 60 inputs, 40 features and modules that see images of `images_of` places, 5 epochs of 40."""
    rules, generators = replace(PAPER, feature_rule="rates", output_rule="covariance"), draws(0) * n_modules
    features = draw_layer(generators, [40] * n_modules, 60, FEATURE_DRAW, 0.5, 0.1, rules)
    outputs = draw_layer(generators, images_of, 40, OUTPUT_DRAW, 0.0, 0.0, rules)
    order = draw_schedule(generators, images_of, np.tile(np.arange(sum(images_of)), 2), 5, rules)
    spikes = torch.from_numpy(random_spikes(2 * sum(images_of), 6, 10, seed=0))
    return features, outputs, order, Training(spikes, ramp_rates(40, 0.2, 0.9), rules, STDP, ITP, 0.3)


def test_thresholds_are_set_where_a_neuron_fires_at_its_rate_and_never_below_0():
    features, _, order, lesson = untrained(2, [20, 12])
    training.set_thresholds(features, order, lesson)
    for module, count in enumerate([40, 24]):
        own = sorted(set(order.image[order.factor[:, module] > 0, module].tolist()))
        shown = lesson.spikes[own].numpy().astype(np.float64)
        assert len(shown) == count
        layer = features[slice(module, module + 1)]
        net = shown @ as_float64(layer.weights).T + as_float64(layer.constant)
        thresholds, rates = as_float64(layer.thresholds), lesson.rates.numpy()
        free = thresholds > 0
        assert free.sum() > 10
        assert (net > thresholds + 1e-6).mean(0)[free] == close_to(rates[free], 1.5 / count)
        assert (thresholds >= 0).all()
        assert ((net > 1e-6).mean(0) <= rates + 1.5 / count)[~free].all()


def test_the_covariance_rule_is_its_formula():
    features, outputs, order, lesson = untrained(1, [20])
    training.set_thresholds(features, order, lesson)
    training.associate_places(outputs, features, order, lesson, lambda _: None)
    net = lesson.spikes.numpy().astype(np.float64) @ as_float64(features.weights).T + as_float64(features.constant)
    active = np.clip(net - as_float64(features.thresholds), 0, 0.9)
    away = active - active.mean(0)
    rate = 0.3 / np.square(away).sum(1).mean()
    weights = np.zeros((20, 40))
    for start in (0, 100):  # 200 steps, learnt from 100 at a time
        change = np.zeros_like(weights)
        for step in range(start, start + 100):
            image = int(order.image[step, 0])
            error = -np.clip(weights @ away[image], 0, 0.9)
            error[image % 20] += 0.5
            change += rate * float(order.factor[step, 0]) * np.outer(error, away[image])
        weights += change
    weights *= 0.03 / np.sqrt(np.square(away @ weights.T).mean(0))[:, None]
    assert as_float64(outputs.weights) == close_to(weights, 1e-5)
    assert as_float64(outputs.thresholds) == close_to(weights @ active.mean(0), 1e-5)
    assert np.abs(weights).max() > 1e-2
