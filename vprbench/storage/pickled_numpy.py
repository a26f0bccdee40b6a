"""NumPy's scalars and arrays in files of torch, read as plain numbers: NumPy itself unpickles nothing."""

from __future__ import annotations

import math
import pickle
import re
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any

import numpy as np

_NUMBERS = re.compile(r"[biufc]\d{1,2}|[SU]\d{1,4}")


class Kind:
    """What a pickle calls numpy.dtype: the name of a type, and the order of its bytes."""

    def __init__(self, name: Any, align: Any = False, copy: Any = False) -> None:
        self.name, self.order = str(name), "="

    def __setstate__(self, state: Any) -> None:
        self.order = str(state[1])


class Array(np.ndarray):
    """What a pickle calls numpy.ndarray: an array of numbers or text."""

    def __setstate__(self, state: Any) -> None:
        _, shape, kind, column_major, content = state
        dtype = _checked(kind, content, math.prod(shape))
        super().__setstate__((1, tuple(shape), dtype, bool(column_major), content))  # type: ignore[arg-type]


def scalar(kind: Any, content: Any) -> Any:
    """Return the number or the text that a pickled scalar holds; raises UnpicklingError for any other."""
    return np.frombuffer(content, _checked(kind, content, 1))[0].item()


def array(*_: Any) -> Array:
    """Return the empty array that a pickle begins with."""
    return Array(0, np.uint8)


def readable() -> AbstractContextManager[None]:
    """Let torch take scalars and arrays within this context, under the names of NumPy before 2.0 and since.

    If the caller lets it take NumPy's own types already, nothing changes.
    """
    from torch import serialization  # slow to import

    known = np.dtype in serialization.get_safe_globals()
    return serialization.safe_globals([] if known else _GLOBALS)


def _checked(kind: Any, content: Any, n_values: int) -> np.dtype[Any]:
    """Return the type of so many pickled values; raises UnpicklingError if these are no plain ones."""
    known = isinstance(kind, Kind) and isinstance(content, bytes) and _NUMBERS.fullmatch(kind.name)
    if not known or kind.order not in ("<", ">", "=", "|"):
        raise pickle.UnpicklingError("GLOBAL numpy.dtype of no plain number")
    dtype: np.dtype[Any] = np.dtype(kind.order + kind.name)
    if len(content) != n_values * dtype.itemsize:
        raise pickle.UnpicklingError("values of another length than their type")
    return dtype


_GLOBALS: list[Callable[..., Any] | tuple[Callable[..., Any], str]] = [
    (Kind, "numpy.dtype"),
    (Array, "numpy.ndarray"),
    *((scalar, f"numpy.{package}.multiarray.scalar") for package in ("core", "_core")),
    *((array, f"numpy.{package}.multiarray._reconstruct") for package in ("core", "_core")),
]
