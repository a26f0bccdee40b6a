"""Files of weights that hold numpy's arrays and numbers beside tensors, read without running code out of them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np
import torch

_KINDS = ("?", "i4", "i8", "f4", "f8")


@contextmanager
def numpy_allowed(stand_ins: Mapping[str, type] | None = None) -> Iterator[None]:
    """Let files be read within this context that hold arrays and numbers, under the names of numpy 1 and 2.

    `stand_ins` are plain classes of our own that take the attributes of an object, by its full name in the file.
    """
    rebuilders = {"_reconstruct": np.zeros(1).__reduce__()[0], "scalar": np.float64(0).__reduce__()[0]}
    named: dict[str, Any] = {
        f"numpy.{package}.multiarray.{name}": function
        for package in ("core", "_core")
        for name, function in rebuilders.items()
    }
    kinds = [type(np.dtype(kind)) for kind in _KINDS]
    renamed = [(stand_in, name) for name, stand_in in (named | dict(stand_ins or {})).items()]
    with torch.serialization.safe_globals([np.ndarray, np.dtype, *kinds, *renamed]):
        yield
