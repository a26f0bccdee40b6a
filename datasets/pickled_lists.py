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
from typing import Any, cast

import numpy as np
import numpy.typing as npt

from vprbench.api import BadInput

_MOST_BYTES = 1 << 24
_MOST_STEPS = 1 << 22  # of the pickle's program, and numbers in what it makes
_DEPTH = 3  # a list of rows of lists of numbers
_MAGIC = b"\x93NUMPY"

_STEPS = (
    "PROTO FRAME STOP MARK POP POP_MARK DUP NONE NEWTRUE NEWFALSE INT BININT BININT1 BININT2 LONG LONG1 LONG4 "
    "FLOAT BINFLOAT STRING BINSTRING SHORT_BINSTRING BINBYTES SHORT_BINBYTES BINBYTES8 BYTEARRAY8 UNICODE BINUNICODE "
    "SHORT_BINUNICODE BINUNICODE8 EMPTY_LIST LIST APPEND APPENDS EMPTY_TUPLE TUPLE TUPLE1 TUPLE2 TUPLE3 PUT BINPUT "
    "LONG_BINPUT MEMOIZE GET BINGET LONG_BINGET GLOBAL STACK_GLOBAL REDUCE BUILD"
)
_KNOWN_STEPS = frozenset(_STEPS.split())
_WORDS = ("UNICODE", "BINUNICODE", "SHORT_BINUNICODE", "BINUNICODE8")
_TO_MEMO = ("PUT", "BINPUT", "LONG_BINPUT", "MEMOIZE")
_NUMBER = re.compile("[iuf][1248]")


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
        made = _Unpickler(io.BytesIO(content), encoding="latin1").load()
        plain = _Plain().of(made, _DEPTH)
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
    if not content.startswith(_MAGIC):
        return content
    digits = 2 if content[6:7] == b"\x01" else 4
    start = 8 + digits + int.from_bytes(content[8 : 8 + digits], "little")
    if not re.search(rb"""['"]descr['"]\s*:\s*['"]\|?O['"]""", content[:start]):
        raise BadInput(f"{path} holds an array of plain numbers, where lists of different lengths are wanted: {advice}")
    return content[start:]


def _check_steps(content: bytes) -> None:
    """Walk through the pickle's program without running it; raises _RefusedError for steps that lists do not need."""
    words: list[str] = []  # put on the stack one right after the other
    for number, (step, argument, _) in enumerate(pickletools.genops(content)):
        if step.name == "GLOBAL":
            _stand_in(*str(argument).split(" ", 1))
        elif step.name == "STACK_GLOBAL" and len(words) > 1:
            _stand_in(*words[-2:])
        if step.name in _WORDS:
            words.append(str(argument))
        elif step.name not in _TO_MEMO:
            words.clear()
        if step.name not in _KNOWN_STEPS:
            raise _RefusedError(f"asks for the step {step.name}, which no list of numbers needs")
        if number > _MOST_STEPS:
            raise _RefusedError(f"has more than {_MOST_STEPS} steps")
        # The unpickler makes room for the highest number that a memo or a frame names.
        limit = len(content) if step.name == "FRAME" else number
        if step.name in (*_TO_MEMO[:3], "FRAME") and not 0 <= cast(int, argument) <= limit:
            raise _RefusedError(f"asks for {step.name} {argument}, beyond its own size")


@dataclass
class _Type:
    """Stands for numpy.dtype: its code, as in i8, and byte order."""

    code: Any
    align: Any = None
    copy: Any = None
    order: str = "<"

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        self.order = ">" if state[1] == ">" else "<"

    @property
    def holds_objects(self) -> bool:
        return isinstance(self.code, str) and self.code.startswith("O")

    def of_numbers(self) -> np.dtype[Any]:
        if not (isinstance(self.code, str) and _NUMBER.fullmatch(self.code)):
            raise ValueError(f"it holds elements of type {str(self.code)[:20]}")
        return np.dtype(self.order + self.code)


class _Array:
    """Stands for an array that is made empty and told its content afterwards."""

    shape: Any = None
    type: Any = None
    columns_first: bool = False
    content: Any = None

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        self.shape, self.type, self.columns_first, self.content = state[-4:]


