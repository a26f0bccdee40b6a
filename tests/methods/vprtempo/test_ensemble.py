"""Several VPRTempo networks of the same places, and scores that are calibrated by those of the references."""

from typing import get_args

import numpy as np
import pytest
import torch
from states import member, same
from tempo_networks import QUERIES, REFERENCES, RULE_SETS, SMALL, fitted

from vprbench.errors import BadInput
from vprbench.methods.vprtempo.arguments import Engine
from vprbench.methods.vprtempo.ensemble import VPRTempoEnsemble
from vprbench.methods.vprtempo.int8 import VPRTempoInt8
from vprbench.methods.vprtempo.method import VPRTempo
from vprbench.methods.vprtempo.network import Network
from vprbench.methods.vprtempo.query import calibrate_network
from vprbench.methods.vprtempo.rules import REFERENCE, RuleSet


def empty(members, **arguments):
    return VPRTempoEnsemble(members=members, **SMALL | arguments)


def ensemble(members, **arguments):
    return fitted(VPRTempoEnsemble, members=members, **arguments)


def alone(seed, **arguments):
    return fitted(seed=seed, **arguments)


@pytest.mark.parametrize(
    "arguments",
    [
        *({"rules": rules, "engine": engine} for rules in get_args(RuleSet) for engine in get_args(Engine)),
        {"max_module": 7},
    ],
    ids=str,
)
def test_each_member_is_to_the_bit_the_network_that_vprtempo_trains_from_its_seed(arguments):
    state = ensemble(3, **arguments).state()
    for number in range(3):
        assert same(member(state, number), alone(number, **arguments).state())
    assert not np.allclose(member(state, 0)["features"], member(state, 1)["features"], atol=1e-3)


@RULE_SETS
@pytest.mark.parametrize("members", [1, 3])
def test_the_scores_are_the_mean_of_those_of_the_members(rules, members):
    trained = ensemble(members, rules=rules, seed=1)
    expected = np.mean([alone(1 + n, rules=rules).query(QUERIES).astype(np.float64) for n in range(members)], axis=0)
    assert trained.query(QUERIES) == pytest.approx(expected, abs=1e-6)
    if members == 1:
        assert np.array_equal(trained.query(QUERIES), alone(1, rules=rules).query(QUERIES))
        assert same(trained.state(), alone(1, rules=rules).state())


@pytest.mark.parametrize(("stored", "wanted"), [(2, 3), (3, 2), (1, 2), (2, 1)])
def test_another_number_of_members_is_refused(stored, wanted):
    with pytest.raises(BadInput):
        empty(wanted).restore(ensemble(stored).state())
    many = ensemble(12, max_module=20, epochs=1).state()  # more than ten keep their order
    assert same(empty(12).restore(many).state(), many)


def scores(kind=VPRTempo, **arguments):
    return np.asarray(fitted(kind, **arguments).query(QUERIES))


@RULE_SETS
@pytest.mark.parametrize(("kind", "tolerance"), [(VPRTempo, 1e-3), (VPRTempoInt8, 1e-2)])
def test_scores_are_counted_in_spreads_from_the_mean_over_the_references(kind, tolerance, rules, monkeypatch):
    plain = fitted(rules=rules)
    assert not plain.choose_rules().calibrated_scores
    over_references = plain.query(REFERENCES).astype(np.float64)
    mean, spread = over_references.mean(0), over_references.std(0)
    expected = (scores(kind, rules=rules) - mean) / np.maximum(spread, 0.01 * spread.mean())
    assert scores(kind, rules=rules, calibrated_scores=True) == pytest.approx(expected, rel=tolerance, abs=tolerance)
    monkeypatch.setattr("vprbench.methods.vprtempo.query._BLOCK", 7)  # several blocks of references count as one
    anew = fitted.__wrapped__(kind, rules=rules, calibrated_scores=True)
    assert anew.query(QUERIES) == pytest.approx(expected, rel=tolerance, abs=tolerance)


@pytest.mark.parametrize(("loud", "least"), [(0.0, 1.0), (1.0, 0.005)])
def test_a_place_that_hardly_answers_has_a_hundredth_of_the_mean_spread_or_1(loud, least):
    nothing, outputs = torch.zeros(1, 1), torch.tensor([[0.0, loud]])
    network = Network(torch.ones(1, 1, 1), nothing, nothing, (outputs,), (torch.zeros(2),))
    shown = torch.tensor([[0.0], [0.0], [2.0], [2.0]])  # the scores' spread is 1 where they are loud
    calibrated = calibrate_network(network, shown, REFERENCE).calibration
    assert calibrated is not None
    assert calibrated[1].tolist() == pytest.approx([least, max(loud, least)])
