"""Spikes of each layer: what a run keeps of them, and that those of VPRTempo are the ones of its forward pass."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from little import Lookup, journey
from little_runs import run_of
from stopped_clock import Clock

from vprbench.api.dataset import Dataset
from vprbench.api.images import Images
from vprbench.api.method import LayerSpikes
from vprbench.errors import BadInput, NotFittedError
from vprbench.methods.vprtempo.ensemble import VPRTempoEnsemble
from vprbench.methods.vprtempo.int8 import VPRTempoInt8
from vprbench.methods.vprtempo.method import VPRTempo
from vprbench.plugins.rules import Journey
from vprbench.run.note import Note
from vprbench.run.spikes import summary
from vprbench.run.store import Store

SMALL: dict[str, Any] = {"max_module": 8, "height": 12, "width": 12}


pytestmark = pytest.mark.usefixtures("surroundings")


# What is kept


@pytest.mark.parametrize(
    ("layer", "per_query", "active", "amplitude"),
    [
        (LayerSpikes("hidden", np.array([[2, 0, 1], [0, 0, 4]])), [3.0, 4.0], 2 / 3, None),
        (LayerSpikes("hidden", np.array([[0.5, 0, 0.25, 0], [0, 0, 0.75, 0]]), "amplitude"), [2.0, 1.0], 0.5, 0.5),
        (LayerSpikes("hidden", np.zeros((2, 3)), "amplitude"), [0.0, 0.0], 0.0, None),
    ],
)
def test_counts_are_added_up_for_each_query_and_an_amplitude_is_one_spike(
    layer: LayerSpikes, per_query: list[float], active: float, amplitude: float | None
) -> None:
    found = summary([layer])
    assert json.loads(json.dumps(found)) == found
    assert summary([]) is None
    several = summary([LayerSpikes("a", layer.values), layer, LayerSpikes("a", layer.values)])
    assert several is not None
    assert [each["name"] for each in several["layers"]] == ["a", "hidden", "a"]
    assert found == {
        "queries": 2,
        "layers": [
            {
                "name": "hidden",
                "neurons": layer.values.shape[1],
                "spikes_per_query": per_query,
                "active_share": pytest.approx(active),
                "amplitude_mean": amplitude,
            }
        ],
    }


@pytest.mark.parametrize(
    "layers",
    [
        [LayerSpikes("input", np.ones((2, 3))), LayerSpikes("output", np.ones((3, 3)))],
        [LayerSpikes("input", np.ones(3))],
        [LayerSpikes("input", np.array([[1.0, np.nan]]))],
        [LayerSpikes("input", np.array([[1.0, np.inf]]))],
        [LayerSpikes("input", np.array([[1.0, -0.5]]))],
    ],
    ids=["other queries", "no row a query", "NaN", "infinite", "below 0"],
)
def test_impossible_spikes_are_refused_by_the_name_of_the_layer(layers: list[LayerSpikes]) -> None:
    with pytest.raises(BadInput, match="input"):
        summary(layers)


# What a run asks for


@dataclass
class Ticking(Lookup):
    """A lookup whose one layer spikes as often as the number of the query; remembers what it was asked for."""

    def spikes(self, codes: npt.NDArray[Any]) -> Sequence[LayerSpikes]:
        self.counted = codes.tolist()
        return [LayerSpikes("tick", codes[:, None])]


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (KeyError("the layer\nis gone"), r"no spikes were counted (KeyError: 'the layer\nis gone')"),
        (None, "no spikes were counted (BadInput: the spikes of layer tick are not all finite and 0 or more)"),
    ],
)
def test_spikes_that_cannot_be_counted_or_cannot_be_lose_no_run(error: Exception | None, said: str) -> None:
    class Failing(Ticking):
        def spikes(self, codes: npt.NDArray[Any]) -> Sequence[LayerSpikes]:
            if error is not None:
                raise error
            return [LayerSpikes("tick", -1.0 - codes[:, None])]

    run = run_of(Failing(np.eye(6, dtype=np.float32)), journey(6, 6))
    assert run.spikes is None
    assert run.outcome.above.tolist() == [0] * 6
    assert Note("spikes", said) in run.notes


def test_a_run_keeps_the_spikes_of_every_query_if_they_are_few_and_has_them_back_from_the_store(tmp_path: Path) -> None:
    run = run_of(Ticking(np.eye(6, dtype=np.float32)), journey(6, 6))
    assert run.spikes is not None
    assert run.spikes["queries"] == 6
    assert run.spikes["layers"][0]["spikes_per_query"] == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]
    store = Store(tmp_path)
    store.save(run)
    assert [back.spikes for back in store.runs()] == [run.spikes]


def test_of_many_queries_256_are_asked_for_from_the_first_to_the_last() -> None:
    method = Ticking(np.zeros((1000, 4), np.float32))
    run = run_of(method, journey(1000, 4))
    assert run.spikes is not None
    assert (run.spikes["queries"], method.counted[0], method.counted[-1]) == (256, 0, 999)
    assert set(np.diff(method.counted)) == {3, 4}
    silent, spiking = Lookup(np.zeros((6, 4), np.float32)), Ticking(np.zeros((6, 4), np.float32))
    assert [run_of(each, journey(6, 4)).spikes is None for each in (silent, spiking)] == [True, False]
    assert len(spiking.asked) == len(silent.asked) + 1


def test_counting_takes_no_part_in_what_a_run_times(clock: Clock) -> None:
    class Slow(Ticking):
        def encode(self, images: Images) -> npt.NDArray[np.int64]:
            clock.spend(0.001 * len(images))
            return super().encode(images)

        def spikes(self, codes: npt.NDArray[Any]) -> Sequence[LayerSpikes]:
            clock.spend(1000)
            return super().spikes(codes)

    run = run_of(Slow(np.eye(6, dtype=np.float32)), journey(6, 6))
    assert clock.seconds() > 1000
    assert (run.harness_seconds, run.method_seconds) == pytest.approx((0, 0.007))  # the first query is asked twice
    assert run.timing.streaming.total_seconds == pytest.approx([0.001] * 6)


# VPRTempo


def fitted(kind: type[VPRTempo], **arguments: Any) -> tuple[VPRTempo, npt.NDArray[np.float32]]:
    world = Journey.draw(0)
    method = kind(**SMALL, **arguments).fit(Images.from_arrays(world.references), world.places)
    return method, method.encode(Images.from_arrays(world.queries))


def by_eq_1(state: dict[str, npt.NDArray[Any]], codes: npt.NDArray[Any]) -> tuple[npt.NDArray[Any], ...]:
    """Return the feature and output spikes of a stored network for each query, in float64."""
    features, outputs = [], []
    layers = zip(state["features"], state["constant"], state["feature_thresholds"], strict=True)
    for module, (weights, constants, thresholds) in enumerate(layers):
        features.append(np.clip(codes.astype(np.float64) @ weights.T + constants - thresholds, 0, 0.9))
        above = features[-1] @ state[f"outputs_{module}"].T - state[f"output_thresholds_{module}"]
        outputs.append(np.clip(above, 0, 0.9))
    return np.hstack(features), np.hstack(outputs)


def test_the_spikes_of_vprtempo_are_those_of_eq_1() -> None:
    method, codes = fitted(VPRTempo)
    shown, features, outputs = method.spikes(codes)
    right_features, right_outputs = by_eq_1(dict(method.state()), codes)
    assert [shown.name, features.name, outputs.name] == ["input", "feature", "output"]
    assert {layer.kind for layer in (shown, features, outputs)} == {"amplitude"}
    assert np.array_equal(shown.values, codes)
    assert features.values == pytest.approx(right_features, abs=1e-5)
    assert outputs.values == pytest.approx(right_outputs, abs=1e-5)
    assert 0 < np.count_nonzero(features.values) < features.values.size
    assert outputs.values == pytest.approx(method.match(codes), abs=1e-5)  # of one plain network they are its scores
    restored = VPRTempo(**SMALL).restore(method.state())
    assert all(
        np.array_equal(layer.values, own.values)
        for layer, own in zip(restored.spikes(codes), (shown, features, outputs), strict=True)
    )


def test_what_acts_on_scores_alone_shows_in_no_spikes_and_of_an_ensemble_the_first_network_is_shown() -> None:
    single, _ = fitted(VPRTempo, seed=4)
    for kind, arguments in ((VPRTempo, {"calibrated_scores": True}), (VPRTempoEnsemble, {"members": 2})):
        method, codes = fitted(kind, seed=4, **arguments)
        for layer, own in zip(method.spikes(codes), single.spikes(codes), strict=True):
            assert layer.values == pytest.approx(own.values, abs=1e-5)
    linear, codes = fitted(VPRTempo, query_rule="linear")
    assert [layer.name for layer in linear.spikes(codes)] == ["input"]
    with pytest.raises(NotFittedError):
        VPRTempo(**SMALL).spikes(np.zeros((1, 144), np.float32))


def test_in_8_bits_the_spikes_are_the_quantised_ones() -> None:
    method, codes = fitted(VPRTempoInt8)
    features, outputs = (layer.values for layer in method.spikes(codes)[1:])
    steps = features * 255 / 0.9
    assert steps == pytest.approx(np.rint(steps), abs=1e-3)
    assert outputs == pytest.approx(method.match(codes), abs=1e-5)
    assert features == pytest.approx(by_eq_1(dict(method.state()), codes)[0], abs=0.03)


def test_a_run_of_vprtempo_keeps_three_layers() -> None:
    world = Journey.draw(0)
    queries = Images.from_arrays(world.queries)
    right = tuple(np.array([place]) for place in world.right.tolist())
    dataset = Dataset("world", Images.from_arrays(world.references), world.places, queries, right, {})
    found = run_of(VPRTempo(**SMALL), dataset).spikes
    assert found is not None
    assert [(layer["name"], layer["neurons"]) for layer in found["layers"]] == [
        ("input", 144),
        ("feature", 3 * 288),
        ("output", 20),
    ]
