"""Several VPRTempo networks of the same places: each is the one that its seed gives alone, and their scores' mean."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any, get_args

import numpy as np
import numpy.typing as npt
import pytest

from vprbench.api.images import Images
from vprbench.errors import BadInput, NotFittedError
from vprbench.methods.vprtempo.arguments import Engine
from vprbench.methods.vprtempo.ensemble import VPRTempoEnsemble
from vprbench.methods.vprtempo.method import VPRTempo
from vprbench.methods.vprtempo.rules import RuleSet
from vprbench.plugins.conformance import check
from vprbench.plugins.rules import RULES as CONFORMANCE
from vprbench.plugins.rules import Journey

Arrays = Mapping[str, npt.NDArray[np.float32]]

SMALL: dict[str, Any] = {"max_module": 8, "height": 12, "width": 12}  # modules of 8, 8 and 4 places
WORLD = Journey.draw(0)
QUERIES = Images.from_arrays(WORLD.queries)
RULES = pytest.mark.parametrize("rules", get_args(RuleSet))


def fit(method: VPRTempo) -> VPRTempo:
    return method.fit(Images.from_arrays(WORLD.references), WORLD.places)


def ensemble(members: int, **arguments: Any) -> VPRTempo:
    return fit(VPRTempoEnsemble(members=members, **{**SMALL, **arguments}))


@cache
def alone(seed: int, **arguments: Any) -> VPRTempo:
    return fit(VPRTempo(seed=seed, **{**SMALL, **arguments}))


def member(state: Arrays, number: int) -> Arrays:
    start = f"member_{number}."
    return {name.removeprefix(start): array for name, array in state.items() if name.startswith(start)}


def same(one: Arrays, other: Arrays) -> bool:
    return one.keys() == other.keys() and all(np.array_equal(array, other[name]) for name, array in one.items())


# --- training ---------------------------------------------------------------------------------------------------


@RULES
@pytest.mark.parametrize("engine", get_args(Engine))
def test_each_member_is_to_the_bit_the_network_that_vprtempo_trains_from_its_seed(
    rules: RuleSet, engine: Engine
) -> None:
    state = ensemble(3, rules=rules, engine=engine, seed=4).state()
    for number in range(3):
        assert same(member(state, number), alone(4 + number, rules=rules, engine=engine).state())


@pytest.mark.parametrize("max_module", [20, 10, 7], ids=["one module", "two alike", "a last one of 6"])
def test_members_of_any_modules_are_those_that_vprtempo_trains(max_module: int) -> None:
    state = ensemble(2, max_module=max_module).state()
    for number in range(2):
        assert same(member(state, number), alone(number, max_module=max_module).state())


def test_where_a_member_stands_among_the_others_changes_nothing_and_its_seed_does() -> None:
    two = ensemble(2, seed=0).state()
    assert same(member(two, 1), member(ensemble(3, seed=1).state(), 0))
    assert not np.allclose(member(two, 0)["features"], member(two, 1)["features"], atol=1e-3)


def test_members_may_differ_in_whether_all_their_synapses_exist() -> None:
    # At this probability some of the feature layers have all 41,472 excitatory synapses, others lack one or two.
    rare = {"p_excitatory": 0.99998, "max_module": 20}
    state = ensemble(4, **rare).state()
    for number in range(4):
        assert same(member(state, number), alone(number, **rare).state())


# --- scores -----------------------------------------------------------------------------------------------------


@RULES
@pytest.mark.parametrize("members", [1, 2, 3])
def test_the_scores_are_the_mean_of_those_of_the_members(rules: RuleSet, members: int) -> None:
    expected = np.mean([alone(seed, rules=rules).query(QUERIES).astype(np.float64) for seed in range(members)], axis=0)
    assert ensemble(members, rules=rules).query(QUERIES) == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("count", [1, 6], ids=["a single query", "a batch"])
def test_under_the_linear_rule_the_scores_are_those_of_the_mean_matrix(count: int) -> None:
    method = ensemble(3, rules="reference")
    matrix = np.zeros((20, 144))
    for number in range(3):
        arrays = {name: array.astype(np.float64) for name, array in member(method.state(), number).items()}
        matrix += np.concatenate([arrays[f"outputs_{m}"] @ arrays["features"][m] for m in range(3)]) / 3
    x = method.encode(QUERIES)[:count]
    assert method.match(x) == pytest.approx(x @ matrix.T, abs=1e-6)


@RULES
def test_one_member_scores_to_the_bit_and_is_stored_as_vprtempo(rules: RuleSet) -> None:
    single = ensemble(1, rules=rules, seed=3)
    assert np.array_equal(single.query(QUERIES), alone(3, rules=rules).query(QUERIES))
    assert same(single.state(), alone(3, rules=rules).state())


def test_an_ensemble_of_linear_networks_keeps_the_contract_too() -> None:
    config = {"_target_": "vprbench.methods.vprtempo.ensemble.VPRTempoEnsemble", "rules": "reference"}
    results = list(check(config))
    assert [result.rule for result in results] == list(CONFORMANCE)
    assert [str(result) for result in results if result.state != "kept"] == []


# --- stored and restored ----------------------------------------------------------------------------------------


def empty(members: int) -> VPRTempo:
    return VPRTempoEnsemble(members=members, **SMALL)


@RULES
@pytest.mark.parametrize("members", [1, 3])
def test_a_restored_ensemble_answers_to_the_bit_as_the_trained_one(members: int, rules: RuleSet) -> None:
    trained = ensemble(members, rules=rules)
    restored = VPRTempoEnsemble(members=members, rules=rules, **SMALL).restore(trained.state())
    assert same(restored.state(), trained.state())
    assert np.array_equal(restored.query(QUERIES), trained.query(QUERIES))


def test_more_than_ten_members_keep_their_order() -> None:
    state = ensemble(12, max_module=20, epochs=1).state()
    assert same(empty(12).restore(state).state(), state)


@pytest.mark.parametrize(("stored", "wanted"), [(2, 3), (3, 2), (1, 2), (2, 1)])
def test_another_number_of_members_is_refused_with_both_numbers(stored: int, wanted: int) -> None:
    state = ensemble(stored).state()
    with pytest.raises(BadInput, match=rf"\b{stored} members; wanted {wanted}\b"):
        empty(wanted).restore(state)


@pytest.mark.parametrize("name", ["features", "outputs_1", "output_thresholds_2"])
@pytest.mark.parametrize("number", [0, 1])
def test_an_array_that_one_member_lacks_is_named(name: str, number: int) -> None:
    state = dict(ensemble(2).state())
    del state[f"member_{number}.{name}"]
    with pytest.raises(BadInput, match=name):
        empty(2).restore(state)


def test_an_ensemble_that_could_not_be_restored_answers_nothing() -> None:
    method = ensemble(2)
    spoilt = dict(method.state())
    spoilt["member_1.constant"] = np.zeros((3, 5), np.float32)
    with pytest.raises(BadInput, match="constant"):
        method.restore(spoilt)
    with pytest.raises(NotFittedError):
        method.query(QUERIES)
    with pytest.raises(NotFittedError):
        method.state()


def test_members_of_different_numbers_of_places_are_refused() -> None:
    state = {**ensemble(2).state(), **{f"member_1.{name}": a for name, a in alone(0, max_module=10).state().items()}}
    del state["member_1.outputs_2"], state["member_1.output_thresholds_2"]
    assert same(member(state, 1), alone(0, max_module=10).state())
    for part in ("outputs_1", "output_thresholds_1"):
        state[f"member_1.{part}"] = state[f"member_1.{part}"][:-1]
    with pytest.raises(BadInput, match="different numbers of places"):
        empty(2).restore(state)


# --- refusals ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "value"), [("members", 0), ("members", -1), ("epochs", 0)])
def test_arguments_under_which_there_is_no_ensemble_are_refused_by_name(name: str, value: int) -> None:
    with pytest.raises(BadInput, match=rf"method\.{name}={value}: give at least 1"):
        ensemble(**{"members": 2, name: value})
