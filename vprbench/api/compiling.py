"""How inner loops are compiled: free of the interpreter's lock, and kept where a folder can be written."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import njit, types

Loop = Callable[..., Any]


def compiled(*arguments: Any, fastmath: bool | set[str] = False) -> Callable[[Loop], Loop]:
    """Return what compiles a function that returns nothing for arguments of these numba types.

    Without types it is compiled at its first call, for those that come, and may return something. `fastmath` names the
    liberties of LLVM that may be taken with float arithmetic.
    """
    options: dict[str, Any] = {"nogil": True, "error_model": "numpy", "fastmath": fastmath}
    signature: Any = [types.void(*arguments)] if arguments else None

    def compile_it(function: Loop) -> Loop:
        try:
            kernel: Loop = njit(signature, cache=True, **options)(function)
        except RuntimeError:  # no folder for the result
            kernel = njit(signature, **options)(function)
        return kernel

    return compile_it
