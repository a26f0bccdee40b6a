"""Checks of a method's arguments, and of the arrays of a stored map before a method takes them over."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from vprbench.api import BadInput

State = Mapping[str, npt.NDArray[Any]]


def require_arguments(method: object, **wanted: tuple[bool, str]) -> None:
    """Raise BadInput for the first of a method's arguments that does not fit: whether it fits, and the wish."""
    for name, (fits, wish) in wanted.items():
        if not fits:
            raise BadInput(f"method.{name}={getattr(method, name)}: give {wish}")


def require_map(state: State, wanted: Mapping[str, tuple[type[np.generic], tuple[int, ...]]]) -> None:
    """Raise BadInput unless the arrays have these names, types and shapes, finite numbers, and places without a gap."""
    found = {name: f"{array.dtype} {array.shape}" for name, array in state.items()}
    right = {name: f"{np.dtype(kind)} {shape}" for name, (kind, shape) in wanted.items()}
    if found != right:
        raise BadInput(f"the stored network holds {found}; wanted {right}")
    broken = [name for name, array in state.items() if not np.isfinite(array).all()]
    if broken or not np.array_equal(np.unique(state["places"]), np.arange(state["places"].max(initial=0) + 1)):
        raise BadInput(f"the stored network has {broken or 'places'} that are not finite, or not 0, 1, 2 ... all")
