"""The conformance suite: every method found keeps the contract, and each rule catches what breaks it."""

from __future__ import annotations

import ast
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, ClassVar, Self

import numpy as np
import numpy.typing as npt
import pytest
from checkout import ROOT

from vprbench.api.arrays import Places, Scores
from vprbench.api.descriptor import DescriptorMethod
from vprbench.api.images import Images
from vprbench.api.method import LayerSpikes, Method
from vprbench.api.neural import NeuralDescriptor
from vprbench.errors import NotFittedError
from vprbench.plugins import registry
from vprbench.plugins.conformance import check
from vprbench.plugins.rules import RULES, Journey

ENTRIES = registry.entries("method")
# Published networks need files that no test can have: tests/methods/test_<name>.py writes one of random values.
NETWORKS = [name for name, entry in ENTRIES.items() if issubclass(entry.target(), NeuralDescriptor)]  # type: ignore[arg-type]
METHODS = [name for name in ENTRIES if name not in NETWORKS]


def configuration(name: str) -> dict[str, Any]:
    """The method's yaml with the run's own options filled in."""
    import hydra
    from omegaconf import OmegaConf

    with hydra.initialize_config_module("vprbench.conf", version_base="1.3"):
        config = hydra.compose("run", overrides=[f"method={name}"])
    return OmegaConf.to_container(config, resolve=True)["method"]  # type: ignore[index, call-overload, return-value]


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("name", METHODS)
def test_method_keeps_the_rule(name: str, rule: str) -> None:
    assert complaints(name)[rule] in ("", "excepted")


@cache
def complaints(name: str) -> dict[str, str]:
    """Put a method to all rules, once; by rule: nothing where it is kept, else what broke it."""
    results = check(configuration(name))
    return {result.rule: {"kept": "", "excepted": "excepted"}.get(result.state, str(result)) for result in results}


def test_the_rules_are_put_to_every_network_where_its_weights_are_written() -> None:
    tests = ROOT / "tests" / "methods"
    families = {ENTRIES[name].target().__module__.rpartition(".")[2] for name in NETWORKS}
    assert len(families) >= 9
    assert [f for f in sorted(families) if not puts_the_rules((tests / f"test_{f}.py").read_text("utf-8"))] == []


def puts_the_rules(text: str) -> bool:
    """Tell whether a test of a file calls conformance.check, or is put to all checks of published networks."""
    tests = [
        node
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.FunctionDef) and node.name.startswith("test_")
    ]
    calls = [node for test in tests for node in ast.walk(test) if isinstance(node, ast.Call)]
    return any(ast.unparse(call.func) in ("conformance.check", "with_checks") for call in calls)


@pytest.mark.parametrize(
    ("text", "puts"),
    [
        ("def test_rules():\n    assert list(conformance.check(config))", True),
        ("class TestRules:\n    def test_all(self):\n        conformance.check(config)", True),
        ("@with_checks(NETWORK)\ndef test_it(check):\n    check()", True),
        ("NETWORKS = with_checks(NETWORK)", False),
        ("def test_rules():\n    pass  # conformance.check(config)", False),
        ("def test_rules():\n    'conformance.check(config)'", False),
        ("def results():\n    return conformance.check(config)", False),
        ("def test_rules():\n    conformance.check", False),
    ],
)
def test_only_a_call_in_a_test_puts_the_rules(text: str, puts: bool) -> None:
    assert puts_the_rules(text) is puts


@dataclass
class Pixels(Method):
    """A plain method that keeps every rule; the wrong ones below differ from it in one point."""

    bins: int = 4

    _references: npt.NDArray[np.float32] | None = None

    def fit(self, references: Images, places: Places) -> Self:
        """Keep the references."""
        codes = self.encode(references)
        self._references = np.stack([codes[places == place].mean(0) for place in range(int(places.max()) + 1)])
        return self

    def encode(self, images: Images) -> npt.NDArray[np.float32]:
        """Average blocks of pixels."""
        grids = []
        for image in images:
            rows = np.array_split(image.astype(np.float32), self.bins, axis=0)
            grids.append([block.mean() for row in rows for block in np.array_split(row, self.bins, axis=1)])
        return np.array(grids, np.float32)

    def match(self, codes: npt.NDArray[np.float32]) -> Scores:
        """Compare with every place."""
        if self._references is None:
            raise NotFittedError("not fitted")
        return -np.abs(codes[:, None] - self._references).mean(2)

    def state(self) -> Mapping[str, npt.NDArray[np.float32]]:
        if self._references is None:
            raise NotFittedError("not fitted")
        return {"references": self._references}

    def restore(self, state: Mapping[str, npt.NDArray[np.float32]]) -> Self:
        self._references = state["references"]
        return self


