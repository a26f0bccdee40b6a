"""A sealed file of arrays tells any change of text, names, types, shapes and numbers."""

import numpy as np
import pytest
from safetensors.numpy import save_file

from vprbench.storage.tensors import Seal, plain

SEAL = Seal("about", "digest")
ARRAYS = {"weights": np.arange(6, dtype=np.int32).reshape(2, 3), "bias": np.zeros(2, np.float32)}


@pytest.mark.parametrize(
    ("text", "arrays", "whole"),
    [
        ("told", ARRAYS, True),
        ("tolt", ARRAYS, False),
        ("told", {"weights": ARRAYS["weights"], "bjas": ARRAYS["bias"]}, False),
        ("told", {**ARRAYS, "weights": ARRAYS["weights"].reshape(3, 2)}, False),
        ("told", {**ARRAYS, "weights": ARRAYS["weights"].view(np.uint32)}, False),
        ("told", {**ARRAYS, "bias": np.array([0, 1], np.float32)}, False),
        ("told", {"weights": ARRAYS["weights"]}, False),
    ],
    ids=["nothing", "text", "name", "shape", "type", "number", "array missing"],
)
def test_a_change_is_seen(tmp_path, text, arrays, whole):
    digest = SEAL.metadata("told", ARRAYS)["digest"]
    save_file(dict(arrays), tmp_path / "file", {"about": text, "digest": digest})
    found, read, same = SEAL.read(tmp_path / "file")
    assert (found, same, SEAL.read_text(tmp_path / "file")) == (text, whole, text)
    assert {name: array.tolist() for name, array in read.items()} == {name: a.tolist() for name, a in arrays.items()}


def test_a_file_without_a_text_is_not_whole_and_what_is_no_such_file_is_a_value_error(tmp_path):
    save_file(ARRAYS, tmp_path / "file")
    text, _, whole = SEAL.read(tmp_path / "file")
    assert (text, whole, SEAL.read_text(tmp_path / "file")) == (None, False, None)
    (tmp_path / "file").write_bytes(b"no tensors")
    for read in (SEAL.read, SEAL.read_text):
        with pytest.raises(ValueError, match=r"."):
            read(tmp_path / "file")
        with pytest.raises(FileNotFoundError):
            read(tmp_path / "nowhere")


def test_arrays_are_written_little_endian_row_by_row():
    given = np.asfortranarray(np.arange(6, dtype=">i4").reshape(2, 3))
    assert plain(given, "x").tobytes() == np.arange(6, dtype="<i4").tobytes()
    for wrong in ([1.0], np.array(["1"])):
        with pytest.raises(TypeError, match=r"^weights is (list|<U1)"):
            plain(wrong, "weights")  # type: ignore[arg-type]
