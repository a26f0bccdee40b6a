"""Records of the spikes of a network's layers, and of a map that grows while queries come."""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from little import Lookup, journey
from little_runs import asked_for, run_of

from vprbench.api.images import Images
from vprbench.api.method import LayerSpikes
from vprbench.errors import BadInput, NotFittedError
from vprbench.methods.pca import PCA
from vprbench.methods.sad import SAD
from vprbench.methods.vprtempo.ensemble import VPRTempoEnsemble
from vprbench.methods.vprtempo.method import VPRTempo
from vprbench.plugins.rules import Journey
from vprbench.runs.spikes import summarise_spikes
from vprbench.runs.stream import grow_map, parse_step

SMALL = {"max_module": 8, "height": 12, "width": 12}

pytestmark = pytest.mark.usefixtures("surroundings")


@pytest.mark.parametrize(
    ("values", "kind", "known"),
    [
        ([[2, 0, 1], [0, 0, 4]], "count", ([3.0, 4.0], 2 / 3, None, (2 * 1 + 1 * 3 + 4 * 3) / 2, "AC")),
        ([[0.5, 0, 0.25, 0], [0, 0, 0.75, 0]], "amplitude", ([2.0, 1.0], 0.5, 0.5, (1 + 3 + 3) / 2, "MAC")),
        ([[0, 0, 0], [0, 0, 0]], "amplitude", ([0.0, 0.0], 0.0, None, 0.0, "MAC")),
    ],
)
def test_counts_are_added_up_for_each_query_and_an_amplitude_is_one_spike(values, kind, known):
    array = np.array(values)
    layer = LayerSpikes("hidden", array, kind, fan_out=np.arange(1, array.shape[1] + 1))
    found = json.loads(json.dumps(summarise_spikes([LayerSpikes("a", array), layer])))
    names = ("spikes_per_query", "active_share", "amplitude_mean", "synops", "operation")
    layer_known = {"name": "hidden", "neurons": array.shape[1], **dict(zip(names, known, strict=True))}
    assert (found["queries"], found["layers"][0]["name"], found["layers"][1:]) == (2, "a", [layer_known])
    assert summarise_spikes([]) is None


@dataclass
class Ticking(Lookup):
    """A lookup whose one layer spikes as often as the number of the query; remembers what it was asked for."""

    spiking: Callable[[Any], Any] = lambda codes: codes
    counted: Sequence[int] = ()

    def spikes(self, codes):
        self.counted = codes.tolist()
        return [LayerSpikes("tick", self.spiking(codes)[:, None])]


SIX = np.eye(6, dtype=np.float32)


def test_spikes_that_cannot_be_counted_or_cannot_be_lose_no_run():
    for spiking, told in (
        (lambda codes: {}["the layer\nis gone"], r"(KeyError: 'the layer\nis gone')"),
        (lambda codes: -1.0 - codes, "BadInput"),
    ):
        run = run_of(Ticking(SIX, spiking=spiking), journey(6, 6))
        assert (run.spikes, run.outcome.above.tolist()) == (None, [0] * 6)
        (said,) = (note.text for note in run.notes if note.kind == "spikes")
        assert told in said


def test_a_run_keeps_the_spikes_of_every_query_if_they_are_few_and_else_of_256_from_the_first_to_the_last(store):
    run = run_of(Ticking(SIX), journey(6, 6))
    assert run.spikes["layers"][0]["spikes_per_query"] == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]
    store.save(run)
    assert [back.spikes for back in store.runs()] == [run.spikes]
    method = Ticking(np.zeros((1000, 4), np.float32))
    many = run_of(method, journey(1000, 4)).spikes
    assert (many["queries"], method.counted[0], method.counted[-1]) == (256, 0, 999)
    assert set(np.diff(method.counted)) == {3, 4}
    assert run_of(Lookup(SIX), journey(6, 6)).spikes is None


def test_counting_takes_no_part_in_what_a_run_times(clock):
    class Slow(Ticking):
        def encode(self, images):
            clock.spend(0.001 * len(images))
            return super().encode(images)

    run = run_of(Slow(SIX, spiking=lambda codes: clock.spend(1000) or codes), journey(6, 6))
    assert clock.seconds() > 1000
    assert (run.harness_seconds, run.method_seconds) == pytest.approx((0, 0.007))  # the first query is asked twice
    assert run.timing.streaming.total_seconds == pytest.approx([0.001] * 6)


