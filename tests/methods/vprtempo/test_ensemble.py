"""Several VPRTempo networks of the same places: each is the one that its seed gives alone, and their scores' mean."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, get_args

import numpy as np
import numpy.typing as npt
import pytest
from tempo_networks import QUERIES, RULE_SETS, SMALL, fitted

from vprbench.errors import BadInput, NotFittedError
from vprbench.methods.vprtempo.arguments import Engine
from vprbench.methods.vprtempo.ensemble import VPRTempoEnsemble
from vprbench.methods.vprtempo.method import VPRTempo
from vprbench.methods.vprtempo.rules import RuleSet

Arrays = Mapping[str, npt.NDArray[np.float32]]


def empty(members: int, **arguments: Any) -> VPRTempo:
    return VPRTempoEnsemble(members=members, **{**SMALL, **arguments})


def ensemble(members: int, **arguments: Any) -> VPRTempoEnsemble:
    return fitted(VPRTempoEnsemble, members=members, **arguments)


def alone(seed: int, **arguments: Any) -> VPRTempo:
    return fitted(seed=seed, **arguments)


def member(state: Arrays, number: int) -> Arrays:
    start = f"member_{number}."
    return {name.removeprefix(start): array for name, array in state.items() if name.startswith(start)}


def same(one: Arrays, other: Arrays) -> bool:
    return one.keys() == other.keys() and all(np.array_equal(array, other[name]) for name, array in one.items())


@pytest.mark.parametrize(
    "arguments",
    [
        *({"rules": rules, "engine": engine} for rules in get_args(RuleSet) for engine in get_args(Engine)),
        {"max_module": 7},
        # At this probability some of the feature layers have all 41,472 excitatory synapses, others lack one or two.
        {"p_excitatory": 0.99998, "max_module": 20},
    ],
    ids=str,
)
def test_each_member_is_to_the_bit_the_network_that_vprtempo_trains_from_its_seed(arguments: dict[str, Any]) -> None:
    state = ensemble(3, **arguments).state()
    for number in range(3):
        assert same(member(state, number), alone(number, **arguments).state())
    assert not np.allclose(member(state, 0)["features"], member(state, 1)["features"], atol=1e-3)


@RULE_SETS
@pytest.mark.parametrize("members", [1, 3])
def test_the_scores_are_the_mean_of_those_of_the_members_also_when_restored(rules: RuleSet, members: int) -> None:
    trained = ensemble(members, rules=rules, seed=1)
    expected = np.mean([alone(1 + n, rules=rules).query(QUERIES).astype(np.float64) for n in range(members)], axis=0)
    assert trained.query(QUERIES) == pytest.approx(expected, abs=1e-6)
    restored = empty(members, rules=rules).restore(trained.state())
    assert same(restored.state(), trained.state())
    assert np.array_equal(restored.query(QUERIES), trained.query(QUERIES))
    if members == 1:
        assert np.array_equal(trained.query(QUERIES), alone(1, rules=rules).query(QUERIES))
        assert same(trained.state(), alone(1, rules=rules).state())


@pytest.mark.parametrize(("stored", "wanted"), [(2, 3), (3, 2), (1, 2), (2, 1)])
def test_another_number_of_members_is_refused_with_both_numbers(stored: int, wanted: int) -> None:
    with pytest.raises(BadInput, match=rf"\b{stored} members; wanted {wanted}\b"):
        empty(wanted).restore(ensemble(stored).state())
    many = ensemble(12, max_module=20, epochs=1).state()  # more than ten keep their order
    assert same(empty(12).restore(many).state(), many)


def test_members_that_lack_an_array_or_know_other_places_are_refused_and_leave_no_network() -> None:
    whole = ensemble(2).state()
    for lacking in ("member_0.features", "member_1.outputs_1", "member_1.output_thresholds_2"):
        with pytest.raises(BadInput, match=lacking.split(".")[1]):
            empty(2).restore({name: array for name, array in whole.items() if name != lacking})
    fewer = {name: whole[name][:-1] for name in ("member_1.outputs_1", "member_1.output_thresholds_1")}
    method = empty(2).restore(whole)
    with pytest.raises(BadInput, match="different numbers of places"):
        method.restore({**whole, **fewer})
    with pytest.raises(NotFittedError):
        method.query(QUERIES)


@pytest.mark.parametrize(("name", "value"), [("members", 0), ("epochs", 0)])
def test_arguments_under_which_there_is_no_ensemble_are_refused_by_name(name: str, value: int) -> None:
    with pytest.raises(BadInput, match=rf"method\.{name}={value}: give at least 1"):
        ensemble(**{"members": 2, name: value})
