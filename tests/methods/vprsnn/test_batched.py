"""Many VPRSNN modules at once in PyTorch do what the compiled simulation does with one after the other."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import torch

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
    "no delays, few neurons": {"fast": True, "n_excitatory": 3},
    "inhibitory neurons that fire more than once": {"excitatory_to_inhibitory_weight": 60.0},
}


def model(name: str, **changes: Any) -> Model:
    return Model(**{**LITTLE, **CASES[name], **changes})


def lessons() -> list[Lesson]:
    """Return images of one place each, so that the responses are those to each; some of the inputs never spike."""
    levels = generator_for(1, 3).integers(0, 256, (N_MODULES, N_IMAGES, 60)).astype(np.uint8)
    levels[:, :, ::7] = 0
    each = np.arange(N_IMAGES)
    return [Lesson(number, own, each, N_IMAGES * number + each) for number, own in enumerate(levels)]


@cache
def one_by_one(name: str) -> list[Arrays]:
    """Return what the compiled simulation learns."""
    return [dict(train(model(name), lesson, lambda share: None)) for lesson in lessons()]


def at_once(name: str, device: torch.device = CPU) -> list[Arrays]:
    """Return what PyTorch learns."""
    return [dict(module) for module in batched.train(model(name), lessons(), device, lambda share: None)]


def assert_alike(found: list[Arrays], expected: list[Arrays]) -> None:
    for module, other in zip(found, expected, strict=True):
        for name in ("sums", "shown", "places"):
            np.testing.assert_array_equal(module[name], other[name])
        n = len(other["theta"])
        np.testing.assert_allclose(unpadded(module["weights"], n), unpadded(other["weights"], n), rtol=0, atol=CLOSE)
        np.testing.assert_allclose(module["theta"], other["theta"], rtol=0, atol=CLOSE)


def answers(name: str, **arguments: Any) -> npt.NDArray[np.int32]:
    """Return the spikes, (2, n_images, n_modules, n_neurons), with which trained modules answer."""
    ready = ReadyNetwork.of(model(name, **arguments), Network.of(one_by_one(name)))
    return np.array(ask(ready, lessons()[0].levels, Stage("asking")))


@pytest.mark.parametrize("name", CASES)
def test_all_modules_at_once_learn_and_answer_the_same(name: str) -> None:
    assert sum(module["sums"].sum() for module in one_by_one(name)) > 0
    assert_alike(at_once(name), one_by_one(name))
    for carried in (False, True):
        expected = answers(name, engine="compiled", carried_potentials=carried)
        assert expected.any()
        np.testing.assert_array_equal(answers(name, engine="batched", carried_potentials=carried), expected)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="there is no GPU that CUDA can use")
@pytest.mark.parametrize("name", CASES)
def test_a_gpu_learns_and_answers_the_same(name: str) -> None:
    assert_alike(at_once(name, torch.device("cuda")), one_by_one(name))
    np.testing.assert_array_equal(answers(name, device="cuda"), answers(name))