def fitted(method):
    world = Journey.draw(0)
    method.fit(Images.from_arrays(world.references), world.places)
    return method, method.encode(Images.from_arrays(world.queries))


def by_eq_1(state, codes):
    """Return the feature and output spikes of a stored network for each query, in float64."""
    features, outputs = [], []
    layers = zip(state["features"], state["constant"], state["feature_thresholds"], strict=True)
    for module, (weights, constants, thresholds) in enumerate(layers):
        features.append(np.clip(codes.astype(np.float64) @ weights.T + constants - thresholds, 0, 0.9))
        above = features[-1] @ state[f"outputs_{module}"].T - state[f"output_thresholds_{module}"]
        outputs.append(np.clip(above, 0, 0.9))
    return np.hstack(features), np.hstack(outputs)


def test_the_spikes_of_vprtempo_are_those_of_eq_1_whatever_acts_on_scores_alone():
    method, codes = fitted(VPRTempo(**SMALL, seed=4))
    shown, features, outputs = method.spikes(codes)
    right = by_eq_1(dict(method.state()), codes)
    assert [layer.name for layer in (shown, features, outputs)] == ["input", "feature", "output"]
    assert {layer.kind for layer in (shown, features, outputs)} == {"amplitude"}
    for layer, known in zip((shown, features, outputs), (codes, *right), strict=True):
        assert layer.values == pytest.approx(known, abs=1e-5)
    assert 0 < np.count_nonzero(features.values) < features.values.size
    assert outputs.values == pytest.approx(method.match(codes), abs=1e-5)  # of one plain network they are its scores
    ensemble = fitted(VPRTempoEnsemble(**SMALL, seed=4, members=2))[0]  # its first network is shown
    calibrated = fitted(VPRTempo(**SMALL, seed=4, calibrated_scores=True))[0]
    for other in (VPRTempo(**SMALL).restore(method.state()), calibrated, ensemble):
        for layer, own in zip(other.spikes(codes), (shown, features, outputs), strict=True):
            assert layer.values == pytest.approx(own.values, abs=1e-5)
    with pytest.raises(NotFittedError):
        VPRTempo(**SMALL).spikes(codes)


@dataclass
class Growing(Lookup):
    """A lookup that scores as many places as it was given, and notes what it was given."""

    known: int = 0

    def fit(self, references, places):
        self.asked.append([-1, *places.tolist()])
        self.known = int(places.max()) + 1
        return self

    def extend(self, references, places):
        self.asked.append([-2, len(references), *places.tolist()])
        self.known += 1
        return self

    def match(self, codes):
        return self.table[codes, : self.known]


def test_each_stop_of_a_growing_map_asks_the_queries_whose_place_is_known():
    # Places are right for queries 0, 1, (1 or 4), 3 and none; query 0 is lost once place 3 is there.
    dataset = journey(5, 5, [[0], [1], [1, 4], [3], []])
    dataset = replace(dataset, references=dataset.references[np.array([0, 1, 2, 3, 4, 1])], places=np.r_[0:5, 1])
    table = np.array([[5, 0, 0, 9, 0], [0, 5, 0, 0, 0], [0, 3, 5, 0, 9], [0, 0, 0, 5, 0], [1, 1, 1, 1, 1]], np.float32)
    method = Growing(table)
    stops = grow_map(replace(asked_for(method, dataset), stream=2))
    names = ("places", "queries", "recall_at_1", "recall_at_1_of_first")
    assert [tuple(stop[name] for name in names) for stop in stops] == [
        (2, 3, 1.0, 1.0),
        (4, 4, 0.5, pytest.approx(1 / 3)),
        (5, 4, 0.75, pytest.approx(2 / 3)),
    ]
    assert [stop["seconds_a_place"] is None for stop in stops] == [True, False, False]
    given = [each for each in method.asked if each[0] < 0]
    assert given == [[-1, 0, 1, 1], [-2, 1, 2], [-2, 1, 3], [-2, 1, 4]]
    assert method.known == 0  # the run's own method is another


def test_a_map_grows_by_the_places_asked_for_or_in_ten_stops_and_what_cannot_grow_is_refused():
    assert [parse_step(asked, SAD(), 12) for asked in (False, 5, 11, True)] == [0, 5, 11, 2]
    for asked, method in ((12, SAD()), (-1, SAD()), (True, PCA())):
        with pytest.raises(BadInput, match="stream="):
            parse_step(asked, method, 12)
