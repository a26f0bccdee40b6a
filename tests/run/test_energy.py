"""Costs of a query: operations by formulas and by PyTorch, synaptic operations as NeuroBench has them, bytes."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import torch
from little import Lookup, journey
from little_runs import asked_for, run_of
from little_vprsnn import fitted as fitted_vprsnn
from little_vprsnn import references
from small_plan import RUN, install
from torch import nn
from torch.utils.flop_counter import FlopCounterMode

from vprbench.api.arithmetic import tallied
from vprbench.api.binary import BinaryMap
from vprbench.api.images import Images
from vprbench.api.method import Method
from vprbench.api.search import Search
from vprbench.cli import main
from vprbench.methods.sad import SAD
from vprbench.methods.vprtempo.ensemble import VPRTempoEnsemble
from vprbench.methods.vprtempo.int8 import VPRTempoInt8
from vprbench.methods.vprtempo.method import VPRTempo
from vprbench.plugins.rules import Journey
from vprbench.run import energy, joules
from vprbench.run.spikes import summary

SMALL: dict[str, Any] = {"max_module": 20, "height": 12, "width": 12}
ONE = ["method=sad", "dataset=synthetic", "dataset.places=20", "dataset.first_query_place=4", *RUN]

pytestmark = pytest.mark.usefixtures("surroundings")


def fitted(kind: type[VPRTempo] = VPRTempo, **arguments: Any) -> tuple[VPRTempo, npt.NDArray[np.float32]]:
    world = Journey.draw(0)
    method = kind(**{**SMALL, **arguments}).fit(Images.from_arrays(world.references), world.places)
    return method, method.encode(Images.from_arrays(world.queries))


def told(work: Callable[[], object]) -> tuple[float, float, set[str]]:
    """Return the multiply-adds, the single operations and the kinds of numbers that are told of some work."""
    with tallied() as found:
        work()
    return sum(each.multiply_adds for each in found), sum(each.single for each in found), {each.kind for each in found}


def test_a_query_of_sad_takes_three_operations_for_each_pixel_of_each_reference() -> None:
    images = Images.from_arrays(Journey.draw(0).references)
    method = SAD(height=8, width=8, patch=3).fit(images[:5], np.arange(5))
    codes = method.encode(images[:1])
    assert told(lambda: method.match(codes)) == (0, 3 * 5 * 64, {"int8"})
    # 16 of the resize and 9 of the window's deviation; 12, two a pixel of the window, and seven
    assert told(lambda: method.encode(images[:2])) == (2 * 64 * 25, 2 * 64 * 37, {"float32"})
    assert method.map_bytes() == 5 * 64


def test_a_formula_agrees_with_what_pytorch_counts_for_the_same_product() -> None:
    codes, references = torch.rand(3, 7), torch.rand(11, 7)
    with FlopCounterMode(display=False) as counter:
        torch.mm(codes, references.T)
    search = Search(references.numpy(), np.arange(11))
    assert 2 * told(lambda: search.scores(codes.numpy()))[0] == counter.get_total_flops() > 0
    words = np.ones((4, 2), np.uint64)
    assert told(lambda: BinaryMap(words, np.arange(4)).scores(words[:1])) == (0, 3 * 4 * 2, {"int64"})


@pytest.mark.parametrize(("kind", "numbers"), [(VPRTempo, "float32"), (VPRTempoInt8, "int8")])
@pytest.mark.parametrize("query_rule", ["spiking", "linear"])
def test_a_query_of_vprtempo_multiplies_every_weight_once(kind: type[VPRTempo], numbers: str, query_rule: str) -> None:
    method, codes = fitted(kind, query_rule=query_rule)
    weights = 144 * 288 + 288 * 20 if query_rule == "spiking" else 144 * 20
    assert told(lambda: method.match(codes[:1])) == (weights, 0, {numbers})
    neurons = 288 + 20 if query_rule == "spiking" else 20
    assert method.map_bytes() == (None if numbers == "float32" else weights + 8 * neurons)


def test_the_synaptic_operations_of_a_layer_are_those_that_neurobench_counts() -> None:
    pytest.importorskip("neurobench", reason="pip install neurobench --no-deps")
    from neurobench.metrics.workload import SynapticOperations
    from neurobench.models import TorchModel

    method, codes = fitted(p_excitatory=0.05, p_inhibitory=0.1)
    shown, features, outputs = method.spikes(codes)
    state = method.state()
    found = summary([shown, features, outputs])
    assert found is not None
    ours = [layer["synops"] for layer in found["layers"] if "synops" in layer]
    layers = [(state["features"][0], shown.values), (state["outputs_0"], features.values)]
    for (weights, spikes), synops in zip(layers, ours, strict=True):
        for values, kind in ((spikes, "Effective_MACs"), (np.sign(spikes), "Effective_ACs")):
            linear = nn.Linear(*weights.shape[::-1], bias=False)
            linear.weight.data = torch.from_numpy(weights)
            model, data = TorchModel(nn.Sequential(linear)), torch.from_numpy(values)
            model.register_hooks()
            counted = SynapticOperations()(model, model(data), (data, None))
            assert counted[kind] == pytest.approx(synops)
            assert 0 < synops < counted["Dense"] == weights.size
    assert [layer.get("operation") for layer in found["layers"]] == ["MAC", "MAC", None]


def test_every_network_of_an_ensemble_is_asked_and_a_linear_query_has_one_layer() -> None:
    single, codes = fitted()
    several, _ = fitted(VPRTempoEnsemble, members=3)
    (_, one, _), (inputs, three, _) = single.spikes(codes), several.spikes(codes)
    assert np.array_equal(three.fan_out, 3 * one.fan_out)
    states = several.state()
    exist = [np.count_nonzero(states[f"member_{n}.features"], axis=(0, 1)) for n in range(3)]
    assert np.array_equal(inputs.fan_out, np.sum(exist, axis=0))
    (linear,) = fitted(query_rule="linear")[0].spikes(codes)
    assert linear.fan_out.tolist() == [20] * 144


def test_spikes_of_vprsnn_reach_every_synapse_of_every_module() -> None:
    method = fitted_vprsnn(10)
    codes = method.encode(references(10)[0][:2])
    shown, excitatory, inhibitory = method.spikes(codes)
    weights = method.state()["weights"]  # (n_modules, n_inputs, n_neurons)
    assert np.array_equal(shown.fan_out, np.count_nonzero(weights, axis=(0, 2)))
    assert set(excitatory.fan_out) == {1}  # its inhibitory neuron
    assert set(inhibitory.fan_out) == {23}  # all excitatory neurons but its own
    arrivals = shown.values.sum(1) * 2 * 24
    steps = round(350 / method.time_step_ms)
    multiply_adds, single, kinds = told(lambda: method.match(codes))
    assert (multiply_adds, kinds) == (2 * 3 * steps * 48, {"float64"})
    assert single == 2 * 6 * steps * 48 + arrivals.sum()


class Torch(Lookup):
    """A lookup whose match multiplies by PyTorch too."""

    def match(self, codes: npt.NDArray[Any]) -> npt.NDArray[np.float32]:
        torch.zeros(len(codes), 10) @ torch.zeros(10, 50)
        return super().match(codes)


def costs(method: Method) -> dict[str, Any]:
    run = run_of(method, journey(6, 6))
    return energy.costs(asked_for(method, journey(6, 6)), run)


def test_what_pytorch_does_is_counted_and_a_step_without_a_formula_is_not_available() -> None:
    found = costs(Torch(np.eye(6, dtype=np.float32)))
    assert found["values"] == dict.fromkeys(found["values"])
    assert "encode" in found["how"]["operations"]
    assert "match" not in found["how"]["operations"]


def test_a_method_that_fails_when_it_is_counted_keeps_its_run() -> None:
    class Failing(Lookup):
        def encode(self, images: Images) -> npt.NDArray[np.int64]:
            if failing:
                raise KeyError("gone")
            return super().encode(images)

        def map_bytes(self) -> int:
            return 60

    failing = False
    method = Failing(np.eye(6, dtype=np.float32))
    run = run_of(method, journey(6, 6))
    failing = True
    found = energy.costs(asked_for(method, journey(6, 6)), run)
    assert "KeyError" in found["how"]["operations"]
    assert found["values"]["map_bytes"] == 10


def test_costs_are_asked_for_stored_and_shown(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    install(monkeypatch, tmp_path)
    monkeypatch.setattr(joules, "POWERCAP", tmp_path / "none")
    assert main([*ONE, "output=json"]) == 0
    assert "energy" not in json.loads(capfd.readouterr().out)
    for asked, there in (("energy=true", False), ("metrics=[energy]", True)):
        assert main([*ONE, asked, "output=json"]) == 0
        said = json.loads(capfd.readouterr().out)
        assert (said["from_store"], said["energy"]["values"]["joules_measured"]) == (there, None)
        assert said["energy"]["values"]["map_bytes"] == 2 * 28 * 28  # two references of each place
    assert said["operations"] == said["energy"]["values"]["operations"] > 3 * 40 * 28 * 28
    assert main([*ONE, "energy=true"]) == 0
    assert "n/a" in capfd.readouterr().out
    assert main(["table", "rows=[SAD]", "columns=[route]", "metrics=[energy]", *RUN]) == 0
    (line,) = csv.DictReader(Path("results/route-runs.csv").read_text().splitlines())
    assert float(line["joules_estimated"]) == said["joules_estimated"]
    cells = csv.DictReader(Path("results/route.csv").read_text().splitlines())
    assert {cell["quantity"]: cell["unit"] for cell in cells}["joules_estimated"] == "µJ"
