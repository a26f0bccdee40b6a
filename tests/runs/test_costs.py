"""What a query costs: spikes of layers, operations by formulas and by PyTorch, bytes, joules; and maps that grow."""

import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from little import Lookup, journey
from little_runs import asked_for, run_of
from little_vprsnn import fitted as fitted_vprsnn
from little_vprsnn import references
from torch.utils.flop_counter import FlopCounterMode

from vprbench.api.arithmetic import counting_operations
from vprbench.api.images import Images
from vprbench.api.method import LayerSpikes
from vprbench.api.search import Search
from vprbench.cli import main
from vprbench.errors import BadInput, NotFittedError
from vprbench.methods.binary import GaborBinary
from vprbench.methods.pca import PCA
from vprbench.methods.sad import SAD
from vprbench.methods.vprtempo.ensemble import VPRTempoEnsemble
from vprbench.methods.vprtempo.int8 import VPRTempoInt8
from vprbench.methods.vprtempo.method import VPRTempo
from vprbench.plugins.rules import Journey
from vprbench.runs import energy
from vprbench.runs.spikes import summarise_spikes
from vprbench.runs.stream import grow_map, parse_step
from vprbench.runs.timing_lock import share_host

pytestmark = pytest.mark.usefixtures("surroundings")

SIX = np.eye(6, dtype=np.float32)
SMALL = {"max_module": 20, "height": 12, "width": 12}


def told(work):
    """Return the multiply-adds, the single operations and the kinds of numbers that are told of some work."""
    with counting_operations() as found:
        work()
    return sum(each.multiply_adds for each in found), sum(each.single for each in found), {each.kind for each in found}


def costs_of(request, run=None):
    run = run or run_of(request.method, request.dataset)
    with share_host() as lock:
        return energy.find_costs(request, run, lock)


def fitted(kind=VPRTempo, **arguments):
    world = Journey.draw(0)
    method = kind(**{**SMALL, **arguments}).fit(Images.from_arrays(world.references), world.places)
    return method, method.encode(Images.from_arrays(world.queries))


def test_formulas_of_sad_products_and_binary_maps_agree_with_a_count():
    images = Images.from_arrays(Journey.draw(0).references)
    method = SAD(height=8, width=8, patch=3).fit(images[:5], np.arange(5))
    codes = method.encode(images[:1])
    assert told(lambda: method.match(codes)) == (0, 3 * 5 * 64, {"int8"})
    # 16 of the resize and 9 of the window's deviation; 12, two a pixel of the window, and seven
    assert told(lambda: method.encode(images[:2])) == (2 * 64 * 25, 2 * 64 * 37, {"float32"})
    assert method.map_bytes() == 5 * 64
    known, asked = torch.rand(11, 7), torch.rand(3, 7)
    with FlopCounterMode(display=False) as counter:
        torch.mm(asked, known.T)
    search = Search(known.numpy(), np.arange(11))
    assert 2 * told(lambda: search.scores(asked.numpy()))[0] == counter.get_total_flops() > 0
    words, binary = np.ones((4, 2), np.uint64), GaborBinary()
    binary.known = words, np.arange(4)
    assert told(lambda: binary.match(words[:1])) == (0, 3 * 4 * 2, {"int64"})


@pytest.mark.parametrize(("kind", "numbers"), [(VPRTempo, "float32"), (VPRTempoInt8, "int8")])
@pytest.mark.parametrize(("query_rule", "neurons"), [("spiking", 308), ("linear", 20)])
def test_a_query_of_vprtempo_multiplies_every_weight_once(kind, numbers, query_rule, neurons):
    method, codes = fitted(kind, query_rule=query_rule)
    weights = 144 * 288 + 288 * 20 if query_rule == "spiking" else 144 * 20
    assert told(lambda: method.match(codes[:1])) == (weights, 0, {numbers})
    assert method.map_bytes() == (None if numbers == "float32" else weights + 8 * neurons)


