"""Lists of numbers out of a pickle from anywhere: nothing that it names is ever run, and its size bounds the memory.

A pickle is a program that calls what it names. Here the few names that numpy's arrays need lead to stand-ins, which
only keep what they are given; every other name is refused.
"""

from __future__ import annotations

import io
import pickle
import pickletools
import re
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from vprbench.api import BadInput

_MOST_BYTES = 1 << 24
_MOST_STEPS = 1 << 22  # of the pickle's program, and numbers in what it makes
_DEPTH = 3  # a list of rows of lists of numbers
_OBJECTS = re.compile(rb"""\x93NUMPY.*?['"]descr['"]\s*:\s*['"]\|?O['"]""", re.DOTALL)
_NUMBER = re.compile("[iuf][1248]")
_STEPS = (
    "PROTO FRAME STOP MARK POP POP_MARK DUP NONE NEWTRUE NEWFALSE INT BININT BININT1 BININT2 LONG LONG1 LONG4 "
    "FLOAT BINFLOAT STRING BINSTRING SHORT_BINSTRING BINBYTES SHORT_BINBYTES BINBYTES8 BYTEARRAY8 UNICODE BINUNICODE "
    "SHORT_BINUNICODE BINUNICODE8 EMPTY_LIST LIST APPEND APPENDS EMPTY_TUPLE TUPLE TUPLE1 TUPLE2 TUPLE3 PUT BINPUT "
    "LONG_BINPUT MEMOIZE GET BINGET LONG_BINGET GLOBAL STACK_GLOBAL REDUCE BUILD"
)
_KNOWN_STEPS = frozenset(_STEPS.split())


def read_lists(path: Path, advice: str) -> list[Any]:
    """Return the nested lists of numbers that a .npy file of objects, or a bare pickle, holds, three deep at most.

    Raises BadInput, with `advice`, for a pickle that asks for anything but numpy's arrays, that is too large or
    damaged, or that holds something else.
    """
    if path.stat().st_size > _MOST_BYTES:
        raise BadInput(f"{path} has {path.stat().st_size} bytes, more than the {_MOST_BYTES} that are read: {advice}")
    content = _without_header(path, path.read_bytes(), advice)
    try:
        _check_steps(content)
        plain = _Plain().of(_Unpickler(io.BytesIO(content), encoding="latin1").load(), _DEPTH)
    except _RefusedError as error:
        raise BadInput(f"{path} {error}; nothing was run: {advice}") from error
    except Exception as error:  # a damaged pickle can fail in any way
        reason = (str(error).splitlines() or [""])[0] or type(error).__name__
        raise BadInput(f"{path} cannot be read as pickled lists of numbers ({reason[:200]}): {advice}") from error
    if not isinstance(plain, list):
        raise BadInput(f"{path} holds one number, not a list: {advice}")
    return plain


class _RefusedError(Exception):
    """The pickle asks for something that no list of numbers needs."""


def _without_header(path: Path, content: bytes, advice: str) -> bytes:
    """Return the pickle in a .npy file; raises BadInput if it holds plain numbers instead."""
    if not content.startswith(b"\x93NUMPY"):
        return content
    digits = 2 if content[6:7] == b"\x01" else 4
    start = 8 + digits + int.from_bytes(content[8 : 8 + digits], "little")
    if not _OBJECTS.match(content[:start]):
        raise BadInput(f"{path} holds an array of plain numbers, where lists of different lengths are wanted: {advice}")
    return content[start:]


def _check_steps(content: bytes) -> None:
    """Walk through the pickle's program without running it; raises _RefusedError for steps that lists do not need."""
    for number, (step, argument, _) in enumerate(pickletools.genops(content)):
        if step.name not in _KNOWN_STEPS:
            raise _RefusedError(f"asks for the step {step.name}, which no list of numbers needs")
        if number > _MOST_STEPS:
            raise _RefusedError(f"has more than {_MOST_STEPS} steps")
        # The unpickler makes room for the highest number of a place in its memo.
        if step.name in ("PUT", "BINPUT", "LONG_BINPUT") and not 0 <= (argument or 0) <= number:
            raise _RefusedError(f"asks for {step.name} {argument}, beyond its own size")


