"""Calibrated scores: every place is judged by the scores that the references give it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import torch
from tempo_networks import QUERIES, REFERENCES, SMALL, fitted

from vprbench.errors import BadInput
from vprbench.methods.vprtempo.ensemble import VPRTempoEnsemble
from vprbench.methods.vprtempo.int8 import VPRTempoInt8
from vprbench.methods.vprtempo.method import VPRTempo
from vprbench.methods.vprtempo.network import Network
from vprbench.methods.vprtempo.query import asking
from vprbench.methods.vprtempo.rules import PAPER, RULES


def scores(kind: type[VPRTempo] = VPRTempo, **arguments: Any) -> npt.NDArray[np.float32]:
    return np.asarray(fitted(kind, **arguments).query(QUERIES))


@pytest.mark.parametrize("rules", RULES)
def test_scores_are_counted_in_spreads_from_the_mean_over_the_references(rules, monkeypatch):
    plain = fitted(rules=rules)
    assert not plain.chosen_rules().calibrated_scores
    over_references = plain.query(REFERENCES).astype(np.float64)
    mean, spread = over_references.mean(0), over_references.std(0)
    expected = (plain.query(QUERIES) - mean) / np.maximum(spread, 0.01 * spread.mean())
    assert scores(rules=rules, calibrated_scores=True) == pytest.approx(expected, rel=1e-3, abs=1e-3)
    monkeypatch.setattr("vprbench.methods.vprtempo.query._BLOCK", 7)  # several blocks of references count as one
    anew = fitted.__wrapped__(rules=rules, calibrated_scores=True)
    assert anew.query(QUERIES) == pytest.approx(expected, rel=1e-3, abs=1e-3)


def test_a_place_that_hardly_answers_is_divided_by_a_hundredth_of_the_mean_spread_or_by_1() -> None:
    nothing = torch.zeros(1, 1)
    network = Network(torch.ones(1, 1, 1), nothing, nothing, (torch.tensor([[0.5, 0.5]]),), (torch.zeros(2),))
    for loud, least in ((0.0, 1.0), (4.0, 0.005)):
        sums = torch.tensor([0.0, loud], dtype=torch.float64)
        calibrated = network.calibrated(sums, 2 * sums, 4)  # of scores 0, 0, 2 and 2 the spread is 1
        found = asking([calibrated], PAPER).scores(np.array([[0.5]], np.float32))
        assert np.isfinite(found).all()
        assert found[0, 0] == pytest.approx(0.25 / least)


def test_an_ensemble_averages_scores_calibrated_member_by_member() -> None:
    members = [scores(calibrated_scores=True, seed=seed) for seed in (3, 4)]
    found = scores(VPRTempoEnsemble, members=2, seed=3, calibrated_scores=True)
    assert found == pytest.approx((members[0] + members[1]) / 2, rel=1e-4, abs=1e-4)


@pytest.mark.parametrize("rules", ["paper", "reference"])
def test_int8_scores_are_calibrated_as_those_of_the_float_network(rules: str) -> None:
    exact = scores(rules=rules, calibrated_scores=True)
    found = scores(VPRTempoInt8, rules=rules, calibrated_scores=True)
    assert np.abs(found - exact).max() < 0.25
    assert np.corrcoef(found.ravel(), exact.ravel())[0, 1] > 0.999


def test_the_linear_query_of_calibrated_networks_stays_one_affine_map() -> None:
    rules = replace(PAPER, query_rule="linear")
    members = [fitted(calibrated_scores=True, query_rule="linear", seed=seed)._members[0] for seed in (0, 1)]
    codes = fitted().encode(QUERIES)
    apart = [asking([member], rules).scores(codes) for member in members]
    assert asking(members, rules).scores(codes) == pytest.approx((apart[0] + apart[1]) / 2, rel=1e-4, abs=1e-4)


def test_the_calibration_is_stored_and_holds_for_the_way_of_asking_that_it_was_made_with() -> None:
    trained = fitted(calibrated_scores=True)
    assert set(trained.state()) - set(fitted().state()) == {"score_mean", "score_spread"}
    restored = VPRTempo(**SMALL, calibrated_scores=True).restore(trained.state())
    assert np.array_equal(restored.query(QUERIES), scores(calibrated_scores=True))
    for calibrated in (False, True):
        with pytest.raises(BadInput, match=f"set method.calibrated_scores={str(calibrated).lower()}"):
            VPRTempo(**SMALL, calibrated_scores=not calibrated).restore(fitted(calibrated_scores=calibrated).state())
    assert VPRTempo().query_arguments == {"engine", "query_rule", "silent_winner"}
    assert VPRTempo(calibrated_scores=True).query_arguments == {"engine"}
