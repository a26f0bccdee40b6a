"""Costs of a query: operations by formulas and by PyTorch, bytes, and joules of a made-up powercap."""

import json
import sys
from types import SimpleNamespace

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
from vprbench.api.search import Search
from vprbench.cli import main
from vprbench.methods.binary import GaborBinary
from vprbench.methods.sad import SAD
from vprbench.methods.vprtempo.ensemble import VPRTempoEnsemble
from vprbench.methods.vprtempo.int8 import VPRTempoInt8
from vprbench.methods.vprtempo.method import VPRTempo
from vprbench.plugins.rules import Journey
from vprbench.runs import energy
from vprbench.runs.timing_lock import share_host

pytestmark = pytest.mark.usefixtures("surroundings")


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
    world, small = Journey.draw(0), {"max_module": 20, "height": 12, "width": 12}
    method = kind(**{**small, **arguments}).fit(Images.from_arrays(world.references), world.places)
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

    request = asked_for(Multiplying(np.eye(6, dtype=np.float32)), journey(6, 6))
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
    request = asked_for(Lookup(np.eye(6, dtype=np.float32)), journey(6, 6))
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
