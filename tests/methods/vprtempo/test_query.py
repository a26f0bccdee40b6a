"""Asking a trained VPRTempo network, in floats and in 8 bits: Eq. 1 and the scheme of 8 bits, in float64."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from tempo_networks import QUERIES, REFERENCES, RULE_SETS, SIZES, WAYS, double, fitted, network, one_layer, shown

from vprbench.methods.vprtempo import quantised, query, vnni
from vprbench.methods.vprtempo.int8 import VPRTempoInt8
from vprbench.methods.vprtempo.method import VPRTempo
from vprbench.methods.vprtempo.network import Network
from vprbench.methods.vprtempo.quantised import Int8LinearQuery, Int8SpikingQuery
from vprbench.methods.vprtempo.query import SpikingQuery
from vprbench.methods.vprtempo.rules import PAPER, V1


def affine(weights, bias, activation, most):
    """Return (n_queries, n_out) of activations (n_queries, n_in), which are `most` at most."""
    return activation @ weights.T + bias


def affine_in_8_bits(weights, bias, activation, most):
    """Return the same by whole sums of 255 levels and of 127 steps of each row's own size."""
    levels = np.clip(np.round(activation * 255 / most), 0, 255)
    size = np.abs(weights).max(1) / 127
    steps = np.round(weights / np.where(size > 0, size, 1)[:, None])  # np.round takes halves to the even side
    return (levels @ steps.T) * size * most / 255 + bias


def eq_1(asked, spikes, rules, layer):
    """Return the scores (n_queries, n_places) by Eq. 1 in both layers, module by module."""
    parts = []
    for module, outputs in enumerate(asked.outputs):
        bias = double(asked.constant[module]) - double(asked.feature_thresholds[module])
        active = layer(double(asked.features[module]), bias, spikes.astype(np.float64), 1).clip(0, rules.clip)
        parts.append(layer(double(outputs).T, -double(asked.output_thresholds[module]), active, rules.clip))
    scores = np.clip(np.concatenate(parts, axis=1), 0, rules.clip)
    silent = ~scores.any(1) & rules.silent_winner
    scores[silent, parts[0].argmax(1)[silent]] = 0.5
    return scores


@WAYS
@pytest.mark.parametrize(
    "rules", [PAPER, V1, replace(PAPER, clip=0.3), replace(PAPER, clip=1.0)], ids=["paper", "v1", "clip 0.3", "clip 1"]
)
@pytest.mark.parametrize(
    ("kind", "layer", "tolerance"), [(SpikingQuery, affine, 1e-6), (Int8SpikingQuery, affine_in_8_bits, 1e-5)]
)
@SIZES
def test_a_spiking_query_is_eq_1_also_of_few_synapses(sizes, kind, layer, tolerance, rules, ask):
    whole, spikes = network(sizes), shown(9)
    for each in (20, 0, 1, 3):
        asked = replace(whole, features=whole.features * (torch.arange(20) < each))
        expected = eq_1(asked, spikes, rules, layer)
        assert ask(kind(asked, rules), spikes) == pytest.approx(expected, abs=tolerance)


@WAYS
@pytest.mark.parametrize("members", [1, 3])
@SIZES
def test_a_linear_query_follows_the_scheme_on_the_mean_matrix(sizes, members, ask):
    asked, spikes = [network(sizes, seed=seed) for seed in range(members)], shown(9)
    pairs = [zip(one.features, one.outputs, strict=True) for one in asked]
    matrix = np.mean([np.concatenate([double(o).T @ double(f) for f, o in pair]) for pair in pairs], axis=0)
    expected = affine_in_8_bits(matrix, 0.0, spikes.astype(np.float64), 1)
    assert ask(Int8LinearQuery(asked), spikes) == pytest.approx(expected, abs=1e-5)


@WAYS
@pytest.mark.parametrize("kind", [SpikingQuery, Int8SpikingQuery])
def test_v1_lets_the_least_inhibited_place_of_module_0_answer_a_silent_query_and_paper_none(kind, ask):
    # Two modules of two places and of one. Under 0.5 on the first pixel module 0 has net inputs -0.15, -0.05 and, less
    # its thresholds, -0.15 and -0.35; place 2, in module 1, has -0.005. The second pixel excites place 2.
    inhibited = Network(
        features=torch.eye(2).repeat(2, 1, 1),
        constant=torch.zeros(2, 2),
        feature_thresholds=torch.zeros(2, 2),
        outputs=(torch.tensor([[-0.3, -0.1], [0.0, 0.0]]), torch.tensor([[-0.01], [1.0]])),
        output_thresholds=(torch.tensor([0.0, 0.3]), torch.tensor([0.0])),
    )
    spikes = np.array([[0.5, 0.0], [0.0, 0.2], *[[0.5, 0.0]] * 7], np.float32)
    silent = [0, *range(2, 9)]
    found = ask(kind(inhibited, V1), spikes)
    assert found[silent].tolist() == [[0.5, 0, 0]] * 8
    assert found[1] == pytest.approx([0, 0, 0.2], abs=0.01)
    assert not ask(kind(inhibited, PAPER), spikes)[silent].any()


@WAYS
@pytest.mark.parametrize("by", ["vnni", "whole steps", "half steps", "loops", "synapses"])
def test_each_way_to_multiply_gives_the_same_scores(by, ask, monkeypatch):
    parts, has_onednn = {"whole steps": 1, "half steps": 2}.get(by, 0), quantised._HAS_ONEDNN
    whole = has_onednn and quantised._count_parts() == 1
    if not {"vnni": vnni.AVAILABLE, "whole steps": whole, "half steps": has_onednn}.get(by, True):
        pytest.skip("this processor, or what numba compiles for, has not the instructions")
    monkeypatch.setattr(vnni, "AVAILABLE", by == "vnni")
    monkeypatch.setattr(quantised, "_HAS_ONEDNN", parts > 0)
    monkeypatch.setattr(quantised, "_count_parts", lambda: parts)
    monkeypatch.setattr(query, "_FEW", float(by == "synapses"))  # up to which share the synapses are read alone
    drawn, spikes = np.random.default_rng(0), shown(9, 301)
    rows = (drawn.standard_normal((5, 301)) * (drawn.random((5, 301)) < 0.7)).astype(np.float32)
    rows[:2] = np.sign(rows[:2])  # the largest sums
    spikes[:2] = 1
    expected = affine_in_8_bits(rows.astype(np.float64), 0.0, spikes.astype(np.float64), 1)
    assert ask(Int8LinearQuery([one_layer(rows.T)]), spikes) == pytest.approx(expected, abs=1e-4)


@RULE_SETS
def test_the_trained_network_is_that_of_vprtempo_and_scores_nearly_alike(rules):
    exact, rounded = fitted(rules=rules), fitted(VPRTempoInt8, rules=rules)
    assert exact.state().keys() == rounded.state().keys()
    assert all(np.array_equal(array, rounded.state()[name]) for name, array in exact.state().items())
    assert VPRTempo.stored_as == VPRTempoInt8.stored_as
    for images in (REFERENCES, QUERIES):
        floating, found = exact.query(images), rounded.query(images)
        assert np.mean(floating.argmax(1) == found.argmax(1)) >= 0.95
        assert 0 < np.abs(found - floating).max() < 0.05 * np.abs(floating).max()
