"""VPRSNN's published weights: every synapse finds its place, volts become millivolts, and nothing else is read."""

from __future__ import annotations

import errno
import os
import pickle
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import numpy.typing as npt
import pytest

from vprbench.errors import BadInput, NotThere
from vprbench.methods.vprsnn.published import PublishedModule, files_of, read_modules

INPUTS, NEURONS = 6, 4
THETA_VOLTS = np.array([0.02, 0.035, 0.0, 0.0615])


def random_weights(seed: int = 0) -> npt.NDArray[np.float64]:
    return np.random.default_rng(seed).random((INPUTS, NEURONS))


def by_input(weights: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Rows as the authors' program writes them: all neurons of the first input, then those of the second."""
    return np.array([(i, j, weights[i, j]) for i in range(len(weights)) for j in range(weights.shape[1])])


def by_neuron(weights: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    return np.array([(i, j, weights[i, j]) for j in range(weights.shape[1]) for i in range(len(weights))])


def mixed(weights: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    return np.random.default_rng(1).permutation(by_input(weights))


def publish(
    folder: Path,
    offset: int = 0,
    weights: npt.NDArray[Any] | None = None,
    theta: npt.NDArray[Any] = THETA_VOLTS,
    kind: str = "ne4_L25",
    ending: str = "",
) -> Path:
    """Write a module in the published layout; returns its folder."""
    module = folder / f"weights_{kind}_offset{offset}{ending}"
    module.mkdir(parents=True)
    np.save(module / "XeAe.npy", by_input(random_weights()) if weights is None else weights)
    np.save(module / "theta_A.npy", theta)
    np.save(module / "AeAi.npy", np.zeros((NEURONS**2, 3)))
    return module


def read(folder: Path) -> list[PublishedModule]:
    return read_modules(folder, INPUTS, NEURONS)


def refusal(folder: Path, kind: type[BadInput] = BadInput) -> str:
    """The complaint about a folder; a file that is wrong is no file that is missing."""
    with pytest.raises(BadInput) as complaint:
        read(folder)
    assert complaint.type is kind
    assert "\n" not in str(complaint.value)
    return str(complaint.value)


# What is read


@pytest.mark.parametrize("layout", [by_input, by_neuron, mixed, lambda weights: weights, np.asfortranarray])
@pytest.mark.parametrize("number", ["<f8", ">f8", "<f4"])
def test_every_synapse_has_its_own_weight_whatever_the_layout(
    tmp_path: Path, layout: Callable[[npt.NDArray[np.float64]], npt.NDArray[np.float64]], number: str
) -> None:
    weights = random_weights()
    publish(tmp_path, weights=layout(weights).astype(number))
    (module,) = read(tmp_path)
    assert np.array_equal(module.weights, weights.astype(number))
    assert module.weights.dtype == np.float64
    assert module.weights.flags.c_contiguous
    assert module.weights.flags.writeable


def test_thresholds_in_volts_become_millivolts(tmp_path: Path) -> None:
    publish(tmp_path)
    assert read(tmp_path)[0].theta_mv == pytest.approx([20, 35, 0, 61.5])


@pytest.mark.parametrize(
    ("offsets", "ending"),
    [
        pytest.param([0, 25, 50, 75, 100], "", id="as text 100 comes before 25"),
        pytest.param([600, 625], "", id="behind the places for calibration"),
        pytest.param([0, 25], "_S10", id="with a seed"),
    ],
)
def test_modules_are_read_in_the_order_of_their_first_places(tmp_path: Path, offsets: list[int], ending: str) -> None:
    for offset in reversed(offsets):
        publish(tmp_path, offset, by_input(random_weights(offset)), ending=ending)
    found = read(tmp_path)
    for offset, module in zip(offsets, found, strict=True):
        assert np.array_equal(module.weights, random_weights(offset))


def test_whatever_else_lies_there_is_left_alone(tmp_path: Path) -> None:
    publish(tmp_path)
    (tmp_path / "weights_ne4_L25_offset25").touch()
    (tmp_path / "weights_ne4_L25_offset50.zip").touch()
    (tmp_path / "random").mkdir()
    assert len(read(tmp_path)) == 1


# What is missing


@pytest.mark.parametrize("name", ["XeAe.npy", "theta_A.npy"])
@pytest.mark.parametrize("ask", [files_of, read], ids=["files_of", "read_modules"])
def test_a_missing_file_is_named(tmp_path: Path, name: str, ask: Callable[[Path], object]) -> None:
    publish(tmp_path)
    missing = publish(tmp_path, 25) / name
    missing.unlink()
    with pytest.raises(NotThere, match=f"offset25/{name} is missing"):
        ask(tmp_path)


@pytest.mark.parametrize(
    ("offsets", "folder", "culprit"),
    [
        ([], "nowhere", "nowhere cannot be read"),
        ([], "file", "file cannot be read"),
        ([], "", "weights_ne400_L25_offset0"),
        ([0, 25, 75], "", "place 50, before weights_ne4_L25_offset75"),
    ],
)
def test_what_is_missing_is_named(tmp_path: Path, offsets: list[int], folder: str, culprit: str) -> None:
    (tmp_path / "file").touch()
    for offset in offsets:
        publish(tmp_path, offset)
    assert culprit in refusal(tmp_path / folder, NotThere)


# What is refused


@pytest.mark.parametrize(
    ("offset", "other", "culprit"),
    [
        (10, {}, "weights_ne4_L25_offset0 and weights_ne4_L25_offset10"),
        (25, {"kind": "ne4_L100"}, "2 networks (weights_ne4_L100, weights_ne4_L25)"),
        (25, {"kind": "ne8_L25"}, "2 networks (weights_ne4_L25, weights_ne8_L25)"),
        (25, {"ending": "_S10"}, "2 networks (weights_ne4_L25, weights_ne4_L25_S10)"),
    ],
)
def test_modules_of_the_same_places_or_of_two_networks_are_refused(
    tmp_path: Path, offset: int, other: dict[str, Any], culprit: str
) -> None:
    publish(tmp_path, 0)
    publish(tmp_path, offset, **other)
    assert culprit in refusal(tmp_path)


class Harmful:
    """Makes a folder where anybody unpickles it."""

    def __init__(self, place: Path) -> None:
        self.place = place

    def __reduce__(self) -> tuple[Any, ...]:
        return os.mkdir, (str(self.place),)


@pytest.mark.parametrize("name", ["XeAe.npy", "theta_A.npy"])
@pytest.mark.parametrize("wrapped", [True, False], ids=["array of objects", "bare pickle"])
def test_pickled_objects_are_refused_and_never_run(tmp_path: Path, name: str, wrapped: bool) -> None:
    path, made = publish(tmp_path) / name, tmp_path / "made by the pickle"
    if wrapped:
        array = np.empty(NEURONS, object)
        array[:] = Harmful(made)
        np.save(path, array, allow_pickle=True)
    else:
        path.write_bytes(pickle.dumps(Harmful(made)))
    complaint = refusal(tmp_path)
    assert name in complaint
    assert "no array of plain numbers" in complaint
    assert not made.exists()


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-1])


def emptied(path: Path) -> None:
    path.write_bytes(b"")


def promising_terabytes(path: Path) -> None:
    rows = path.read_bytes()
    path.write_bytes(rows.replace(b"(24, 3), }        ", b"(24, 300000000), }"))
    assert len(path.read_bytes()) == len(rows)


def with_a_broken_header(path: Path) -> None:
    path.write_bytes(path.read_bytes().replace(b"(24, 3)", b"(24, 3,", 1))


def text(path: Path) -> None:
    path.write_text("<!DOCTYPE html><title>Sign in</title>", encoding="utf-8")


def a_zip_of_arrays(path: Path) -> None:
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("XeAe.npy", b"")


@pytest.mark.parametrize("damage", [cut, emptied, promising_terabytes, with_a_broken_header, text, a_zip_of_arrays])
def test_a_damaged_file_is_named(tmp_path: Path, damage: Callable[[Path], None]) -> None:
    path = publish(tmp_path) / "XeAe.npy"
    damage(path)
    assert refusal(tmp_path).startswith(f"{path} ")


@pytest.mark.parametrize("name", ["XeAe.npy", "theta_A.npy"])
@pytest.mark.parametrize("kind", ["<U3", "c16", "?", "M8[s]", [("i", "<f8")]])
def test_what_are_no_plain_numbers_is_refused(tmp_path: Path, name: str, kind: Any) -> None:
    path = publish(tmp_path) / name
    np.save(path, np.zeros(NEURONS, kind))
    assert "wanted an array of plain numbers" in refusal(tmp_path)


@pytest.mark.parametrize(
    ("name", "shape"),
    [
        *(("weights", shape) for shape in ((23, 3), (24, 2), (4, 6), (24,), (0, 3), ())),
        *(("theta", shape) for shape in ((5,), (4, 1), ())),
    ],
)
def test_arrays_of_another_shape_are_refused(tmp_path: Path, name: str, shape: tuple[int, ...]) -> None:
    publish(tmp_path, **{name: np.zeros(shape)})  # type: ignore[arg-type]
    wanted = "(24, 3) or (6, 4)" if name == "weights" else "(4,)"
    complaint = refusal(tmp_path)
    assert f"has shape {shape}" in complaint
    assert wanted in complaint


@pytest.mark.parametrize(
    ("row", "changed", "wanted"),
    [
        (0, (INPUTS, 0), "a row of input 6 and neuron 0; wanted whole numbers below 6 and 4"),
        (0, (0, NEURONS), "a row of input 0 and neuron 4;"),
        (0, (-1, 0), "a row of input -1 and neuron 0;"),
        (0, (0.5, 0), "a row of input 0.5 and neuron 0;"),
        (0, (0, np.nan), "a row of input 0 and neuron nan;"),
        (5, (1, 2), "0 rows of input 1 and neuron 1; wanted one"),
        (6, (1, 1), "2 rows of input 1 and neuron 1; wanted one"),
    ],
)
def test_a_row_of_no_synapse_or_of_one_that_has_its_own_is_named(
    tmp_path: Path, row: int, changed: tuple[float, float], wanted: str
) -> None:
    rows = by_input(random_weights())
    rows[row, :2] = changed
    publish(tmp_path, weights=rows)
    assert wanted in refusal(tmp_path)


@pytest.mark.parametrize("value", [np.nan, np.inf, -0.1])
@pytest.mark.parametrize("layout", [by_input, lambda weights: weights])
def test_weights_that_cannot_be_are_refused(
    tmp_path: Path, layout: Callable[[npt.NDArray[np.float64]], npt.NDArray[np.float64]], value: float
) -> None:
    weights = random_weights()
    weights[2, 3] = value
    publish(tmp_path, weights=layout(weights))
    assert "XeAe.npy holds weights" in refusal(tmp_path)


@pytest.mark.parametrize("value", [np.nan, np.inf, -0.02, 20.0])
def test_thresholds_that_cannot_be_volts_are_refused(tmp_path: Path, value: float) -> None:
    publish(tmp_path, theta=np.array([0.02, value, 0.02, 0.02]))
    assert "theta_A.npy holds thresholds" in refusal(tmp_path)


def test_a_file_that_the_system_does_not_read_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any, **__: Any) -> NoReturn:
        raise PermissionError(errno.EACCES, "Permission denied")

    publish(tmp_path)
    monkeypatch.setattr(np.lib.format, "open_memmap", refuse)  # root, who may run these tests, may read every file
    assert "XeAe.npy cannot be read (Permission denied)" in refusal(tmp_path)
