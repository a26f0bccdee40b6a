"""The source files that a method's answers come from: its own, and all that they import from its package or ours."""

from __future__ import annotations

import ast
import importlib.util
import inspect
from collections.abc import Iterator
from pathlib import Path


def behind(method: type) -> dict[str, Path]:
    """Return the files behind a class by module name, in order of the names.

    Imports are followed, inside functions too, as long as they stay in the package of the class or in vprbench: what
    other packages hold is covered by their versions.
    """
    name = method.__module__
    ours = {name.partition(".")[0], "vprbench"}
    found = {name: Path(inspect.getfile(method))}
    waiting = [name]
    while waiting:
        current = waiting.pop()
        for imported in _imported(current, found[current]):
            if imported in found or imported.partition(".")[0] not in ours:
                continue
            path = _file(imported)
            if path is not None:
                found[imported] = path
                waiting.append(imported)
    return dict(sorted(found.items()))


def _imported(module: str, path: Path) -> Iterator[str]:
    """Yield the full names of all that a file imports, modules and what may be one."""
    package = module if path.name == "__init__.py" else module.rpartition(".")[0]
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and (package or not node.level):
            source = "." * node.level + (node.module or "")
            source = importlib.util.resolve_name(source, package) if node.level else source
            yield source
            yield from (f"{source}.{alias.name}" for alias in node.names)


def _file(module: str) -> Path | None:
    """Return the source file of a module; None for what is no module, has no source or cannot be found."""
    try:
        spec = importlib.util.find_spec(module)
    except (ImportError, AttributeError, ValueError):
        return None
    if spec is None or spec.origin is None or not spec.origin.endswith(".py"):
        return None
    return Path(spec.origin)
