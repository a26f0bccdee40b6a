"""VPRSNN's published weights: every synapse finds its place, volts become millivolts, and nothing else is read."""

from __future__ import annotations

import errno
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


@pytest.mark.parametrize("layout", [by_input, mixed, np.asfortranarray])
@pytest.mark.parametrize("number", ["<f8", ">f8", "<f4"])
def test_every_synapse_has_its_own_weight_whatever_the_layout(tmp_path, layout, number):
    weights = random_weights()
    publish(tmp_path, weights=layout(weights).astype(number))
    (module,) = read(tmp_path)
    assert np.array_equal(module.weights, weights.astype(number))
    assert module.weights.dtype == np.float64
    assert module.weights.flags.c_contiguous
    assert module.weights.flags.writeable
    assert module.theta_mv == pytest.approx([20, 35, 0, 61.5])


@pytest.mark.parametrize(("offsets", "ending"), [([0, 25, 50, 75, 100], ""), ([600, 625], "_S10")], ids=str)
def test_modules_are_read_in_the_order_of_their_first_places(tmp_path: Path, offsets: list[int], ending: str) -> None:
    for offset in reversed(offsets):
        publish(tmp_path, offset, by_input(random_weights(offset)), ending=ending)
    (tmp_path / "weights_ne4_L25_offset125").touch()  # whatever else lies there is left alone
    (tmp_path / "weights_ne4_L25_offset150.zip").touch()
    (tmp_path / "random").mkdir()
    for offset, module in zip(offsets, read(tmp_path), strict=True):
        assert np.array_equal(module.weights, random_weights(offset))


# What is missing


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    publish(tmp_path)
    for name in ("XeAe.npy", "theta_A.npy"):
        missing = publish(tmp_path / "of" / name) / name
        missing.unlink()
        for ask in (files_of, read):
            with pytest.raises(NotThere, match=f"offset0/{name}"):
                ask(tmp_path / "of" / name)


@pytest.mark.parametrize(
    ("modules", "folder", "kind", "culprit"),
    [
        ([], "nowhere", NotThere, "nowhere"),
        ([], "file", NotThere, "file"),
        ([], "", NotThere, "weights_ne400_L25_offset0"),
        ([{}, {"offset": 25}, {"offset": 75}], "", NotThere, "place 50, before weights_ne4_L25_offset75"),
        # two modules of the same places, or two networks
        ([{}, {"offset": 10}], "", BadInput, "weights_ne4_L25_offset0 and weights_ne4_L25_offset10"),
        *(
            ([{}, {"offset": 25, **other}], "", BadInput, f"({both})")
            for other, both in (
                ({"kind": "ne4_L100"}, "weights_ne4_L100, weights_ne4_L25"),
                ({"kind": "ne8_L25"}, "weights_ne4_L25, weights_ne8_L25"),
                ({"ending": "_S10"}, "weights_ne4_L25, weights_ne4_L25_S10"),
            )
        ),
    ],
)
def test_modules_that_make_no_network_are_refused_by_name(tmp_path, modules, folder, kind, culprit):
    (tmp_path / "file").touch()
    for module in modules:
        publish(tmp_path, **module)
    assert culprit in refusal(tmp_path / folder, kind)


# What is refused


def test_a_file_that_is_damaged_or_holds_no_plain_numbers_is_named(tmp_path: Path) -> None:
    module = publish(tmp_path)
    whole = (module / "XeAe.npy").read_bytes()
    for damaged in (whole[:-1], b"", b"<!DOCTYPE html><title>Sign in</title>"):
        (module / "XeAe.npy").write_bytes(damaged)
        assert refusal(tmp_path).startswith(f"{module / 'XeAe.npy'} ")
    for name in ("theta_A.npy", "XeAe.npy"):
        for kind in ("<U3", "c16", "?", object):  # objects are pickled, and could run anything
            (module / "XeAe.npy").write_bytes(whole)
            np.save(module / name, np.zeros(NEURONS, kind))
            assert name in refusal(tmp_path)


def rows_but(row: int, source: float, neuron: float) -> npt.NDArray[np.float64]:
    rows = by_input(random_weights())
    rows[row, :2] = source, neuron
    return rows


def weights_but(value: float) -> npt.NDArray[np.float64]:
    weights = random_weights()
    weights[2, 3] = value
    return weights


@pytest.mark.parametrize(
    ("changed", "array", "culprit"),
    [
        *(("weights", np.zeros(shape), f"{shape}") for shape in ((23, 3), (24, 2), (4, 6), (24,), (0, 3), ())),
        *(("theta", np.zeros(shape), f"{shape}") for shape in ((5,), (4, 1), ())),
        ("weights", rows_but(0, INPUTS, 0), "input 6 and neuron 0;"),
        ("weights", rows_but(0, 0, NEURONS), "input 0 and neuron 4;"),
        ("weights", rows_but(0, -1, 0), "input -1 and neuron 0;"),
        ("weights", rows_but(0, 0.5, 0), "input 0.5 and neuron 0;"),
        ("weights", rows_but(0, 0, np.nan), "input 0 and neuron nan;"),
        ("weights", rows_but(5, 1, 2), "0 rows of input 1 and neuron 1;"),
        ("weights", rows_but(6, 1, 1), "2 rows of input 1 and neuron 1;"),
        *(
            ("weights", layout(weights_but(value)), "XeAe.npy holds weights")
            for layout in (by_input, np.asarray)
            for value in (np.nan, np.inf, -0.1)
        ),
        *(("theta", [0.02, value, 0.02, 0.02], "theta_A.npy holds") for value in (np.nan, np.inf, -0.02, 20.0)),
    ],
)
def test_shapes_synapses_weights_and_thresholds_that_cannot_be_are_refused(tmp_path, changed, array, culprit):
    publish(tmp_path, **{changed: np.asarray(array)})  # type: ignore[arg-type]
    assert culprit in refusal(tmp_path)


def test_a_file_that_the_system_does_not_read_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any, **__: Any) -> NoReturn:
        raise PermissionError(errno.EACCES, "Permission denied")

    publish(tmp_path)
    monkeypatch.setattr(np.lib.format, "open_memmap", refuse)  # root, who may run these tests, may read every file
    assert "XeAe.npy cannot be read (Permission denied)" in refusal(tmp_path)