def test_spikes_reach_every_synapse_that_exists_in_all_networks_and_modules():
    single, codes = fitted()
    several, _ = fitted(VPRTempoEnsemble, members=3)
    (_, one, _), (inputs, three, _) = single.spikes(codes), several.spikes(codes)
    assert np.array_equal(three.fan_out, 3 * one.fan_out)
    exist = [np.count_nonzero(several.state()[f"member_{n}.features"], axis=(0, 1)) for n in range(3)]
    assert np.array_equal(inputs.fan_out, np.sum(exist, axis=0))
    (linear,) = fitted(query_rule="linear")[0].spikes(codes)
    assert linear.fan_out.tolist() == [20] * 144

    method = fitted_vprsnn(10)
    codes = method.encode(references(10)[0][:2])
    shown, excitatory, inhibitory = method.spikes(codes)
    weights = method.state()["weights"]  # (n_modules, n_inputs, n_neurons)
    assert np.array_equal(shown.fan_out, np.count_nonzero(weights, axis=(0, 2)))
    assert set(excitatory.fan_out) == {1}  # its inhibitory neuron
    assert set(inhibitory.fan_out) == {23}  # all excitatory neurons but its own
    steps = round(350 / method.time_step_ms)
    arrivals = float((shown.values.sum(1) * 2 * 24).sum())
    assert told(lambda: method.match(codes)) == (2 * 3 * steps * 48, 2 * 6 * steps * 48 + arrivals, {"float64"})


def test_what_pytorch_does_is_counted_a_step_without_a_formula_is_not_available_and_a_failure_keeps_the_run(
    monkeypatch,
):
    class Multiplying(Lookup):
        def match(self, codes):
            torch.zeros(len(codes), 10) @ torch.zeros(10, 50)
            return super().match(codes)

    request = asked_for(Multiplying(SIX), journey(6, 6))
    run = run_of(request.method, request.dataset)
    found = costs_of(request, run)
    assert found["values"] == dict.fromkeys(found["values"])
    assert ("encode" in found["how"]["operations"], "match" in found["how"]["operations"]) == (True, False)
    monkeypatch.setattr(Lookup, "encode", lambda *_: {}["gone"])
    monkeypatch.setattr(Lookup, "state", lambda _: {"a": np.zeros(7, np.float32), "b": np.zeros((4, 5))})
    found = costs_of(request, run)
    assert "KeyError" in found["how"]["operations"]
    assert found["values"]["map_bytes"] == pytest.approx((7 * 4 + 20 * 8) / 6)
    monkeypatch.setattr(Multiplying, "map_bytes", lambda _: 60)
    assert costs_of(request, run)["values"]["map_bytes"] == 10