class _Made:
    """Stands for an array or its dtype: keeps what it is made of, and the state that it is told afterwards."""

    def __init__(self, *arguments: Any) -> None:
        self.arguments = arguments
        self.state: tuple[Any, ...] = ()

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        self.state = state

    def content(self) -> Any:
        """Return an array of numbers, or of objects the list or the list of rows; raises ValueError for another."""
        shape, kind, columns_first, stored = self.state[-4:]  # stored: bytes, text of such bytes, or a list of objects
        code, order = kind.arguments[0], ">" if kind.state[1] == ">" else "<"
        objects = str(code).startswith("O")
        if not (isinstance(shape, tuple) and len(shape) <= 2 and all(isinstance(n, int) for n in shape)):
            raise ValueError("it holds an array that is neither a list nor a table")
        count = prod(shape)
        if shape and not 0 <= min(shape) <= max(shape) <= min(count, _MOST_STEPS):
            raise ValueError("it holds an array of an impossible shape")
        if not objects and not _NUMBER.fullmatch(code):
            raise ValueError(f"it holds elements of type {str(code)[:20]}")
        if not isinstance(stored, list if objects else str | bytes | bytearray) or (
            len(stored) != count * (1 if objects else np.dtype(code).itemsize)
        ):
            raise ValueError(f"it holds an array of shape {shape} with other content")
        if objects:
            width = shape[-1]
            return [stored[at : at + width] for at in range(0, count, width)] if len(shape) == 2 else stored
        encoded = stored.encode("latin1") if isinstance(stored, str) else bytes(stored)
        return np.frombuffer(encoded, order + code).reshape(shape, order="F" if columns_first else "C")


def _array_of(shape: Any, kind: Any, columns_first: bool, stored: Any) -> _Made:
    array = _Made()
    array.state = shape, kind, columns_first, stored
    return array


def _text(text: Any, encoding: Any) -> Any:
    """Return bytes that an older pickle wrote as text as that text: they are encoded when their number is known."""
    if encoding != "latin1":
        raise ValueError("its bytes are written as text of another encoding than latin1")
    return text


_STAND_INS: dict[str, Any] = {
    "numpy.ndarray": _Made,
    "numpy.dtype": _Made,
    "numpy.core.multiarray._reconstruct": _Made,
    "numpy.core.multiarray.scalar": lambda kind, stored: _array_of((), kind, False, stored),
    "numpy.core.numeric._frombuffer": lambda stored, kind, shape, order: _array_of(shape, kind, order == "F", stored),
    "_codecs.encode": _text,
    "builtins.bytes": lambda: b"",
    "__builtin__.bytes": lambda: b"",
}


class _Unpickler(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> Any:
        """Return a stand-in for whatever the pickle names; raises _RefusedError for a name that has none."""
        named = f"{module}.{name}"
        known = _STAND_INS.get(named.replace("numpy._core.", "numpy.core.", 1))
        if known is None:
            raise _RefusedError(f"asks for {ascii(named)[1:-1][:100]}, which no list of numbers needs")
        return known


class _Plain:
    """Turns what a pickle made into nested lists; a list that it uses many times counts as often."""

    def __init__(self) -> None:
        self._left = _MOST_STEPS

    def of(self, made: Any, depth: int) -> Any:
        if isinstance(made, _Made):
            made = made.content()
        self._left -= made.size if isinstance(made, np.ndarray) else 1
        if self._left < 0:
            raise _RefusedError(f"makes lists of more than {_MOST_STEPS} numbers")
        if isinstance(made, np.ndarray) and (depth or not made.ndim):
            return made.tolist()
        if isinstance(made, int | float):
            if not abs(made) < 2**63:
                raise ValueError("it holds a number that is no index")
            return made
        if depth == 0 or not isinstance(made, list | tuple):
            raise ValueError(f"it holds a {type(made).__name__} where a number or a list of numbers was expected")
        return [self.of(element, depth - 1) for element in made]
