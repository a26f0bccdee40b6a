"""What a run keeps of the layers of a network, spikes and readouts, and of a map that grows while queries come."""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from little import Lookup, journey
from little_runs import asked_for, kinds, run_of
from small_plan import RUN

from vprbench.api.images import Images
from vprbench.api.method import LayerSpikes
from vprbench.cli import main
from vprbench.errors import BadInput, NotFittedError
from vprbench.methods.pca import PCA
from vprbench.methods.sad import SAD
from vprbench.methods.vprtempo.ensemble import VPRTempoEnsemble
from vprbench.methods.vprtempo.int8 import VPRTempoInt8
from vprbench.methods.vprtempo.method import VPRTempo
from vprbench.plugins.rules import Journey
from vprbench.runs import runner
from vprbench.runs.notes import Note
from vprbench.runs.readouts import readout_numbers, readout_text
from vprbench.runs.run_files import content_key
from vprbench.runs.spikes import summary
from vprbench.runs.stream import grown, step

SMALL = {"max_module": 8, "height": 12, "width": 12}
TEN = ["dataset.places=10", "dataset.first_query_place=0", "frames=false", *RUN, "timing=none"]

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
    found = json.loads(json.dumps(summary([LayerSpikes("a", array), layer])))
    names = ("spikes_per_query", "active_share", "amplitude_mean", "synops", "operation")
    layer_known = {"name": "hidden", "neurons": array.shape[1], **dict(zip(names, known, strict=True))}
    assert (found["queries"], found["layers"][0]["name"], found["layers"][1:]) == (2, "a", [layer_known])
    assert summary([]) is None


def test_impossible_spikes_are_refused_by_the_name_of_the_layer():
    impossible = [[np.array([[1.0, wrong]])] for wrong in (np.nan, np.inf, -0.5)]
    for layers in ([np.ones((2, 3)), np.ones((3, 3))], [np.ones(3)], *impossible):
        with pytest.raises(BadInput, match="input"):
            summary([LayerSpikes("input", values) for values in layers])


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


TURNED = np.array([[1, 0], [0, 1], [-1, 0], [0.6, 0.8]], np.float32)  # what each picture looks like to the layer


@dataclass
class Layered(Lookup):
    """A lookup with codes of two numbers, and one layer that knows four directions and doubles the length."""

    lengths: Any = (2, 2, 2, 2)

    def encode(self, images):
        return np.array([[1, number] for number in super().encode(images)], np.float32)

    def match(self, codes):
        return self.table[codes[:, 1].astype(int)]

    def layers(self, codes):
        numbers = codes[:, 1].astype(int)
        turned = TURNED[numbers] * np.array(self.lengths)[numbers, None]
        return {"turned": turned, "silent": np.zeros((len(codes), 5))}


def read_run(method, dataset, **changes):
    return runner.run(asked_for(method, dataset, readouts=True, **changes), "key")


def test_codes_layers_and_answer_are_judged_by_the_same_right_places_and_a_place_by_its_most_similar_image():
    # By codes and by the turned layer each picture finds itself, which is right for the first and the last alone.
    dataset = journey(4, 4, [[0], [3], [0], [3]])
    method = Layered(np.array([[0, 1, 0, 0], [0, 0, 0, 1], [1, 0, 0, 0], [0, 1, 1, 0]], np.float32))
    found = readout_numbers(read_run(method, dataset))
    assert [(each["name"], each["neurons"], each["recall_at_1"]) for each in found] == [
        ("codes", 2, 0.5),
        ("turned", 2, 0.5),
        ("silent", 5, 0.25),  # four places tie for every query
        ("answer", 4, 0.5),
    ]
    # Wilson's interval of two hits in four.
    assert (found[0]["recall_at_1_low"], found[0]["recall_at_1_high"]) == pytest.approx((0.150, 0.850), abs=0.001)
    dataset = replace(journey(3, 4, [[0], [1], [0]]), places=np.array([0, 1, 0, 1]))
    run = read_run(Layered(np.zeros((3, 2), np.float32), lengths=(1, 2, 3, 4)), dataset)
    assert run.readouts[1] == {"name": "turned", "neurons": 2, "hits": [1.0, 1.0, 1.0]}


def test_readouts_are_stored_runs_of_earlier_versions_have_none_and_a_method_without_layers_says_so(store):
    failing = type("Failing", (Layered,), {"layers": lambda self, codes: {}["gone"]})
    dataset, table = journey(4, 4), np.eye(4, dtype=np.float32)
    read, plain = read_run(Layered(table), dataset), replace(run_of(Layered(table), dataset), key="other")
    earlier = [store.save(run) for run in (read, plain)][1] / "run.json"
    summary = json.loads(earlier.read_text())
    del summary["readouts"], summary["content_key"]  # as versions before wrote it
    earlier.write_text(json.dumps({**summary, "content_key": content_key(summary)}))
    assert {run.key: run.readouts for run in store.runs()} == {"key": read.readouts, "other": None}
    none, failed = read_run(Lookup(table), dataset), read_run(failing(table), dataset)
    assert (none.readouts, "readouts: none" in readout_text(none), "readouts" in kinds(none)) == ([], True, False)
    assert (failed.readouts, kinds(failed).count("readouts")) == (None, 1)
    assert Note("readouts", "no layer was read (KeyError: 'gone')") in failed.notes


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