@dataclass(frozen=True)
class _Text:
    """Stands for bytes that an older pickle wrote as text; encoded when its size is known to fit."""

    text: str


@dataclass(frozen=True)
class _Scalar:
    type: _Type
    content: Any


def _array(*_: Any) -> _Array:
    return _Array()


def _array_of_buffer(content: Any, kind: Any, shape: Any, order: Any) -> _Array:
    made = _Array()
    made.__setstate__((shape, kind, order == "F", content))
    return made


def _text(text: Any, encoding: Any) -> _Text:
    if encoding != "latin1" or not isinstance(text, str):
        raise ValueError("its bytes are written as text of another encoding than latin1")
    return _Text(text)


def _no_bytes() -> bytes:
    return b""


_STAND_INS: dict[str, Any] = {
    "numpy.ndarray": _Array,
    "numpy.dtype": _Type,
    "numpy.core.multiarray._reconstruct": _array,
    "numpy.core.multiarray.scalar": _Scalar,
    "numpy.core.numeric._frombuffer": _array_of_buffer,
    "_codecs.encode": _text,
    "builtins.bytes": _no_bytes,
    "__builtin__.bytes": _no_bytes,
}


def _stand_in(module: str, name: str) -> Any:
    """Return the stand-in of a name; raises _RefusedError, with the name, for every other."""
    asked = f"{module}.{name}"
    known = _STAND_INS.get(asked.replace("numpy._core.", "numpy.core.", 1))
    if known is None:
        raise _RefusedError(f"asks for {ascii(asked)[1:-1][:100]}, which no list of numbers needs")
    return known


class _Unpickler(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> Any:
        """Return a stand-in for whatever the pickle names; raises _RefusedError for a name that has none."""
        return _stand_in(module, name)


class _Plain:
    """Turns what a pickle made into nested lists; a list that it uses many times counts as often."""

    def __init__(self) -> None:
        self._left = _MOST_STEPS

    def of(self, made: Any, depth: int) -> Any:
        if isinstance(made, int | float):
            self._take(1)
            if not abs(made) < 2**63:
                raise ValueError("it holds a number that is no index")
            return made
        if isinstance(made, _Scalar):
            return self._numbers(made.type, made.content, 1)[0].item()
        if depth == 0 or not isinstance(made, list | tuple | _Array):
            kind = (
                "a list" if isinstance(made, list | tuple | _Array) else f"a {type(made).__name__.lstrip('_').lower()}"
            )
            raise ValueError(f"{kind} stands where a number {'was' if depth == 0 else 'or a list was'} expected")
        if not isinstance(made, _Array):
            self._take(1)
            return [self.of(element, depth - 1) for element in made]
        shape = made.shape
        if not (isinstance(shape, tuple) and 1 <= len(shape) <= 2 and all(isinstance(n, int) for n in shape)):
            raise ValueError("it holds an array that is neither a list nor a table")
        if not 0 <= min(shape) <= max(shape) <= min(prod(shape), _MOST_STEPS):
            raise ValueError("it holds an array of an impossible shape")
        if not made.type.holds_objects:
            numbers = self._numbers(made.type, made.content, prod(shape))
            return np.reshape(numbers, shape, order="F" if made.columns_first else "C").tolist()
        if not isinstance(made.content, list) or len(made.content) != prod(shape):
            raise ValueError(f"it holds an array of shape {shape} with other content")
        if len(shape) == 1:
            return self.of(made.content, depth)
        width = shape[1]
        return self.of([made.content[start : start + width] for start in range(0, prod(shape), width)], depth)

    def _numbers(self, kind: _Type, content: Any, count: int) -> npt.NDArray[Any]:
        """Return the numbers in the bytes of an array."""
        self._take(count)
        encoded = content.text if isinstance(content, _Text) else content
        dtype = kind.of_numbers()
        if not isinstance(encoded, str | bytes | bytearray) or len(encoded) != count * dtype.itemsize:
            raise ValueError(f"it holds an array of {count} numbers with other content")
        return np.frombuffer(encoded.encode("latin1") if isinstance(encoded, str) else encoded, dtype)

    def _take(self, count: int) -> None:
        self._left -= count
        if self._left < 0:
            raise _RefusedError(f"makes lists of more than {_MOST_STEPS} numbers")
