"""The conformance suite: every method found keeps the contract, and each rule catches what breaks it."""

from dataclasses import dataclass

import numpy as np
import pytest
from described_images import composed
from little import Prototypes

from vprbench.api.descriptor import DescriptorMethod
from vprbench.api.method import LayerSpikes
from vprbench.api.neural import NeuralDescriptor
from vprbench.plugins import registry
from vprbench.plugins.conformance import check_method
from vprbench.plugins.rules import RULES

ENTRIES = registry.find_entries("method")
# Published networks need files that no test can have: their tests write one of random values and ask the rules.
METHODS = [name for name, entry in ENTRIES.items() if not issubclass(entry.target(), NeuralDescriptor)]

# Slow ones, and other settings of networks that stand here already.
EXTENDED = {
    *("vprtempo_efficientnet", "vprtempo_efficientnet_int8"),
    *("vprtempo_efficientnet_aligned", "vprtempo_efficientnet_viewpoint"),
    *("densevlad", "cohog", "hyperdimensional", "hyperdimensional_oriented", "vprtempo_oriented_ensemble_int8"),
    *("vprtempo_tuned", "vprtempo_tuned_ensemble", "vprtempo_oriented_ensemble", "vprtempo_ensemble", "vprtempo_int8"),
    *("vprtempo_latencies", "vprtempo_oriented_latencies", "vprtempo_oriented_int8", "vprsnn_fast", "vprsnn_ensemble"),
}


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.extended] * (name in EXTENDED)) for name in METHODS]
)
def test_a_method_keeps_every_rule(name):
    results = list(check_method(composed(f"method={name}")))
    assert [str(result) for result in results if result.state == "broken"] == []
    assert {result.rule for result in results} >= {*RULES}


@dataclass
class Pixels(Prototypes):
    """A plain method that keeps every rule; the wrong ones below differ from it in one point."""

    noise: float = 0.0
    bins: int = 4

    def encode(self, images):
        """Average blocks of pixels."""
        grids = []
        for image in images:
            rows = np.array_split(image.astype(np.float32), self.bins, axis=0)
            grids.append([block.mean() for row in rows for block in np.array_split(row, self.bins, axis=1)])
        return np.array(grids, np.float32)

    def match(self, codes):
        """Compare with every place."""
        return -np.abs(codes[:, None] - Pixels.state(self)["means"]).mean(2)

    def extend(self, references, places):
        """Append the means of new places."""
        means, codes = Pixels.state(self)["means"], self.encode(references)
        self._means = np.concatenate([means, [codes[places == place].mean(0) for place in np.unique(places)]])
        return self


class ChangesArguments(Pixels):
    def __init__(self, bins=4):
        super().__init__(bins=bins + 1)


class Overwrites(Pixels):
    """Gives the same array of scores each time."""

    _given = np.empty((99, 99), np.float32)

    def match(self, codes):
        scores = super().match(codes)
        given = self._given[: len(scores), : scores.shape[1]]
        given[:] = scores
        return given


class FewCandidates(Pixels):
    """Of each query only the ten best places are candidates, also known ones in the place of new ones."""

    extends = False

    def match(self, codes):
        scores = super().match(codes)
        return np.where(scores >= np.sort(scores, axis=1)[:, -10, None], scores, np.float32(-np.inf))


class KeepsNoNetwork(DescriptorMethod):
    def encode(self, images):
        colours = np.array([image.mean(axis=(0, 1)) for image in images], np.float32).reshape(-1, 3)
        return colours / np.maximum(np.linalg.norm(colours, axis=1, keepdims=True), 1e-12)


def wrong(name, **methods):
    """Return a method that differs from Pixels in these, which the registry finds in this file."""
    return globals().setdefault(name, type(name, (Pixels,), methods))


def answering(name, alter):
    return wrong(name, match=lambda self, codes: alter(Pixels.match(self, codes), codes))


def encoding(name, alter):
    return wrong(name, encode=lambda self, images: alter(Pixels.encode(self, images), images))


def spiking(name, values):
    return wrong(name, spikes=lambda self, codes: [LayerSpikes("grid", values(codes))])


def growing(name, choose, added):
    """Return a method that adds to the mean of one place when it learns others."""

    def extend(method, references, places):
        Pixels.extend(method, references, places).state()["means"][choose(places)] += added
        return method

    return wrong(name, extend=extend)


def write_on(codes, images):
    for image in images:
        image[0, 0] = 0
    return codes


def fail_on_black(codes, images):
    if (codes.max(1) == 0).any():
        raise ValueError("log of zero")
    return codes


