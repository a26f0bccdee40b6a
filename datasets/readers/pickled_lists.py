"""Lists of numbers out of a pickle from anywhere: nothing that it names is ever run, and its size bounds the memory.

A pickle is a program that calls what it names. Here the few names that numpy's arrays need lead to stand-ins, which
only keep what they are given; every other name is refused.
"""

from __future__ import annotations

import io
import pickle
import pickletools
import re
from dataclasses import dataclass
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
    """Return the pickle in a .npy file; raises BadInput where it holds plain numbers instead."""
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


@dataclass
class _Kind:
    """Stands for numpy.dtype: its code, as in i8, and byte order."""

    code: Any
    align: Any = None
    copy: Any = None
    order: str = "<"

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        self.order = ">" if state[1] == ">" else "<"


@dataclass
class _Array:
    """Stands for an array, which may be made empty and told its content afterwards; a number has the shape ()."""

    shape: Any = None
    kind: Any = None
    columns_first: bool = False
    content: Any = None  # bytes, text of such bytes, or a list of objects

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        self.shape, self.kind, self.columns_first, self.content = state[-4:]

    def check(self) -> int:
        """Return how many elements there are; raises ValueError for an impossible number, or another content."""
        shape, code = self.shape, self.kind.code
        if not (isinstance(shape, tuple) and len(shape) <= 2 and all(isinstance(n, int) for n in shape)):
            raise ValueError("it holds an array that is neither a list nor a table")
        count = prod(shape)
        if shape and not 0 <= min(shape) <= max(shape) <= min(count, _MOST_STEPS):
            raise ValueError("it holds an array of an impossible shape")
        if not isinstance(code, str) or not (self.of_objects or _NUMBER.fullmatch(code)):
            raise ValueError(f"it holds elements of type {str(code)[:20]}")
        size = 1 if self.of_objects else np.dtype(code).itemsize
        if not isinstance(self.content, list if self.of_objects else str | bytes | bytearray) or (
            len(self.content) != count * size
        ):
            raise ValueError(f"it holds an array of shape {shape} with other content")
        return count

    @property
    def of_objects(self) -> bool:
        return isinstance(self.kind.code, str) and self.kind.code.startswith("O")

    def lists(self) -> Any:
        """Return the elements as a number, a list or a list of rows."""
        if self.of_objects:
            width = self.shape[-1]
            rows = [self.content[start : start + width] for start in range(0, len(self.content), width)]
            return rows if len(self.shape) == 2 else self.content
        encoded = self.content.encode("latin1") if isinstance(self.content, str) else self.content
        numbers = np.frombuffer(encoded, self.kind.order + self.kind.code)
        return numbers.reshape(self.shape, order="F" if self.columns_first else "C").tolist()


def _text(text: Any, encoding: Any) -> Any:
    """Return bytes that an older pickle wrote as text as that text: they are encoded when their number is known."""
    if encoding != "latin1":
        raise ValueError("its bytes are written as text of another encoding than latin1")
    return text


_STAND_INS: dict[str, Any] = {
    "numpy.ndarray": _Array,
    "numpy.dtype": _Kind,
    "numpy.core.multiarray._reconstruct": lambda *_: _Array(),
    "numpy.core.multiarray.scalar": lambda kind, content: _Array((), kind, False, content),
    "numpy.core.numeric._frombuffer": lambda content, kind, shape, order: _Array(shape, kind, order == "F", content),
    "_codecs.encode": _text,
    "builtins.bytes": lambda: b"",
    "__builtin__.bytes": lambda: b"",
}


class _Unpickler(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> Any:
        """Return a stand-in for whatever the pickle names; raises _RefusedError for a name that has none."""
        asked = f"{module}.{name}"
        known = _STAND_INS.get(asked.replace("numpy._core.", "numpy.core.", 1))
        if known is None:
            raise _RefusedError(f"asks for {ascii(asked)[1:-1][:100]}, which no list of numbers needs")
        return known


class _Plain:
    """Turns what a pickle made into nested lists; a list that it uses many times counts as often."""

    def __init__(self) -> None:
        self._left = _MOST_STEPS

    def of(self, made: Any, depth: int) -> Any:
        self._left -= made.check() if isinstance(made, _Array) and not made.of_objects else 1
        if self._left < 0:
            raise _RefusedError(f"makes lists of more than {_MOST_STEPS} numbers")
        if isinstance(made, int | float):
            if not abs(made) < 2**63:
                raise ValueError("it holds a number that is no index")
            return made
        if isinstance(made, _Array) and (depth or made.shape == ()):
            made.check()
            return self.of(made.lists(), depth) if made.of_objects else made.lists()
        if depth == 0 or not isinstance(made, list | tuple):
            kind = "list" if isinstance(made, list | tuple | _Array) else type(made).__name__
            raise ValueError(f"a {kind} stands where a number {'was' if depth == 0 else 'or a list was'} expected")
        return [self.of(element, depth - 1) for element in made]