class ChangesArguments(Pixels):
    def __init__(self, bins: int = 4) -> None:
        super().__init__(bins + 1)


class ReturnsNothing(Pixels):
    def fit(self, references: Images, places: Places) -> Self:
        super().fit(references, places)
        return None  # type: ignore[return-value]


class Remembers(Pixels):
    fits = 0

    def fit(self, references: Images, places: Places) -> Self:
        super().fit(references, places)
        self.fits += 1
        return self

    def match(self, codes: npt.NDArray[np.float32]) -> Scores:
        return super().match(codes) * self.fits


class AnswersUnfitted(Pixels):
    def match(self, codes: npt.NDArray[np.float32]) -> Scores:
        return super().match(codes) if self._references is not None else np.zeros((len(codes), 20), np.float32)


class WritesOnImages(Pixels):
    def encode(self, images: Images) -> npt.NDArray[np.float32]:
        for image in images:
            image[0, 0] = 0
        return super().encode(images)


class WritesOnCodes(Pixels):
    def match(self, codes: npt.NDArray[np.float32]) -> Scores:
        codes += 1
        return super().match(codes)


class Random(Pixels):
    def match(self, codes: npt.NDArray[np.float32]) -> Scores:
        return super().match(codes) + np.random.default_rng().random(1, np.float32)


class LooksAtTheBatch(Pixels):
    def match(self, codes: npt.NDArray[np.float32]) -> Scores:
        return super().match(codes - codes.mean(0))


class DependsOnOrder(Pixels):
    def match(self, codes: npt.NDArray[np.float32]) -> Scores:
        return super().match(codes) + np.arange(len(codes), dtype=np.float32)[:, None]


class DoublePrecision(Pixels):
    def match(self, codes: npt.NDArray[np.float32]) -> Scores:
        return super().match(codes).astype(np.float64)  # type: ignore[return-value]


class NotFinite(Pixels):
    def match(self, codes: npt.NDArray[np.float32]) -> Scores:
        scores = super().match(codes)
        scores[:, 0] = np.nan
        return scores


class Distance(Pixels):
    def match(self, codes: npt.NDArray[np.float32]) -> Scores:
        return -super().match(codes)


class ReadsNames(Pixels):
    def encode(self, images: Images) -> npt.NDArray[np.float32]:
        return super().encode(images) + np.array([[len(name)] for name in images.names], np.float32)


class FailsOnBlack(Pixels):
    def encode(self, images: Images) -> npt.NDArray[np.float32]:
        codes = super().encode(images)
        if (codes.max(1) == 0).any():
            raise ValueError("log of zero")
        return codes


class StoresRounded(Pixels):
    def state(self) -> Mapping[str, npt.NDArray[np.float32]]:
        return {name: array.round() for name, array in super().state().items()}


class KeepsTheEarlierFit(Pixels):
    def restore(self, state: Mapping[str, npt.NDArray[np.float32]]) -> Self:
        return super().restore(state) if self._references is None else self


class LosesWhatItStores(Pixels):
    def state(self) -> Mapping[str, npt.NDArray[np.float32]]:
        state = {"references": super().state()["references"].copy()}
        assert self._references is not None
        self._references[:] = 0
        return state


class StoresUnfitted(Pixels):
    def state(self) -> Mapping[str, npt.NDArray[np.float32]]:
        return {} if self._references is None else super().state()


class SpikesBelowZero(Pixels):
    def spikes(self, codes: npt.NDArray[np.float32]) -> list[LayerSpikes]:
        return [LayerSpikes("grid", codes - 255)]


class SpikesWithoutANumber(Pixels):
    def spikes(self, codes: npt.NDArray[np.float32]) -> list[LayerSpikes]:
        return [LayerSpikes("grid", codes * np.float32(np.nan))]


class SpikesOfAllQueriesTogether(Pixels):
    def spikes(self, codes: npt.NDArray[np.float32]) -> list[LayerSpikes]:
        return [LayerSpikes("grid", codes.sum(0))]


