"""Ground truth in pickles: every protocol is read, and what a hostile one asks for is named and never run."""

import functools
import io
import os
import pickle
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from image_folders import lists

from vprbench.datasets.readers.pickled_lists import read_lists
from vprbench.errors import BadInput

quiet = settings(derandomize=True, deadline=None, database=None, max_examples=150)
ADVICE = "get it again"
WANTED = [[0, [0, 1]], [1, []], [2, [1, 2, 700]]]


def refusal(path):
    with pytest.raises(BadInput) as error:
        read_lists(path, ADVICE)
    message = str(error.value)
    assert message.startswith(str(path))
    assert message.endswith(ADVICE)
    assert message.isprintable()
    return message


@pytest.fixture
def write(tmp_path):
    """A function that writes a file and returns its path."""

    def write(content):
        path = tmp_path / "ground_truth_new.npy"
        path.write_bytes(content)
        return path

    return write


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


KINDS = ["lists", "numpy numbers", "arrays", "rows of lists", "columns first", "a list"]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("protocol", range(6))
def test_a_bare_pickle_of_every_protocol_is_read(write, kind, protocol):
    assert read_lists(write(pickle.dumps(held(kind), protocol=protocol)), ADVICE) == WANTED


@pytest.mark.parametrize("kind", KINDS[:-1])
@pytest.mark.parametrize("version", [(1, 0), (2, 0)])
def test_a_file_that_numpy_wrote_is_read(tmp_path, kind, version):
    path = tmp_path / "ground_truth_new.npy"
    with path.open("wb") as file:
        np.lib.format.write_array(file, held(kind), version=version, allow_pickle=True)
    assert read_lists(path, ADVICE) == WANTED


def test_the_older_module_names_of_numpy_are_known(write):
    content = pickle.dumps(held("numpy numbers"), protocol=2)
    assert b"numpy._core." in content
    assert read_lists(write(content.replace(b"numpy._core.", b"numpy.core.")), ADVICE) == WANTED


def test_bytes_that_python_2_wrote_as_text_are_numbers(write):
    # array([5, 200]) as int16, protocol 2, the bytes as SHORT_BINSTRING: 05 00 c8 00
    content = (
        b"\x80\x02]q\x00cnumpy.core.multiarray\n_reconstruct\nq\x01cnumpy\nndarray\nq\x02K\x00\x85q\x03U\x01bq\x04"
        b"\x87Rq\x05(K\x01K\x02\x85q\x06cnumpy\ndtype\nq\x07U\x02i2K\x00K\x01\x87Rq\x08(K\x03U\x01<NNN"
        b"J\xff\xff\xff\xffJ\xff\xff\xff\xffK\x00tb\x89U\x04\x05\x00\xc8\x00tba."
    )
    assert read_lists(write(content), ADVICE) == [[5, 200]]


class Calls:
    """Pickles to a call."""

    def __init__(self, function, *arguments):
        self.call = function, arguments

    def __reduce__(self):
        return self.call


@pytest.mark.parametrize("wrapped", [True, False], ids=["inside an array", "bare"])
@pytest.mark.parametrize("protocol", [0, 2, 4])
@pytest.mark.parametrize("kind", ["os.system", "eval", "partial", "open"])
def test_what_a_pickle_wants_to_call_is_named_and_not_called(tmp_path, monkeypatch, kind, protocol, wrapped):
    monkeypatch.chdir(tmp_path)
    code = "open('called', 'w').close()"
    asked, call = {
        "os.system": (f"{os.system.__module__}.system", Calls(os.system, "touch called")),
        "eval": ("eval", Calls(eval, code)),
        "partial": ("DICT", Calls(functools.partial(eval, code))),
        "open": ("open", Calls(open, "called", "w")),
    }[kind]
    content = pickle.dumps(lists([0], call) if wrapped else call, protocol=protocol)
    Path("stored").write_bytes(content)
    step = (
        "the step DICT" if (kind, protocol) == ("partial", 0) else "the step EMPTY_DICT" if kind == "partial" else asked
    )
    assert f"{step}, which no list of numbers needs; nothing was run" in refusal(Path("stored"))
    assert not Path("called").exists()


