"""How inner loops are compiled: free of the interpreter's lock, and kept where a folder can be written."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import njit, types

Loop = Callable[..., Any]


def compiled(*arguments: Any, fastmath: bool | set[str] = False) -> Callable[[Loop], Loop]:
    """Return a decorator that compiles a function for arguments of these numba types; the function returns nothing.

    Without types the function is compiled at its first call, for the types of that call, and may return a value.
    `fastmath` names the liberties that LLVM may take with float arithmetic.
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
