"""The code behind a class of a notebook or a script: what it says, and what all that it names there says."""

from __future__ import annotations

import ast
import hashlib
import inspect
import linecache
import symtable
import sys
import sysconfig
from collections.abc import Iterator
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any

import numpy as np
from pydantic_core import PydanticSerializationError, to_jsonable_python

_SEVERAL = 1 << 16  # numbers of an array beyond which its hash stands for them
_PYTHON = Path(sysconfig.get_path("stdlib")).resolve()


class UntoldError(OSError):
    """What a class computes cannot be told from its source; the message says why."""


def told(kind: type) -> tuple[dict[str, str], set[tuple[str, Path]]]:
    """Return the texts behind a class of `__main__` by name, and the modules, with their files, that it uses.

    Followed are its bases and all classes, functions and plain values of the session that these texts name. Raises
    UntoldError for a class without source and for a value that has no plain content, as a network.
    """
    texts: dict[str, str] = {}
    modules: set[tuple[str, Path]] = set()
    waiting: list[tuple[str, Any]] = [(kind.__qualname__, kind)]
    while waiting:
        name, value = waiting.pop()
        if name in texts:
            continue
        value = inspect.unwrap(getattr(value, "py_func", value))  # of numba, of a decorator
        home = value.__name__ if isinstance(value, ModuleType) else getattr(value, "__module__", None)
        if not isinstance(value, ModuleType | type | FunctionType):
            texts[name] = "" if _is_installed(value) else _plain_text(name, value)
        elif home == "__main__" and not isinstance(value, ModuleType):
            texts[name] = text = _source(value)
            waiting += _named(text, value)
        elif (file := getattr(sys.modules.get(str(home)), "__file__", None)) and _counts(str(home), file):
            modules.add((str(home), Path(file)))
    return texts, modules


def plain(value: Any) -> Any:
    """Return a value as plain ones that a record can hold; raises UntoldError for what has no plain content."""
    try:
        return to_jsonable_python(value, fallback=_of_array)
    except (PydanticSerializationError, UnicodeDecodeError) as error:
        raise UntoldError(f"{type(value).__name__} has no plain content") from error


def _of_array(value: Any) -> Any:
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray) and value.dtype != object:
        if value.size <= _SEVERAL:
            return value.tolist()
        return f"{value.dtype} {value.shape} {hashlib.sha256(value.tobytes()).hexdigest()}"
    raise UntoldError(f"{type(value).__name__} has no plain content")


def _plain_text(name: str, value: Any) -> str:
    try:
        return f"{name} = {plain(value)!r}"
    except UntoldError as error:
        raise UntoldError(f"it uses {name}, and a {error}") from error


def _is_installed(value: Any) -> bool:
    """Tell whether a value is a function or a type's parameters of an installed package, as np.exp or list[int]."""
    named = callable(value) and isinstance(getattr(value, "__name__", None), str)
    return named or type(value).__module__ in ("typing", "types", "__future__")


def _counts(module: str, file: str) -> bool:
    path = Path(file).resolve()
    installed = path.is_relative_to(_PYTHON) or {"site-packages", "dist-packages"} & {*path.parts}
    return file.endswith(".py") and (not installed or module.partition(".")[0] == "vprbench")


def _source(value: type | FunctionType) -> str:
    """Return the statement that defined a class or a function, by the lines that its functions come from."""
    functions = [value] if isinstance(value, FunctionType) else [*_functions(value)]
    for function in functions:
        code = function.__code__
        lines = linecache.getlines(code.co_filename, function.__globals__)
        for node in ast.walk(ast.parse("".join(lines))) if lines else ():
            if not isinstance(node, ast.ClassDef | ast.FunctionDef) or node.name != value.__name__:
                continue
            first = min([node.lineno, *(decorator.lineno for decorator in node.decorator_list)])
            if first <= code.co_firstlineno <= (node.end_lineno or first):
                return ast.unparse(node)
    raise UntoldError(f"the source of {value.__qualname__} is not known")


def _functions(kind: type) -> Iterator[FunctionType]:
    for value in vars(kind).values():
        for one in (value, *(getattr(value, name, None) for name in ("__func__", "fget", "fset", "func"))):
            if isinstance(one, FunctionType):
                yield one


def _named(text: str, value: type | FunctionType) -> Iterator[tuple[str, Any]]:
    """Yield what a text names outside of itself, by name, as it is there now; bases are among it."""
    there: dict[str, Any] = dict(vars(sys.modules["__main__"]))
    for function in [value] if isinstance(value, FunctionType) else _functions(value):
        there |= inspect.getclosurevars(function).nonlocals
    wanted = set(_free(symtable.symtable(text, "", "exec")))
    yield from ((name, there[name]) for name in sorted(wanted & there.keys()))
    yield from ((base.__qualname__, base) for base in getattr(value, "__bases__", ()))


def _free(table: symtable.SymbolTable) -> Iterator[str]:
    for symbol in table.get_symbols():
        if symbol.is_referenced() and (symbol.is_global() or symbol.is_free() or table.get_type() == "module"):
            yield symbol.get_name()
    for child in table.get_children():
        yield from _free(child)
