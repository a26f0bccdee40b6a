"""The code of a method: a hash of the files of its own package, without comments and docstrings."""

from __future__ import annotations

import ast
import hashlib
import importlib.util
import inspect
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path
from typing import Any


def source_hash(kind: type) -> str:
    """Return the hash of the code of a class: its own file, and all of its package, or beside it, that this imports.

    Comments, docstrings and the layout of lines do not count. Raises OSError for a class without a file, as a class
    that a cell of a notebook defines.
    """
    return hash_of_files(files_of(kind).values())


def hash_of_files(files: Iterable[Path]) -> str:
    """Return the hash of Python files without comments and docstrings, in whatever order and under whatever names."""
    hashes = sorted(_hash_of_text(path.read_text(encoding="utf-8")) for path in files)
    return hashlib.sha256("".join(hashes).encode()).hexdigest()


def files_of(kind: type) -> dict[str, Path]:
    """Return the files that `source_hash` reads, by module name; raises OSError for a class without a file."""
    try:
        return files_of_module(kind.__module__, Path(inspect.getfile(kind)))
    except (OSError, TypeError) as error:
        raise OSError(f"{kind.__qualname__} has no file: put the class into a file, as mine.py") from error


def files_of_module(name: str, file: Path) -> dict[str, Path]:
    """Return the module `name`, which is `file`, and all modules that it imports from its package or from beside it."""
    found, waiting = {name: file}, [name]
    while waiting:
        current = waiting.pop()
        for imported in _imports(found[current].read_text(encoding="utf-8"), _package(current, found[current])):
            if imported not in found and _is_own(imported, name, file) and (path := _file(imported)) is not None:
                found[imported] = path
                waiting.append(imported)
    return dict(sorted(found.items()))


def defined_in(target: str) -> tuple[str, Path] | None:
    """Return the module that defines a class, and its file, by the class's full name, importing packages alone.

    Imports of the name are followed. None if no file says which class it is.
    """
    module, _, name = target.rpartition(".")
    path = _file(module)
    if path is None:
        return None
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.ClassDef) and node.name == name:
            return module, path
        if isinstance(node, ast.ImportFrom):
            for alias in node.names:
                if name == (alias.asname or alias.name):
                    return defined_in(f"{_source(node, _package(module, path))}.{alias.name}")
    return None


def _is_own(module: str, asking: str, file: Path) -> bool:
    """Tell whether a module is of the package of the module that asks, or lies beside a module without a package."""
    top, package = module.partition(".")[0], asking.partition(".")[0]
    if top == "vprbench":  # a method of this project; the version of the harness stands for all else in it
        return module.startswith("vprbench.methods.") and package == top
    beside = (file.with_name(f"{top}.py"), file.parent / top / "__init__.py")
    return top == package or (asking == package and any(path.is_file() for path in beside))


@cache
def _imports(text: str, package: str) -> tuple[str, ...]:
    """Return the full names of all that a text imports, modules and what may be a module."""
    found: list[str] = []
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            found += (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and (package or not node.level):
            source = _source(node, package)
            found += (source, *(f"{source}.{alias.name}" for alias in node.names))
    return tuple(found)


def _package(module: str, path: Path) -> str:
    return module if path.name == "__init__.py" else module.rpartition(".")[0]


def _source(node: ast.ImportFrom, package: str) -> str:
    """Return the full name of the module that names are imported from."""
    name = "." * node.level + (node.module or "")
    return importlib.util.resolve_name(name, package) if node.level else name


def _file(module: str) -> Path | None:
    """Return the source file of a module; None for a name that is no module, has no source or cannot be found."""
    above = module.rpartition(".")[0]
    if above and (path := _file(above)) is not None and path.name != "__init__.py":
        return None  # a name in a module, which is not imported to tell
    try:
        spec = importlib.util.find_spec(module)
    except (ImportError, AttributeError, ValueError):
        return None
    if spec is None or spec.origin is None or not spec.origin.endswith(".py"):
        return None
    return Path(spec.origin)


@cache
def _hash_of_text(text: str) -> str:
    tree = ast.parse(text)
    for node in _documented(tree):
        if ast.get_docstring(node, clean=False) is not None:
            node.body = node.body[1:]
    return hashlib.sha256(repr(_plain(tree)).encode()).hexdigest()


def _plain(value: Any) -> Any:
    """Return a syntax tree as nested tuples; empty parts are left out, for versions of Python differ in them."""
    if isinstance(value, list):
        return tuple(map(_plain, value))
    if isinstance(value, ast.AST):
        parts = ((name, _plain(part)) for name, part in ast.iter_fields(value) if part not in (None, []))
        return (type(value).__name__, *((name, part) for name, part in parts if part != ()))
    return value


def _documented(tree: ast.Module) -> Iterator[ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            yield node
