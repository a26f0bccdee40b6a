"""VPRSNN's network as stored arrays: what comes back, what is refused, and the layout of its authors."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from little_vprsnn import SMALL, WORLD, fitted, images, layers, references, same

from vprbench.errors import BadInput, NotFittedError, NotThere
from vprbench.methods.vprsnn.method import VPRSNN

Array = npt.NDArray[Any]

QUERIES = images(WORLD.queries)


def method(**arguments: Any) -> VPRSNN:
    return VPRSNN(**{**SMALL, **arguments})


# --- stored and restored ----------------------------------------------------------------------------------------


def test_a_restored_network_is_the_stored_one_and_answers_alike() -> None:
    trained = fitted(7, hyperactive_threshold=3)
    stored = {name: array.copy() for name, array in trained.state().items()}
    assert {name: array.shape for name, array in stored.items()} == {
        **{"weights": (2, 144, 24), "theta": (2, 24), "sums": (2, 24, 5), "shown": (2, 5), "places": (2, 5)},
        **{"threshold": (), "reactions": (2, 24)},
    }
    assert stored["places"].tolist() == [[0, 1, 2, 3, 4], [5, 6, -1, -1, -1]]
    assert stored["shown"][1].tolist() == [12, 12, 0, 0, 0]  # 2 images in each of 6 epochs
    assert not stored["sums"][1, :, 2:].any()
    restored = method().restore(stored)
    assert same(restored.state(), stored)
    codes = trained.encode(QUERIES)
    assert np.array_equal(restored.match(codes), trained.match(codes))
    for name, counts in layers(restored, codes).items():
        assert np.array_equal(counts, layers(trained, codes)[name])
    for given, kept in ((None, 3), (0, 0), (5, 5)):
        assert method(hyperactive_threshold=given).restore(stored).state()["threshold"] == kept


# --- refused ----------------------------------------------------------------------------------------------------


def little() -> dict[str, Array]:
    """Return the arrays of two modules of three and two places, with 4 pixels and 3 neurons."""
    draw = np.random.default_rng(0)
    sums = draw.integers(0, 50, (2, 3, 3)).astype(np.float32)
    sums[1, :, 2] = 0
    return {
        "weights": draw.random((2, 4, 3)),
        "theta": draw.uniform(20, 30, (2, 3)),
        "sums": sums,
        "shown": np.array([[5, 5, 5], [5, 5, 0]]),
        "places": np.array([[0, 3, 1], [4, 2, -1]]),
        "threshold": np.array(7),
        "reactions": draw.integers(0, 9, (2, 3)),
    }


def small() -> VPRSNN:
    return VPRSNN(height=2, width=2, n_excitatory=3)


def refusal(state: Mapping[str, Array], **changes: int) -> str:
    """Return the line that refuses the arrays, and see that the method, which had a network, answers nothing."""
    asked = small().restore(little())
    for name, value in changes.items():
        setattr(asked, name, value)
    with pytest.raises(BadInput) as error:
        asked.restore(state)
    with pytest.raises(NotFittedError):
        asked.state()
    assert "\n" not in str(error.value)
    return str(error.value)


@pytest.mark.parametrize("name", little())
def test_an_array_of_another_shape_is_refused(name: str) -> None:
    own = little()[name]
    wider = np.concatenate([np.atleast_2d(own), np.atleast_2d(own)[..., :1]], axis=-1)
    fewer = (own.reshape(-1)[0], own[:1]) if own.ndim else (np.repeat(own, 2),)
    for spoilt in (own[None], own.reshape(-1, 1, 1, 1), own.reshape(-1)[:0], wider, *fewer):
        refusal({**little(), name: np.asarray(spoilt)})


def without(name: str) -> dict[str, Array]:
    return {key: array for key, array in little().items() if key != name}


def spoilt(name: str, at: tuple[int, ...], value: float) -> dict[str, Array]:
    state = little()
    state[name][at] = value
    return state


@pytest.mark.parametrize(
    ("state", "culprit"),
    [
        *((spoilt(name, (0, 1), value), name) for name in ("weights", "theta", "sums") for value in (np.nan, np.inf)),
        (spoilt("places", (1, 1), 3), "places"),  # one twice
        (spoilt("places", (1, 0), 5), "places"),  # one left out
        ({**little(), "places": np.array([[1, 3, 4], [5, 2, -1]])}, "places"),  # not from 0
        ({**little(), "places": np.full((2, 3), -1)}, "places"),  # none
        (spoilt("sums", (1, 0, 2), 3), "spikes"),  # for a place that is not there
        (spoilt("sums", (0, 0, 0), -3), "spikes"),
        *((without(name), name) for name in little()),
        ({**little(), "threshold": np.array(-1)}, "threshold"),
        ({**little(), "delays": np.zeros((2, 4, 3))}, "delays"),
        ({}, "holds"),
    ],
)
def test_values_that_no_network_has_are_refused(state: dict[str, Array], culprit: str) -> None:
    assert culprit in refusal(state)


@pytest.mark.parametrize(
    ("state", "change"),
    [
        (little(), {"height": 3}),
        (little(), {"n_excitatory": 4}),
        ({**without("reactions"), "threshold": np.array(0)}, {"hyperactive_threshold": 3}),  # none were counted
    ],
)
def test_what_the_network_does_not_have_is_refused_with_the_argument(state, change):
    assert f"method.{next(iter(change))}" in refusal(state, **change)


# --- the layout of the authors ----------------------------------------------------------------------------------


def publish(folder: Path, weights: Array, theta: Array, first: int = 0, dense: bool = False) -> None:
    """Write modules (n_modules, n_inputs, n_neurons) with theta (mV) of five places each as VPRSNN's code does."""
    for number, (of_module, own) in enumerate(zip(weights, theta, strict=True)):
        module = folder / f"weights_ne{len(own)}_L5_offset{first + 5 * number}"
        module.mkdir(parents=True)
        source, neuron = np.indices(of_module.shape)
        rows = np.stack([source.ravel(), neuron.ravel(), of_module.ravel()], axis=1)
        np.save(module / "XeAe.npy", of_module if dense else rows)
        np.save(module / "theta_A.npy", own / 1000)  # volts


