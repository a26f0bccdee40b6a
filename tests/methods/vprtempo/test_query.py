"""Asking a trained VPRTempo network: a single query, a batch and several networks against Eq. 1 in float64."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from tempo_networks import SIZES, WAYS, double, network, shown

from vprbench.methods.vprtempo.network import Network
from vprbench.methods.vprtempo.quantised import Int8SpikingQuery
from vprbench.methods.vprtempo.query import SpikingQuery
from vprbench.methods.vprtempo.rules import PAPER, V1


def eq_1(asked, spikes, rules):
    """Return the scores (n_queries, n_places) by Eq. 1 in both layers, query by query and module by module."""
    weights, constant, thresholds = map(double, (asked.features, asked.constant, asked.feature_thresholds))
    rows = []
    for x in spikes.astype(np.float64):
        features = np.clip(weights @ x + constant - thresholds, 0, rules.clip)
        layers = zip(asked.outputs, asked.output_thresholds, features, strict=True)
        above = [double(outputs).T @ active - double(limits) for outputs, limits, active in layers]
        row = np.clip(np.concatenate(above), 0, rules.clip)
        if rules.silent_winner and not row.any():
            row[above[0].argmax()] = 0.5
        rows.append(row)
    return np.array(rows)


@WAYS
@pytest.mark.parametrize("rules", [PAPER, V1, replace(PAPER, clip=0.3)], ids=["paper", "v1", "clip 0.3"])
@SIZES
def test_a_spiking_query_is_eq_1_also_of_few_synapses(sizes, rules, ask):
    whole, spikes = network(sizes), shown(9)
    for each in (20, 0, 1, 3):
        asked = replace(whole, features=whole.features * (torch.arange(20) < each))
        assert ask(SpikingQuery(asked, rules), spikes) == pytest.approx(eq_1(asked, spikes, rules), abs=1e-6)


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