def test_the_spikes_and_layers_of_vprtempo_are_those_of_eq_1_whatever_acts_on_scores_alone():
    method, codes = fitted(VPRTempo(**SMALL, seed=4))
    shown, features, outputs = method.spikes(codes)
    right = by_eq_1(dict(method.state()), codes)
    assert [layer.name for layer in (shown, features, outputs)] == ["input", "feature", "output"]
    assert {layer.kind for layer in (shown, features, outputs)} == {"amplitude"}
    for layer, known in zip((shown, features, outputs), (codes, *right), strict=True):
        assert layer.values == pytest.approx(known, abs=1e-5)
    assert 0 < np.count_nonzero(features.values) < features.values.size
    assert outputs.values == pytest.approx(method.match(codes), abs=1e-5)  # of one plain network they are its scores
    assert method.layers(codes)["feature"].tolist() == features.values.tolist()
    ensemble = fitted(VPRTempoEnsemble(**SMALL, seed=4, members=2))[0]  # its first network is shown
    calibrated = fitted(VPRTempo(**SMALL, seed=4, calibrated_scores=True))[0]
    for other in (VPRTempo(**SMALL).restore(method.state()), calibrated, ensemble):
        for layer, own in zip(other.spikes(codes), (shown, features, outputs), strict=True):
            assert layer.values == pytest.approx(own.values, abs=1e-5)
    second = fitted(VPRTempo(**SMALL, seed=5))[0].layers(codes)["feature"]
    assert ensemble.layers(codes)["feature"] == pytest.approx(np.hstack([features.values, second]), abs=1e-5)
    for ask in (VPRTempo(**SMALL).spikes, VPRTempo(**SMALL).layers):
        with pytest.raises(NotFittedError):
            ask(codes)


def test_layers_of_linear_quantised_and_component_methods_are_what_their_queries_pass():
    linear, codes = fitted(VPRTempo(**SMALL, query_rule="linear"))
    sums = np.einsum("np,mfp->nmf", codes, linear.state()["features"]).reshape(len(codes), -1)
    assert linear.layers(codes)["feature"] == pytest.approx(sums, abs=1e-4)
    assert [layer.name for layer in linear.spikes(codes)] == ["input"]
    method, codes = fitted(VPRTempoInt8(**SMALL))
    features, outputs = (layer.values for layer in method.spikes(codes)[1:])
    steps = features * 255 / 0.9
    assert steps == pytest.approx(np.rint(steps), abs=1e-3)
    assert outputs == pytest.approx(method.match(codes), abs=1e-5)
    assert features == pytest.approx(by_eq_1(dict(method.state()), codes)[0], abs=0.03)
    method, codes = fitted(PCA(components=5))
    references = method.layers(method.encode(Images.from_arrays(Journey.draw(0).references)))["components"]
    similarity = method.layers(codes)["components"] @ references.T
    best = np.maximum(similarity[:, :20], similarity[:, 20:])  # of both traverses
    assert method.match(codes) == pytest.approx(best, abs=1e-5)


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
    stops = grown(replace(asked_for(method, dataset), stream=2))
    assert [(stop["places"], stop["hits"], len(stop["seconds"])) for stop in stops] == [
        (2, [1.0, 1.0, 1.0], 0),
        (4, [0.0, 1.0, 0.0, 1.0], 2),
        (5, [0.0, 1.0, 1.0, 1.0], 1),
    ]
    given = [each for each in method.asked if each[0] < 0]
    assert given == [[-1, 0, 1, 1], [-2, 1, 2], [-2, 1, 3], [-2, 1, 4]]
    assert method.known == 0  # the run's own method is another


def asked(capsys, *options):
    assert main([*TEN, *options, "output=json"]) == 0
    return json.loads(capsys.readouterr().out)


def heads(capsys, *options):
    """Return the first words of the lines that the command prints."""
    assert main([*TEN, *options]) == 0
    return [line.split("  ")[0] for line in capsys.readouterr().out.splitlines()]


def test_readouts_are_a_table_below_the_row_and_a_list_in_json_and_stay_with_the_run(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert asked(capsys, "method=pca")["readouts"] is None
    made = asked(capsys, "method=pca", "readouts=true")
    assert made["from_store"] is False  # the stored run had none
    assert [each["name"] for each in made["readouts"]] == ["codes", "components", "answer"]
    for name in ("recall_at_1", "recall_at_1_low"):
        assert made["readouts"][2][name] == made[name]
    names = heads(capsys, "method=pca", "readouts=true")
    assert names[names.index("readout") :][:4] == ["readout", "codes, cosine", "components, cosine", "answer"]
    assert asked(capsys, "method=pca", "force=true")["readouts"] == made["readouts"]


@pytest.mark.extended
def test_a_growing_map_is_stored_with_its_run_and_printed(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert "stream" not in asked(capsys)
    made = asked(capsys, "stream=4")
    assert made["from_store"] is False  # the stored run had none
    assert [(stop["places"], stop["queries"]) for stop in made["stream"]] == [(4, 4), (8, 8), (10, 10)]
    assert made["stream"][-1]["recall_at_1"] == made["recall_at_1"]  # SAD learns the same one by one
    assert made["stream"][0]["recall_at_1"] == made["stream"][0]["recall_at_1_of_first"]
    names = heads(capsys, "stream=4")
    assert names[names.index("places") :][:4] == ["places", "4", "8", "10"]
    assert asked(capsys, "force=true")["from_store"] is False
    again = asked(capsys, "stream=4")
    assert (again["from_store"], again["stream"]) == (True, made["stream"])


def test_a_map_grows_by_the_places_asked_for_or_in_ten_stops_and_what_cannot_grow_is_refused():
    assert [step(asked, SAD(), 12) for asked in (False, 5, 11, True)] == [0, 5, 11, 2]
    for asked, method in ((12, SAD()), (-1, SAD()), (True, PCA())):
        with pytest.raises(BadInput, match="stream="):
            step(asked, method, 12)