@pytest.mark.parametrize(
    ("content", "asked"),
    [
        (b"c__builtin__\ngetattr\n(cos\nsystem\nS'x'\ntR.", "__builtin__.getattr"),
        (b"\x80\x04\x8c\x05numpy\x8c\x0endarray.tofile\x93.", "numpy.ndarray.tofile"),
        (b"c\x1b[2Jos\nsystem\n.", r"\x1b[2Jos.system"),
        (b"ios\nsystem\n(S'true'\no.", "INST"),
        (b"\x80\x02\x82\x01.", "EXT1"),
        (b"Pmodule\n.", "PERSID"),
        (b"\x80\x04\x8f.", "EMPTY_SET"),
        (b"\x80\x02cnumpy\nndarray\n)\x81.", "NEWOBJ"),
    ],
)
def test_what_a_handwritten_pickle_asks_for_is_named(write, content, asked):
    assert f"asks for {asked}" in refusal(write(content)).replace("the step ", "")


def stored_array(shape, code, content):
    """Return a pickle of an array whose state is as given."""

    class Array(Calls):
        def __reduce__(self):
            state = (1, shape, np.dtype(code), False, content)
            return np.empty(0).__reduce__()[0], (np.ndarray, (0,), b"b"), state

    return pickle.dumps([Array(None)], protocol=3)


def plain_array():
    """Return a .npy file of numbers."""
    file = io.BytesIO()
    np.save(file, np.zeros((3, 2)))
    return file.getvalue()


SHARED = [[*range(3000)]] * 3000  # nine million numbers in a few kilobytes
BOMBS = {
    "too large a file": bytes((1 << 24) + 1),
    "an array of plain numbers": plain_array(),
    "a place in the memo beyond the file": b"\x80\x02Nr\xff\xff\xff\x7f.",
    "a place in the memo, as text": b"Np99999999999\n.",
    "a frame beyond the file": b"\x80\x04\x95" + struct.pack("<Q", 1 << 40) + b"].",
    "bytes beyond the file": b"\x80\x04\x8e" + struct.pack("<Q", 1 << 40) + b"x.",
    "text beyond the file": b"\x80\x02X\xff\xff\xff\x7fx.",
    "lists used again and again": pickle.dumps(SHARED),
    "arrays used again and again": pickle.dumps([np.zeros(3000)] * 3000),
    "an array of empty rows": stored_array((10**12, 0), "i8", b""),
    "an array without content": stored_array((10**12,), "i8", b""),
    "an array of objects without content": stored_array((10**12,), "O", []),
    "an array of negative shape": stored_array((-1,), "i8", b""),
    "an array of structures": stored_array((1,), [("a", "i8"), ("b", "O")], b"x" * 16),
    "an array of text": stored_array((1,), "S3", b"abc"),
    "an array whose bytes are no whole numbers": stored_array((2,), "i8", b"x" * 15),
    "an array that is made at once": b"\x80\x02cnumpy\nndarray\n\x8a\x06\x00\x00\x00\x00\x00\x10\x85R.",
    "a list in itself": b"]p0\ng0\na.",
    "lists four deep": pickle.dumps([[0, [[1]]]]),
    "a number without end": b"\x80\x02\x8b" + struct.pack("<I", 5000) + b"\x7f" * 5000 + b".",
    "a word": pickle.dumps([[0, ["1"]]]),
    "one number": pickle.dumps(5),
    "nothing": b"",
    "no pickle": b"not a pickle at all",
    "half a pickle": pickle.dumps(WANTED, protocol=4)[:-7],
}


TOLD = {
    "too large a file": f"has {(1 << 24) + 1} bytes",
    "an array of plain numbers": "plain numbers",
    "a place in the memo beyond the file": "LONG_BINPUT 2147483647, beyond",
    "a place in the memo, as text": "PUT 99999999999, beyond",
}


@pytest.mark.parametrize("kind", BOMBS)
def test_a_file_that_would_fill_the_memory_or_is_no_list_is_refused(write, kind):
    assert TOLD.get(kind, "") in refusal(write(BOMBS[kind]))


HONEST = [pickle.dumps(held(kind), protocol=protocol) for kind in KINDS for protocol in (0, 2, 4)]


@quiet
@given(
    st.sampled_from(HONEST),
    st.lists(st.tuples(st.integers(0, 1 << 16), st.integers(0, 255)), min_size=1, max_size=4),
    st.integers(0, 400),
)
def test_a_damaged_pickle_is_read_as_lists_or_refused(tmp_path_factory, content, changes, cut):
    damaged = bytearray(content)
    for at, byte in changes:
        damaged[at % len(damaged)] = byte
    path = tmp_path_factory.getbasetemp() / "damaged"
    path.write_bytes(damaged[: len(damaged) - cut] if cut < 20 else damaged)
    try:
        read = read_lists(path, ADVICE)
    except BadInput:
        return
    assert isinstance(read, list)
