"""A sealed file of arrays tells any change of text, names, types, shapes and numbers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import save_file

from vprbench.storage.tensors import Arrays, Seal, plain

SEAL = Seal("about", "digest")
ARRAYS = {"weights": np.arange(6, dtype=np.int32).reshape(2, 3), "bias": np.zeros(2, np.float32)}


def test_what_was_written_is_read_and_whole(tmp_path: Path) -> None:
    save_file(ARRAYS, tmp_path / "file", SEAL.metadata("told", ARRAYS))
    text, arrays, whole = SEAL.read(tmp_path / "file")
    assert (text, whole, SEAL.read_text(tmp_path / "file")) == ("told", True, "told")
    assert {name: array.tolist() for name, array in arrays.items()} == {
        "weights": [[0, 1, 2], [3, 4, 5]],
        "bias": [0, 0],
    }


@pytest.mark.parametrize(
    ("text", "arrays"),
    [
        ("tolt", ARRAYS),
        ("told", {"weights": ARRAYS["weights"], "bjas": ARRAYS["bias"]}),
        ("told", {**ARRAYS, "weights": ARRAYS["weights"].reshape(3, 2)}),
        ("told", {**ARRAYS, "weights": ARRAYS["weights"].view(np.uint32)}),
        ("told", {**ARRAYS, "bias": np.array([0, 1], np.float32)}),
        ("told", {"weights": ARRAYS["weights"]}),
    ],
    ids=["text", "name", "shape", "type", "number", "array missing"],
)
def test_a_change_is_seen(tmp_path: Path, text: str, arrays: Arrays) -> None:
    digest = SEAL.metadata("told", ARRAYS)["digest"]
    save_file(dict(arrays), tmp_path / "file", {"about": text, "digest": digest})
    assert SEAL.read(tmp_path / "file")[2] is False


def test_a_file_without_a_text_is_not_whole(tmp_path: Path) -> None:
    save_file(ARRAYS, tmp_path / "file")
    text, _, whole = SEAL.read(tmp_path / "file")
    assert (text, whole, SEAL.read_text(tmp_path / "file")) == (None, False, None)


def test_what_is_no_such_file_is_a_value_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"no tensors")
    for read in (SEAL.read, SEAL.read_text):
        with pytest.raises(ValueError, match=r"."):
            read(tmp_path / "file")
        with pytest.raises(FileNotFoundError):
            read(tmp_path / "nowhere")


def test_arrays_are_written_little_endian_row_by_row() -> None:
    given = np.asfortranarray(np.arange(6, dtype=">i4").reshape(2, 3))
    assert plain(given, "x").tobytes() == np.arange(6, dtype="<i4").tobytes()
    with pytest.raises(TypeError, match=r"^weights is list"):
        plain([1.0], "weights")  # type: ignore[arg-type]
