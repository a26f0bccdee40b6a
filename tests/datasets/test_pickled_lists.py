"""Ground truth in pickles: every protocol is read, and what a hostile one asks for is named and never run."""

import os
import pickle
import struct
from pathlib import Path

import numpy as np
import pytest
from image_folders import answer, lists

from vprbench.datasets.readers.pickled_lists import read_lists

ADVICE = "get it again"
WANTED = [[0, [0, 1]], [1, []], [2, [1, 2, 700]]]


def write(folder, content):
    """Write a pickle as numpy stores arrays of objects."""
    path = folder / "ground_truth_new.npy"
    with path.open("wb") as file:
        np.lib.format.write_array_header_1_0(file, {"descr": "|O", "fortran_order": False, "shape": (3, 2)})
        file.write(content)
    return path


def refusal(path):
    message = answer(read_lists, path, ADVICE)
    assert message.startswith(str(path))
    assert message.endswith(ADVICE)
    assert message.isprintable()
    return message


def held(kind):
    """The same ground truth as people store it."""
    rows = lists([0, 1], [], [1, 2, 700])
    if kind == "numpy numbers":
        rows[:, 0] = [*np.arange(3)]
        rows[2, 1] = [np.int64(1), np.int32(2), np.uint16(700)]
    if kind == "arrays":
        rows[:, 1] = [np.array(right, dtype) for right, dtype in zip(rows[:, 1], ("i8", "i4", ">u2"), strict=True)]
    if kind == "rows of lists":
        flat = np.empty(3, dtype=object)
        flat[:] = [[query, right] for query, right in WANTED]
        return flat
    if kind == "columns first":
        return np.asfortranarray(rows)
    return rows.tolist() if kind == "a list" else rows


@pytest.mark.parametrize("kind", ["lists", "numpy numbers", "arrays", "rows of lists", "columns first", "a list"])
def test_a_pickle_of_every_protocol_that_numpy_writes_is_read(tmp_path, kind):
    for protocol in range(5):
        content = pickle.dumps(held(kind), protocol=protocol)
        assert read_lists(write(tmp_path, content), ADVICE) == WANTED
        if protocol in (1, 2):  # which state no length of these names
            older = content.replace(b"numpy._core.", b"numpy.core.")
            assert read_lists(write(tmp_path, older), ADVICE) == WANTED
    path = tmp_path / "plain.npy"
    np.save(path, np.zeros((3, 2)))
    assert "plain numbers" in refusal(path)


class Calls:
    """Pickles to a call."""

    def __init__(self, function, *arguments):
        self.call = function, arguments

    def __reduce__(self):
        return self.call


@pytest.mark.parametrize("wrapped", [True, False], ids=["inside an array", "bare"])
@pytest.mark.parametrize("protocol", [0, 4])
@pytest.mark.parametrize(
    ("asked", "call"),
    [
        (f"{os.system.__module__}.system", Calls(os.system, "touch called")),
        ("eval", Calls(eval, "open('called', 'w').close()")),
    ],
)
def test_what_a_pickle_wants_to_call_is_named_and_not_called(tmp_path, monkeypatch, asked, call, protocol, wrapped):
    monkeypatch.chdir(tmp_path)
    path = write(tmp_path, pickle.dumps(lists([0], call) if wrapped else call, protocol=protocol))
    assert f"{asked}, which no list of numbers needs: nothing was run" in refusal(path)
    assert not Path("called").exists()


def stored_array(shape, code, content):
    """Return a pickle of an array whose state is as given."""

    class Array(Calls):
        def __reduce__(self):
            state = (1, shape, np.dtype(code), False, content)
            return np.empty(0).__reduce__()[0], (np.ndarray, (0,), b"b"), state

    return pickle.dumps([Array(None)], protocol=3)


REFUSED = {
    "another name": (b"\x80\x04\x8c\x05numpy\x8c\x0endarray.tofile\x93.", "asks for numpy.ndarray.tofile"),
    "a name that moves the cursor": (b"c\x1b[2Jos\nsystem\n.", r"asks for \x1b[2Jos.system"),
    "an instance": (b"(ios\nsystem\n.", "asks for os.system"),
    "the state of a stand-in": (b"\x80\x02cnumpy\nndarray\n}b.", "cannot be read"),
    "too large a file": (bytes((1 << 24) + 1), "bytes, more than"),
    "a place in the memo beyond the file": (b"\x80\x02Nr\xff\xff\xff\x7f.", "holds a NoneType"),
    "a frame beyond the file": (b"\x80\x04\x95" + struct.pack("<Q", 1 << 40) + b"].", ""),
    "bytes beyond the file": (b"\x80\x04\x8e" + struct.pack("<Q", 1 << 40) + b"x.", ""),
    "lists used again and again": (pickle.dumps([[*range(2100)]] * 2100), "lists of more than 4194304"),
    "an array without content": (stored_array((10**6,), "i8", b"x" * 8), "cannot be read"),
    "an array of three dimensions": (stored_array((1, 1, 1, 1), "i8", b"x" * 8), "holds a list where"),
    "an array of text": (stored_array((1,), "S3", b"abc"), "elements of type S3"),
    "a list in itself": (b"]p0\ng0\na.", "holds a list where"),
    "a number without end": (b"\x80\x02\x8b" + struct.pack("<I", 5000) + b"\x7f" * 5000 + b".", "where an index"),
    "one number": (pickle.dumps(5), "holds one number"),
    "half a pickle": (pickle.dumps(WANTED, protocol=4)[:-7], "cannot be read as pickled lists"),
}


@pytest.mark.parametrize("kind", REFUSED)
def test_a_file_that_asks_for_more_than_numbers_would_fill_the_memory_or_is_no_list_is_refused(tmp_path, kind):
    content, told = REFUSED[kind]
    assert told in refusal(write(tmp_path, content))