@pytest.fixture
def trained() -> VPRSNN:
    """A network of ten places to publish."""
    return fitted(10)


@pytest.fixture
def folder(tmp_path: Path, trained: VPRSNN) -> Path:
    """The published weights of that network."""
    publish(tmp_path / "weights", trained.state()["weights"], trained.state()["theta"], first=600)
    return tmp_path / "weights"


@pytest.mark.parametrize("dense", [False, True])
def test_published_weights_are_taken_over_unchanged(tmp_path: Path, trained: VPRSNN, dense: bool) -> None:
    draw = np.random.default_rng(3)
    weights, theta = draw.random((2, 144, 24)), draw.uniform(20, 40, (2, 24))
    publish(tmp_path, weights, theta, dense=dense)
    found = fitted(10, published_weights=str(tmp_path))
    state = found.state()
    assert np.array_equal(state["weights"], weights)
    assert state["theta"] == pytest.approx(theta)
    assert state["places"].tolist() == [[0, 1, 2, 3, 4], [5, 6, 7, 8, 9]]
    assert not np.array_equal(weights, trained.state()["weights"])
    shutil.rmtree(tmp_path)
    codes = found.encode(QUERIES)
    assert np.array_equal(method().restore(state).match(codes), found.match(codes))


def test_the_assignment_of_published_weights_follows_the_images_and_not_the_order_of_the_modules(folder):
    # The same weights for the places in the other order: neurons speak for the images that they learnt.
    shown, places = references(10)
    turned = method(published_weights=str(folder), epochs=12).fit(shown, (places // 5) * 5 + 4 - places % 5)
    right = np.tile((np.arange(10) // 5) * 5 + 4 - np.arange(10) % 5, 2)
    assert np.mean(turned.query(shown).argmax(1) == right) > 0.5


def test_only_the_last_presentations_assign_published_weights(folder: Path) -> None:
    # Of 60 presentations, 10 an epoch, the last 12: places 3 and 4 of the second traverse, then two of every place.
    state = fitted(10, published_weights=str(folder), recorded_presentations=12).state()
    assert state["shown"].tolist() == [[2, 2, 2, 3, 3]] * 2


def test_the_files_of_published_weights_are_told_or_missed_and_others_have_none(folder: Path) -> None:
    files = method(published_weights=str(folder)).files()
    assert [str(path.relative_to(folder)) for path in files] == [
        f"weights_ne24_L5_offset{offset}/{name}" for offset in (600, 605) for name in ("XeAe.npy", "theta_A.npy")
    ]
    assert method().files() == []
    files[-1].unlink()
    with pytest.raises(NotThere, match=r"offset605/theta_A\.npy"):
        method(published_weights=str(folder)).files()


@pytest.mark.parametrize(
    ("n_places", "change", "culprit"),
    [
        (5, {}, "holds 2 modules, but the places make 1"),
        (11, {}, "holds 2 modules, but the places make 3"),
        (10, {"n_excitatory": 23}, "XeAe.npy"),
        (10, {"height": 11}, "XeAe.npy"),
    ],
)
def test_published_weights_of_another_size_are_refused(folder, n_places, change, culprit):
    with pytest.raises(BadInput) as error:
        fitted(n_places, published_weights=str(folder), **change)
    assert culprit in str(error.value)
