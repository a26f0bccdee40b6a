"""Lists of numbers from a pickle of unknown origin: nothing that it names is run, and its size bounds the memory.

A pickle is a program that calls what it names. The names that numpy's arrays need lead to stand-ins for an array and
its type; every other name is refused.
"""

from __future__ import annotations

import pickle
import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as npy

from vprbench.api import BadInput

_MOST_BYTES = 1 << 24  # of a file
_MOST_NUMBERS = 1 << 22
_DEPTH = 3  # a list of rows of lists of numbers
_NUMBER = re.compile("[iuf][1248]")


def read_lists(path: Path, advice: str) -> list[Any]:
    """Return the nested lists of numbers that a .npy file of objects holds, three deep at most.

    Raises BadInput, with `advice`, for a pickle that names anything but numpy's arrays, that is too large or damaged,
    or that holds something else.
    """
    if path.stat().st_size > _MOST_BYTES:
        raise BadInput(f"{path} has {path.stat().st_size} bytes, more than the {_MOST_BYTES} that are read: {advice}")
    try:
        with path.open("rb") as file:
            read_header = npy.read_array_header_1_0 if npy.read_magic(file) == (1, 0) else npy.read_array_header_2_0
            if read_header(file)[2] != np.dtype(object):
                raise ValueError("it holds an array of plain numbers, where lists of different lengths are wanted")
            lists = _copy_numbers(_Unpickler(file, encoding="latin1").load(), _DEPTH, [_MOST_NUMBERS])
    except Exception as error:  # a damaged pickle can fail in any way
        reason = (str(error).splitlines() or [""])[0] or type(error).__name__
        raise BadInput(f"{path} cannot be read as pickled lists of numbers ({reason[:200]}): {advice}") from error
    if not isinstance(lists, list):
        raise BadInput(f"{path} holds one number, not a list: {advice}")
    return lists


class _Type:
    """Stands for a dtype."""

    def __init__(self, code: str, *_: Any) -> None:
        self.code = code

    def __setstate__(self, state: Any) -> None:
        self.code = state[1].replace("|", "") + self.code  # the order of its bytes


class _Array(list[Any]):
    """Stands for an array: the nested list of its elements."""

    def __init__(self, *_: Any) -> None:
        """Begin empty; the elements come as the state."""

    def __setstate__(self, state: Any) -> None:
        _, shape, kind, columns_first, content = state
        self[:] = _list_elements(shape, kind, "F" if columns_first else "C", content)


def _list_elements(shape: Any, kind: _Type, order: Any, content: Any) -> Any:
    """Return the elements of an array, nested as `shape` says: a number for the shape ()."""
    if kind.code.startswith("O"):  # row by row in any case
        return np.fromiter(content, object, len(content)).reshape(shape).tolist()
    if not _NUMBER.fullmatch(kind.code.lstrip("<>")):
        raise ValueError(f"it holds elements of type {kind.code[:20]}")
    return np.frombuffer(content, kind.code).reshape(shape, order=order).tolist()


_STAND_INS: dict[str, Any] = {
    "numpy.ndarray": _Array,
    "numpy.dtype": _Type,
    "numpy.core.multiarray._reconstruct": _Array,
    "numpy.core.multiarray.scalar": lambda kind, content: _list_elements((), kind, "C", content),
    "_codecs.encode": lambda text, encoding: text.encode({"latin1": "latin1"}[encoding]),  # bytes of protocol 2
    "__builtin__.bytes": lambda: b"",
}


class _Unpickler(pickle._Unpickler):
    """The unpickler in Python, for the one in C makes room for any place in its memo that a pickle names."""

    def find_class(self, module: str, name: str) -> Any:
        """Return the stand-in for a name; raises ValueError for a name that has none."""
        named = f"{module}.{name}"
        known = _STAND_INS.get(named.replace("numpy._core.", "numpy.core.", 1))
        if known is None:
            raise ValueError(f"it asks for {ascii(named)[1:-1][:100]}, which no list of numbers needs: nothing was run")
        return known


def _copy_numbers(made: Any, depth: int, left: list[int]) -> Any:
    """Return nested lists of numbers as plain lists; a list that stands in many places counts as often.

    `left` holds how many numbers and lists may still come. Raises ValueError for anything else.
    """
    left[0] -= 1
    if left[0] < 0:
        raise ValueError(f"it makes lists of more than {_MOST_NUMBERS} numbers")
    if isinstance(made, int | float) and abs(made) < 2**63:
        return made
    if depth == 0 or not isinstance(made, list | tuple):
        raise ValueError(f"it holds a {type(made).__name__} where an index or a list of numbers was expected")
    return [_copy_numbers(element, depth - 1, left) for element in made]
