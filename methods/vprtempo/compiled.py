"""How VPRTempo's inner loops are compiled."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import njit

_OPTIONS: dict[str, Any] = {
    "nogil": True,
    "error_model": "numpy",
    "fastmath": {"reassoc", "contract", "arcp", "nsz"},  # sums may be reordered; infinities still count
}


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile `function` at its first call, and keep the result where a folder can be written."""
    try:
        kernel: Callable[..., Any] = njit(cache=True, **_OPTIONS)(function)
    except RuntimeError:
        kernel = njit(**_OPTIONS)(function)
    return kernel