class SpikesOfTooFewQueries(Pixels):
    def spikes(self, codes: npt.NDArray[np.float32]) -> list[LayerSpikes]:
        return [LayerSpikes("grid", codes[1:])]


class LayersOfOneName(Pixels):
    def spikes(self, codes: npt.NDArray[np.float32]) -> list[LayerSpikes]:
        return [LayerSpikes("grid", codes), LayerSpikes("grid", codes)]


class CountsOnItsMap(Pixels):
    def spikes(self, codes: npt.NDArray[np.float32]) -> list[LayerSpikes]:
        assert self._references is not None
        self._references += 1
        return [LayerSpikes("grid", codes)]


class CountsOnTheCodes(Pixels):
    def spikes(self, codes: npt.NDArray[np.float32]) -> list[LayerSpikes]:
        codes += 1
        return [LayerSpikes("grid", codes)]


class Spikes(Pixels):
    def spikes(self, codes: npt.NDArray[np.float32]) -> list[LayerSpikes]:
        return [LayerSpikes("grid", codes.round()), LayerSpikes("bright", codes / 255, "amplitude")]


class KeepsNoNetwork(DescriptorMethod):
    def encode(self, images: Images) -> npt.NDArray[np.float32]:
        colours = np.array([image.mean(axis=(0, 1)) for image in images], np.float32).reshape(-1, 3)
        return colours / np.maximum(np.linalg.norm(colours, axis=1, keepdims=True), 1e-12)


class Overwrites(Pixels):
    """Gives the same array of scores each time, as far as it is long enough."""

    _given: Scores | None = None

    def match(self, codes: npt.NDArray[np.float32]) -> Scores:
        scores = super().match(codes)
        if self._given is None or len(self._given) < len(scores):
            self._given = scores
        self._given[: len(scores)] = scores
        return self._given[: len(scores)]


WRONG = {
    "the constructor only stores its arguments": ChangesArguments,
    "fit returns the method": ReturnsNothing,
    "fit forgets an earlier fit": Remembers,
    "query before fit raises NotFittedError": AnswersUnfitted,
    "inputs are never modified": WritesOnImages,
    "what was returned is never modified": Overwrites,
    "the same seed gives the same scores": Random,
    "a batch gives what its single images give": LooksAtTheBatch,
    "the order of queries does not matter": DependsOnOrder,
    "scores are finite float32 of shape (n_queries, n_places)": DoublePrecision,
    "higher scores mean more alike": Distance,
    "the names of images do not matter": ReadsNames,
    "black images and images of other sizes are accepted": FailsOnBlack,
    "a stored network answers as the trained one": StoresRounded,
    "spikes are counts or amplitudes by layer and query": SpikesBelowZero,
}
WRONG_SPIKES = (SpikesWithoutANumber, SpikesOfAllQueriesTogether, SpikesOfTooFewQueries, LayersOfOneName)
WRONG_SPIKES += (CountsOnItsMap, CountsOnTheCodes)


