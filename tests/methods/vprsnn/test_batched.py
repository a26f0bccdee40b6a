"""Many VPRSNN modules at once in PyTorch do what the compiled simulation does with one after the other."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import torch

from vprbench import progress
from vprbench.methods.vprsnn import batched
from vprbench.methods.vprsnn.arrays import unpadded
from vprbench.methods.vprsnn.input import generator_for
from vprbench.methods.vprsnn.model import Model
from vprbench.methods.vprsnn.network import Network, ReadyNetwork
from vprbench.methods.vprsnn.parallel import Stage
from vprbench.methods.vprsnn.query import ask
from vprbench.methods.vprsnn.training import train
from vprbench.methods.vprsnn.training_sets import Lesson

Arrays = dict[str, npt.NDArray[Any]]

N_MODULES, N_IMAGES = 3, 4
CLOSE = 1e-9
CPU = torch.device("cpu")
# Neurons that have not come to rest when the first image is shown, and fire a few times for most images
LITTLE: dict[str, Any] = {
    **{"height": 6, "width": 10, "n_excitatory": 10, "levels_per_hz": 0.7, "weight_sum": 9.0, "epochs": 1},
    **{"presentation_ms": 120.0, "rest_ms": 20.0, "first_rest_ms": 50.0, "inhibitory_start_mv": -80.0},
}
CASES: dict[str, dict[str, Any]] = {
    "as published": {},
    "one image after the other without a rest": {"rest_ms": 0.0, "fast": True},
    "a rest in which all relax": {"rest_ms": 150.0},
    "no delays": {"fast": True},
    "fewer than eight neurons": {"n_excitatory": 3},
    "an image without spikes": {},
    "spikes at short intervals": {"excitatory_minimum_interval_ms": 2.0, "excitatory_refractory_ms": 0.0},
    "refractory for almost the whole interval": {
        "excitatory_refractory_ms": 9.0,
        "excitatory_minimum_interval_ms": 9.5,
    },
    "weights at their limits": {"post_rate": 0.5, "pre_rate": 0.05, "weight_max": 0.3},
    "weights above their limit": {"weight_max": 0.1},
    "an arrival weakens": {"pre_rate": -0.01},
    "inhibitory neurons that fire more than once": {"excitatory_to_inhibitory_weight": 60.0},
    "slow inhibition": {"inhibition_tau_ms": 30.0, "inhibitory_to_excitatory_weight": 0.5},
    "thresholds that change much": {"theta_plus_mv": 1.0, "theta_tau_ms": 500.0},
}


def model(name: str, **changes: Any) -> Model:
    return Model(**{**LITTLE, **CASES[name], **changes})


def lessons(name: str) -> list[Lesson]:
    """Return images of one place each, so that the responses are those to each; some of the inputs never spike."""
    levels = generator_for(1, 3).integers(0, 256, (N_MODULES, N_IMAGES, 60)).astype(np.uint8)
    levels[:, :, ::7] = 0
    if name == "an image without spikes":
        levels[:, 2] = 0
    each = np.arange(N_IMAGES)
    return [Lesson(number, own, each, N_IMAGES * number + each) for number, own in enumerate(levels)]


@cache
def one_by_one(name: str) -> list[Arrays]:
    """Return what the compiled simulation learns."""
    return [dict(train(model(name), lesson, lambda share: None)) for lesson in lessons(name)]


def at_once(name: str, device: torch.device = CPU, told: list[float] | None = None, **changes: Any) -> list[Arrays]:
    """Return what PyTorch learns."""
    heard: list[float] = [] if told is None else told
    return [dict(module) for module in batched.train(model(name, **changes), lessons(name), device, heard.append)]


def assert_alike(found: list[Arrays], expected: list[Arrays]) -> None:
    for module, other in zip(found, expected, strict=True):
        for name in ("sums", "shown", "places"):
            np.testing.assert_array_equal(module[name], other[name])
        n = len(other["theta"])
        np.testing.assert_allclose(unpadded(module["weights"], n), unpadded(other["weights"], n), rtol=0, atol=CLOSE)
        np.testing.assert_allclose(module["theta"], other["theta"], rtol=0, atol=CLOSE)


@pytest.mark.parametrize("name", CASES)
def test_all_modules_at_once_fire_as_often_and_learn_the_same(name: str) -> None:
    assert sum(module["sums"].sum() for module in one_by_one(name)) > 0
    assert_alike(at_once(name), one_by_one(name))


def test_the_responses_to_the_last_presentations_are_kept() -> None:
    for kept, whole in zip(at_once("no delays", recorded_presentations=2), one_by_one("no delays"), strict=True):
        assert kept["shown"].tolist() == [0, 0, 1, 1]
        np.testing.assert_array_equal(kept["sums"], whole["sums"] * [0, 0, 1, 1])


def test_the_progress_of_training_is_told_after_each_presentation() -> None:
    told: list[float] = []
    at_once("fewer than eight neurons", told=told)
    assert told == pytest.approx([0.25, 0.5, 0.75, 1.0])


def test_how_much_is_worked_on_at_once_does_not_change_what_is_learnt(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(batched.arrivals, "_AT_ONCE", 500)
    monkeypatch.setattr(batched.learning, "_AT_ONCE", 500)
    assert_alike(at_once("as published"), one_by_one("as published"))


# --- queries ----------------------------------------------------------------------------------------------------


def answers(name: str, images: slice = slice(None), **arguments: Any) -> npt.NDArray[np.int32]:
    """Return the spikes, (2, n_images, n_modules, n_neurons), with which trained modules answer."""
    ready = ReadyNetwork.of(model(name, **arguments), Network.of(one_by_one(name)))
    return np.array(ask(ready, lessons(name)[0].levels[images], Stage("asking")))


ASKED = ["as published", "no delays", "fewer than eight neurons", "inhibitory neurons that fire more than once"]


@pytest.mark.parametrize("carried", [False, True], ids=["from rest", "carried"])
@pytest.mark.parametrize("name", ASKED)
def test_all_modules_at_once_answer_the_same(name: str, carried: bool) -> None:
    expected = answers(name, engine="compiled", carried_potentials=carried)
    excitatory, inhibitory = expected.sum(axis=(1, 2, 3))
    assert excitatory > 0
    assert inhibitory > (1.5 * excitatory if "more than once" in name else 0)
    np.testing.assert_array_equal(answers(name, engine="batched", carried_potentials=carried), expected)


@pytest.mark.parametrize("images", [slice(2, 3), slice(None, None, -1), slice(0, 0)], ids=["alone", "turned", "none"])
def test_an_answer_does_not_depend_on_the_other_images(images: slice) -> None:
    whole = answers("no delays", engine="compiled")
    np.testing.assert_array_equal(answers("no delays", images, engine="batched"), whole[:, images])


# A neuron holds 3 values for each of 60 synapses, and for each image 6 for each of 250 steps and 100 more.
ONE_MODULE, TWO_MODULES, THREE_IMAGES = 0, 10 * 2 * (3 * 60 + 1600), 10 * 3 * (3 * 60 + 3 * 1600)


@pytest.mark.parametrize(
    ("held", "turns"),
    [
        (batched.VALUES_HELD, [12]),  # images of modules that have been asked
        (THREE_IMAGES, [9, 12]),
        (TWO_MODULES, [2, 4, 6, 8, 9, 10, 11, 12]),
        (ONE_MODULE, [*range(1, 13)]),
    ],
)
def test_a_query_takes_as_many_turns_as_memory_demands_and_has_the_same_answers(
    held: int, turns: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(batched, "VALUES_HELD", held)
    told: list[float] = []
    with progress.listening(lambda stage, share: told.append(share)):
        found = answers("as published", engine="batched")
    assert told == pytest.approx([asked / 12 for asked in turns])
    np.testing.assert_array_equal(found, answers("as published", engine="compiled"))


@pytest.mark.parametrize(
    ("held", "modules"),
    [
        # 400 neurons, each with 784 synapses of 3 values and 250 steps of 6 values, and 100 steps to come
        (batched.VALUES_HELD, 2**29 // (400 * (784 * 3 + 250 * 6 + 100))),
        (1, 1),
    ],
)
def test_as_many_published_modules_as_fit_are_trained_at_once_and_at_least_one(
    held: int, modules: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(batched, "VALUES_HELD", held)
    assert batched.modules_at_once(Model()) == modules


@pytest.mark.skipif(not torch.cuda.is_available(), reason="there is no GPU that CUDA can use")
@pytest.mark.parametrize("name", ASKED)
def test_a_gpu_learns_and_answers_the_same(name: str) -> None:
    assert_alike(at_once(name, torch.device("cuda")), one_by_one(name))
    np.testing.assert_array_equal(answers(name, device="cuda"), answers(name))
