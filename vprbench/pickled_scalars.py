"""NumPy's scalars in files of torch, read as plain numbers: NumPy itself unpickles nothing."""

from __future__ import annotations

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


def scalar(kind: Any, content: Any) -> Any:
    """Return the number or the text that a pickled scalar holds; raises UnpicklingError for any other."""
    known = isinstance(kind, Kind) and isinstance(content, bytes) and _NUMBERS.fullmatch(kind.name)
    if not known or kind.order not in ("<", ">", "=", "|"):
        raise pickle.UnpicklingError("GLOBAL numpy.dtype of no plain number")
    dtype = np.dtype(kind.order + kind.name)
    if len(content) != dtype.itemsize:
        raise pickle.UnpicklingError("a scalar of another length than its type")
    return np.frombuffer(content, dtype)[0].item()


def readable() -> AbstractContextManager[None]:
    """Let torch take scalars within this context, under the names of NumPy before 2.0 and since.

    Where the caller lets it take NumPy's own types already, for what holds arrays too, nothing changes.
    """
    from torch import serialization  # slow to import

    known = np.dtype in serialization.get_safe_globals()
    return serialization.safe_globals([] if known else _GLOBALS)


_GLOBALS: list[Callable[..., Any] | tuple[Callable[..., Any], str]] = [
    (scalar, "numpy.core.multiarray.scalar"),
    (scalar, "numpy._core.multiarray.scalar"),
    (Kind, "numpy.dtype"),
]