@pytest.fixture(autouse=True)
def importable(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the registry find the classes of this file."""
    import sys
    import types

    module = types.ModuleType("wrong_methods")
    others = (WritesOnCodes, NotFinite, KeepsTheEarlierFit, LosesWhatItStores, StoresUnfitted, KeepsNoNetwork)
    others += (FewCandidates, OtherCandidatesInABatch, NoCandidateAtAll, Spikes, *WRONG_SPIKES)
    for wrong in (Pixels, Excused, ExcusedForNothing, *others, *WRONG.values()):
        setattr(module, wrong.__name__, wrong)
    monkeypatch.setitem(sys.modules, "wrong_methods", module)


class Excused(Random):
    conformance_exceptions: ClassVar[Mapping[str, str]] = {
        "the same seed gives the same scores": "it draws",
        "fit forgets an earlier fit": "it draws",
        "a batch gives what its single images give": "it draws",
        "the order of queries does not matter": "it draws",
        "the names of images do not matter": "it draws",
        "a stored network answers as the trained one": "it draws",
    }


class ExcusedForNothing(Pixels):
    conformance_exceptions: ClassVar[Mapping[str, str]] = {"no such rule": "because"}


def broken(method: type[Method]) -> list[str]:
    return [r.rule for r in check({"_target_": f"wrong_methods.{method.__name__}"}) if r.state == "broken"]


def test_a_plain_method_keeps_every_rule() -> None:
    assert broken(Pixels) == []


def test_there_is_a_wrong_method_for_every_rule() -> None:
    assert list(WRONG) == list(RULES)


@pytest.mark.parametrize("rule", WRONG)
def test_the_rule_catches_what_breaks_it(rule: str) -> None:
    config = {"_target_": f"wrong_methods.{WRONG[rule].__name__}"}
    if WRONG[rule] is ChangesArguments:
        config["bins"] = 4  # type: ignore[assignment]
    assert rule in [result.rule for result in check(config) if result.state == "broken"]


def test_scores_that_are_not_finite_break_the_rule_on_scores() -> None:
    assert "scores are finite float32 of shape (n_queries, n_places)" in broken(NotFinite)


class FewCandidates(Pixels):
    """Of each query only the ten best places are candidates."""

    def match(self, codes: npt.NDArray[np.float32]) -> Scores:
        scores = super().match(codes)
        return np.where(scores >= np.sort(scores, axis=1)[:, -10, None], scores, np.float32(-np.inf))


class OtherCandidatesInABatch(FewCandidates):
    def match(self, codes: npt.NDArray[np.float32]) -> Scores:
        scores = super().match(codes)
        if len(codes) > 1:
            scores[scores == scores.min(where=scores > -np.inf, initial=np.inf)] = -np.inf
        return scores


class NoCandidateAtAll(Pixels):
    def match(self, codes: npt.NDArray[np.float32]) -> Scores:
        return np.full_like(super().match(codes), -np.inf)


def test_places_that_are_no_candidates_break_no_rule() -> None:
    assert broken(FewCandidates) == []


def test_other_candidates_in_a_batch_break_the_rule_on_batches_alone() -> None:
    assert broken(OtherCandidatesInABatch) == ["a batch gives what its single images give"]


def test_a_query_without_any_candidate_breaks_the_rule_on_scores() -> None:
    assert "scores are finite float32 of shape (n_queries, n_places)" in broken(NoCandidateAtAll)


@pytest.mark.parametrize("index", ["hnsw", "sq8"])
@pytest.mark.parametrize("neighbours", [5, 100])
def test_an_approximate_index_breaks_no_rule(neighbours: int, index: str) -> None:
    config = {"_target_": "wrong_methods.KeepsNoNetwork", "index": index, "neighbours": neighbours}
    assert [str(result) for result in check(config) if result.state == "broken"] == []


def test_changed_codes_break_the_rule_on_inputs() -> None:
    assert "inputs are never modified" in broken(WritesOnCodes)


def test_a_declared_exception_is_counted_with_its_reason() -> None:
    excepted = [r for r in check({"_target_": "wrong_methods.Excused"}) if r.state == "excepted"]
    assert {r.reason for r in excepted} == {"it draws"}
    assert len(excepted) == 6


@pytest.mark.parametrize("method", [KeepsTheEarlierFit, LosesWhatItStores, StoresUnfitted])
def test_the_rule_on_stored_networks_catches_a_method_that(method: type[Method]) -> None:
    assert broken(method) == ["a stored network answers as the trained one"]


def test_a_method_that_keeps_no_network_is_excepted_from_the_rule_on_stored_ones() -> None:
    excepted = [r for r in check({"_target_": "wrong_methods.KeepsNoNetwork"}) if r.state == "excepted"]
    assert [(r.rule, r.reason) for r in excepted] == [
        ("a stored network answers as the trained one", "it keeps no network")
    ]


@pytest.mark.parametrize("method", WRONG_SPIKES)
def test_the_rule_on_spikes_catches(method: type[Method]) -> None:
    assert broken(method) == ["spikes are counts or amplitudes by layer and query"]


def test_spikes_by_layer_and_query_break_no_rule() -> None:
    assert broken(Spikes) == []


def test_an_exception_from_a_rule_that_does_not_exist_is_broken() -> None:
    assert broken(ExcusedForNothing) == ["no such rule"]


def test_the_small_world_is_the_same_for_one_seed_only() -> None:
    first, again, other = Journey.draw(0), Journey.draw(0), Journey.draw(1)
    assert np.array_equal(first.references, again.references)
    assert not np.array_equal(first.references, other.references)


def test_a_method_that_replaces_query_is_refused() -> None:
    with pytest.raises(TypeError, match="replaces query: write"):

        class OneStep(Pixels):
            def query(self, images: Images) -> Scores:  # type: ignore[misc]
                return np.zeros((len(images), 20), np.float32)