def answer_unfitted(method, codes):
    return np.zeros((len(codes), 20), np.float32) if method._means is None else Pixels.match(method, codes)


def count_on(codes):
    codes += 1
    return codes


BATCH = "a batch gives what its single images give"
ENCODES = "encode returns one array whose first axis is the image"
FORGETS = "fit forgets an earlier fit and returns the method"
GROWN = "places learnt after fit are scored and change no score of known ones"
REPEATED = "the same seed gives the same scores"
SPIKES = "spikes are counts or amplitudes by layer and query"
STORED = "a stored network answers as the trained one"
Random = answering("Random", lambda scores, _: scores + np.random.default_rng().random(1, np.float32))
EXCEPTIONS = dict.fromkeys((REPEATED, FORGETS, BATCH, STORED, GROWN), "it draws")
Excused = wrong("Excused", match=Random.match, conformance_exceptions=EXCEPTIONS)
ExcusedForNothing = wrong("ExcusedForNothing", conformance_exceptions={"no such rule": "because"})
Spikes = spiking("Spikes", np.round)

WRONG: dict[str, list[type[Pixels]]] = {
    "the constructor only stores its arguments": [ChangesArguments],
    ENCODES: [
        encoding("EncodesAList", lambda codes, _: list(codes)),
        wrong("FailsToFit", fit=lambda *given: Pixels.missing),
    ],
    FORGETS: [
        wrong("ReturnsNothing", fit=lambda *given: Pixels.fit(*given) and None),
    ],
    "query before fit raises NotFittedError": [wrong("AnswersUnfitted", match=answer_unfitted)],
    "arrays that were given or returned are never modified": [
        encoding("WritesOnImages", write_on),
        wrong("WritesOnCodes", match=lambda self, codes: Pixels.match(self, count_on(codes))),
        Overwrites,
    ],
    REPEATED: [Random],
    BATCH: [
        wrong("LooksAtTheBatch", match=lambda self, codes: Pixels.match(self, codes - codes.mean(0))),
    ],
    "scores are finite float32 of shape (n_queries, n_places)": [
        answering("NotFinite", lambda scores, _: np.where(np.arange(20) == 0, np.float32(np.nan), scores)),
    ],
    "higher scores mean more alike": [answering("Distance", lambda scores, _: -scores)],
    "black images and images of other sizes are accepted": [encoding("FailsOnBlack", fail_on_black)],
    STORED: [
        wrong("StoresRounded", state=lambda self: {name: a.round() for name, a in Pixels.state(self).items()}),
    ],
    GROWN: [growing("ForgetsThePast", lambda _: 0, 9), growing("LearnsNothing", min, -999)],
    SPIKES: [
        spiking("SpikesBelowZero", lambda codes: codes - 255),
    ],
}


def broken(method, **arguments):
    config = {"_target_": f"{__name__}.{method.__name__}", **arguments}
    return [result.rule for result in check_method(config) if result.state == "broken"]


def test_a_method_that_differs_in_nothing_that_matters_keeps_every_rule_and_each_rule_has_a_wrong_one():
    assert [broken(method) for method in (Pixels, FewCandidates, Spikes)] == [[]] * 3
    for index, neighbours in (("sq8", 5), ("hnsw", 100)):
        assert broken(KeepsNoNetwork, index=index, neighbours=neighbours) == []
    assert list(WRONG) == list(RULES)


@pytest.mark.parametrize(
    ("rule", "method"), [pytest.param(rule, method, id=method.__name__) for rule in WRONG for method in WRONG[rule]]
)
def test_the_rule_catches_what_breaks_it(rule, method):
    found = broken(method, **({"bins": 4} if method is ChangesArguments else {}))
    assert rule in found
    if rule in (ENCODES, STORED, SPIKES):
        assert found == [rule]


def test_exceptions_are_counted_with_their_reasons():
    excepted = [r for r in check_method({"_target_": f"{__name__}.Excused"}) if r.state == "excepted"]
    assert [r.reason for r in excepted] == ["it draws"] * 5
    excepted = [r for r in check_method({"_target_": f"{__name__}.KeepsNoNetwork"}) if r.state == "excepted"]
    assert [(result.rule, result.reason) for result in excepted] == [(STORED, "it keeps no network")]
    assert broken(ExcusedForNothing) == ["no such rule"]  # an exception from a rule that does not exist


def test_a_method_that_replaces_query_is_refused():
    with pytest.raises(TypeError, match="replaces query: write"):
        wrong("OneStep", query=lambda self, images: np.zeros((len(images), 20), np.float32))
