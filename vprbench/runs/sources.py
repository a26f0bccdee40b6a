"""The code of a method: a hash of the bytes of its own file and of all files that it imports from its package."""

from __future__ import annotations

import ast
import hashlib
import importlib.util
import inspect
from collections.abc import Iterable
from functools import cache
from pathlib import Path


def hash_class(kind: type) -> str:
    """Return the hash of the code of a class: its own file, and all of its package, or beside it, that this imports.

    Raises OSError for a class without a file, as a class that a cell of a notebook defines.
    """
    try:
        return _hash_with_imports(kind.__module__, Path(inspect.getfile(kind)))
    except (OSError, TypeError) as error:
        raise OSError(f"{kind.__qualname__} has no file: put the class into a file, as mine.py") from error


def hash_files(files: Iterable[Path]) -> str:
    """Return the hash of the bytes of files; their order and names do not count."""
    hashes = sorted(hashlib.sha256(path.read_bytes()).hexdigest() for path in files)
    return hashlib.sha256("".join(hashes).encode()).hexdigest()


def _hash_with_imports(name: str, file: Path) -> str:
    """Return the hash of the module `name`, which is `file`, and of all its own modules that it imports."""
    found, waiting = {name: file}, [name]
    while waiting:
        module = waiting.pop()
        package = module if found[module].name == "__init__.py" else module.rpartition(".")[0]
        for imported in _list_imports(package, found[module].read_bytes()):
            if imported not in found and _is_own(imported, name, file) and (path := _find_file(imported)) is not None:
                found[imported] = path
                waiting.append(imported)
    return hash_files(found.values())


def _is_own(module: str, method: str, file: Path) -> bool:
    """Tell whether a module is of the package of a method's module, or lies beside a method that has no package."""
    top, package = module.partition(".")[0], method.partition(".")[0]
    if top == "vprbench":  # a method of this project; the version of the harness stands for all else in it
        return module.startswith("vprbench.methods.") and package == top
    beside = (file.with_name(f"{top}.py"), file.parent / top / "__init__.py")
    return top == package or (method == package and any(path.is_file() for path in beside))


@cache
def _list_imports(package: str, code: bytes) -> tuple[str, ...]:
    """Return the full names of all imports of a module's code: of modules, and of names that may be modules."""
    found: list[str] = []
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.Import):
            found += (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and (package or not node.level):
            name = importlib.util.resolve_name("." * node.level + (node.module or ""), package)
            found += (name, *(f"{name}.{alias.name}" for alias in node.names))
    return tuple(found)


def _find_file(module: str) -> Path | None:
    """Return the source file of a module; None for a name that is no module or has no source."""
    above = module.rpartition(".")[0]
    if above and (path := _find_file(above)) is not None and path.name != "__init__.py":
        return None  # a name in a module, which find_spec would import
    try:
        spec = importlib.util.find_spec(module)
    except (ImportError, AttributeError, ValueError):
        return None
    return Path(spec.origin) if spec is not None and spec.origin is not None and spec.origin.endswith(".py") else None
