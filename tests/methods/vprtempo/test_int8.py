"""VPRTempo in 8 bits: its numbers against the scheme written down once more, and how near the float network is."""

from dataclasses import replace

import numpy as np
import pytest
from tempo_networks import QUERIES, REFERENCES, RULE_SETS, SIZES, WAYS, double, fitted, network, one_layer, shown

from vprbench.methods.vprtempo import quantised, query, vnni
from vprbench.methods.vprtempo.int8 import VPRTempoInt8
from vprbench.methods.vprtempo.method import VPRTempo
from vprbench.methods.vprtempo.quantised import Int8LinearQuery, Int8SpikingQuery
from vprbench.methods.vprtempo.rules import PAPER, V1


def linear(rows):
    """Return the query of a linear network whose one matrix has these rows."""
    return Int8LinearQuery([one_layer(np.asarray(rows, np.float32).T)])


def in_255_levels(activation, most):
    return np.clip(np.round(activation * 255 / most), 0, 255)


def affine(weights, bias, levels, most):
    """Return (n_queries, n_out) of levels (n_queries, n_in), by whole sums of 127 steps of each row's own size."""
    size = np.abs(weights).max(1) / 127
    steps = np.round(weights / np.where(size > 0, size, 1)[:, None])  # np.round takes halves to the even side
    return (levels @ steps.T) * size * most / 255 + bias


def spiking_in_8_bits(asked, spikes, rules):
    levels = in_255_levels(spikes.astype(np.float64), 1)
    parts = []
    for module, outputs in enumerate(asked.outputs):
        bias = double(asked.constant[module]) - double(asked.feature_thresholds[module])
        active = in_255_levels(affine(double(asked.features[module]), bias, levels, 1), rules.clip)
        parts.append(affine(double(outputs).T, -double(asked.output_thresholds[module]), active, rules.clip))
    scores = np.clip(np.concatenate(parts, axis=1), 0, rules.clip)
    if rules.silent_winner:
        for row, first in zip(scores, parts[0], strict=True):
            if not row.any():
                row[first.argmax()] = 0.5
    return scores


@WAYS
@pytest.mark.parametrize(
    "rules", [PAPER, V1, replace(PAPER, clip=0.3), replace(PAPER, clip=1.0)], ids=["paper", "v1", "clip 0.3", "clip 1"]
)
@SIZES
def test_a_spiking_query_follows_the_scheme(sizes, rules, ask):
    asked, spikes = network(sizes), shown(9)
    expected = spiking_in_8_bits(asked, spikes, rules)
    assert ask(Int8SpikingQuery(asked, rules), spikes) == pytest.approx(expected, abs=1e-5)


@WAYS
@pytest.mark.parametrize("members", [1, 3])
@SIZES
def test_a_linear_query_follows_the_scheme_on_the_mean_matrix(sizes, members, ask):
    asked, spikes = [network(sizes, seed=seed) for seed in range(members)], shown(9)
    levels = in_255_levels(spikes.astype(np.float64), 1)
    pairs = [zip(one.features, one.outputs, strict=True) for one in asked]
    matrix = np.mean([np.concatenate([double(o).T @ double(f) for f, o in pair]) for pair in pairs], axis=0)
    expected = affine(matrix, np.zeros(len(matrix)), levels, 1)
    assert ask(Int8LinearQuery(asked), spikes) == pytest.approx(expected, abs=1e-5)


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
    expected = affine(rows.astype(np.float64), 0.0, in_255_levels(spikes.astype(np.float64), 1), 1)
    assert ask(linear(rows), spikes) == pytest.approx(expected, abs=1e-4)


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