@pytest.mark.extended
def test_costs_are_asked_for_stored_and_shown(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(energy, "POWERCAP", tmp_path / "none")
    small = ["dataset.places=10", "dataset.first_query_place=4", "threads=1", "timing=none", "frames=false"]

    def said(*options):
        assert main(["method=sad", *small, *options]) == 0
        return capfd.readouterr().out

    assert "energy" not in json.loads(said("output=json"))
    for option, there in (("energy=true", False), ("metrics=[energy]", True)):
        found = json.loads(said(option, "output=json"))
        assert (found["from_store"], found["energy"]["values"]["joules_measured"]) == (there, None)
        assert found["energy"]["values"]["map_bytes"] == 2 * 28 * 28  # two references of each place
    assert found["operations"] == found["energy"]["values"]["operations"] > 3 * 20 * 28 * 28
    assert "n/a" in said("energy=true")


def powercap(root, **microjoules):
    """Make counters `package`, `dram` and `core`, up to a joule, as Linux has them: the last is part of the first."""
    for zone, (name, value) in enumerate(microjoules.items()):
        folder = root / ("intel-rapl:0" if name == "package" else f"intel-rapl:0:{zone}")
        folder.mkdir(parents=True, exist_ok=True)
        values = {"name": "package-0" if name == "package" else name, "max_energy_range_uj": 1_000_000}
        for file, text in {**values, "energy_uj": value}.items():
            (folder / file).write_text(f"{text}\n")
    return root


@pytest.mark.parametrize(("query", "watts", "known"), [(0.5, 30, 10), (7, 10, 0)])  # 7 s: longer than the window
def test_idle_power_is_subtracted_from_the_joules_of_queries_over_a_wrap(query, watts, known, monkeypatch):
    state = np.array([0.0, 100.0])  # seconds and joules

    def passes(seconds, watts=10):
        state[:] += seconds, seconds * watts

    def read():
        return [(round(1e6 * state[1]) % 130_000_000, 130_000_000)]  # 130 J are over in the middle

    monkeypatch.setattr(energy, "time", SimpleNamespace(perf_counter=lambda: state[0], sleep=passes))
    assert energy.measure_joules(read, lambda: passes(query, watts)) == pytest.approx(known)


def test_package_and_memory_are_read_and_not_what_lies_within_and_a_counter_that_cannot_be_read_is_a_reason(
    tmp_path, monkeypatch
):
    found = energy.read_rapl(powercap(tmp_path / "some", package=900_000, dram=10, core=5))
    assert sorted(found) == [(10, 1_000_000), (900_000, 1_000_000)]
    request = asked_for(Lookup(SIX), journey(6, 6))
    for counters in ({"core": 5}, {"package": "denied"}):
        monkeypatch.setattr(energy, "POWERCAP", powercap(tmp_path / str(*counters), **counters))
        found = costs_of(request)
        assert (found["values"]["joules_measured"], "Error" in found["how"]["joules_measured"]) == (None, True)


def test_the_counter_of_a_gpu_is_found_by_its_uuid(monkeypatch):
    stand_in = SimpleNamespace(
        nvmlInit=lambda: None,
        nvmlDeviceGetHandleByUUID={"GPU-abc": 7}.get,
        nvmlDeviceGetTotalEnergyConsumption={7: 1234}.get,
    )
    monkeypatch.setitem(sys.modules, "pynvml", stand_in)
    monkeypatch.setattr(torch.cuda, "get_device_properties", lambda _: SimpleNamespace(uuid="abc"))
    assert energy.read_nvml("cuda") == [(1_234_000, 1 << 64)]


def test_counts_are_added_up_for_each_query_and_an_amplitude_is_one_spike():
    for values, kind, known in (
        ([[2, 0, 1], [0, 0, 4]], "count", ([3.0, 4.0], 2 / 3, None, (2 * 1 + 1 * 3 + 4 * 3) / 2, "AC")),
        ([[0.5, 0, 0.25, 0], [0, 0, 0.75, 0]], "amplitude", ([2.0, 1.0], 0.5, 0.5, (1 + 3 + 3) / 2, "MAC")),
        ([[0, 0, 0], [0, 0, 0]], "amplitude", ([0.0, 0.0], 0.0, None, 0.0, "MAC")),
    ):
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
    method, codes = fitted(seed=4, max_module=8)
    shown, features, outputs = method.spikes(codes)
    right = by_eq_1(dict(method.state()), codes)
    assert [layer.name for layer in (shown, features, outputs)] == ["input", "feature", "output"]
    assert {layer.kind for layer in (shown, features, outputs)} == {"amplitude"}
    for layer, known in zip((shown, features, outputs), (codes, *right), strict=True):
        assert layer.values == pytest.approx(known, abs=1e-5)
    assert 0 < np.count_nonzero(features.values) < features.values.size
    assert outputs.values == pytest.approx(method.match(codes), abs=1e-5)  # of one plain network they are its scores
    ensemble = fitted(VPRTempoEnsemble, seed=4, max_module=8, members=2)[0]  # its first network is shown
    calibrated = fitted(seed=4, max_module=8, calibrated_scores=True)[0]
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
