"""The code that computes a method's answers, and a hash of its meaning: not of its words, nor of where it lies."""

from __future__ import annotations

import ast
import hashlib
import importlib.util
import inspect
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

from vprbench import api

#: Modules of this project that compute for methods; all others count by `harness.VERSION`, or compute nothing.
COMPUTING = frozenset(
    f"vprbench.api.{name}"
    for name in (
        *(
            "binary",
            "bit_indexes",
            "compiling",
            "descriptor",
            "gabor",
            "gabor_compiled",
            "growing",
            "hamming",
            "method",
            "nearest",
        ),
        *("neural", "oriented", "oriented_compiled", "preprocess", "preprocess_compiled"),
        *("resize", "rows", "search", "search_indexes", "threads", "weight_files", "weights"),
    )
)


def source_hash(kind: type) -> str:
    """Return the hash of the code behind a class: its own file, and all that compute for it.

    Comments, docstrings, imports for types and the places of files do not count: an edited sentence and a moved file
    give the same hash. Values, defaults and statements count. Raises OSError for a class without a file, as one that a
    cell of a notebook defines.
    """
    return meaning(behind(kind).values())


def meaning(files: Iterable[Path]) -> str:
    """Return the hash of what Python files say to the interpreter, in whatever order and under whatever names."""
    return hashlib.sha256(
        "".join(sorted(_hash_of(path.read_text(encoding="utf-8")) for path in files)).encode()
    ).hexdigest()


def behind(kind: type) -> dict[str, Path]:
    """Return the files that compute for a class by module name, in order of the names.

    Imports are followed, inside functions too, within the package of the class and the `COMPUTING` modules of this
    project: the versions of other packages stand for what these hold. Raises OSError for a class without a file.
    """
    try:
        return behind_file(kind.__module__, Path(inspect.getfile(kind)))
    except (OSError, TypeError) as error:
        raise OSError(f"{kind.__qualname__} has no file: put the class into one, as mine.py") from error


def behind_file(name: str, file: Path) -> dict[str, Path]:
    """Return the files that compute for the module `name`, which is `file`, as `behind` does for a class."""
    found = {name: file}
    waiting = [name]
    while waiting:
        current = waiting.pop()
        for imported in _imported(current, found[current]):
            if imported not in found and _counts(imported, name, file) and (path := _file(imported)) is not None:
                found[imported] = path
                waiting.append(imported)
    return dict(sorted(found.items()))


def defined_in(target: str) -> tuple[str, Path] | None:
    """Return the module that defines a class, and its file, by the class's full name; nothing but packages is imported.

    Imports of the name are followed. None if no file says which class it is.
    """
    module, _, name = target.rpartition(".")
    path = _file(module)
    if path is None:
        return None
    package = _package(module, path)
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.ClassDef) and node.name == name:
            return module, path
        if isinstance(node, ast.ImportFrom) and (
            alias := next((a for a in node.names if name == (a.asname or a.name)), None)
        ):
            return defined_in(f"{_source(node, package)}.{alias.name}")
    return None


def _counts(module: str, asking: str, file: Path) -> bool:
    top, package = module.partition(".")[0], asking.partition(".")[0]
    if top != "vprbench":
        beside = (file.with_name(f"{top}.py"), file.parent / top / "__init__.py")
        return top == package or (asking == package and any(path.is_file() for path in beside))
    return module in COMPUTING or module.startswith("vprbench.methods.")


def _imported(module: str, path: Path) -> tuple[str, ...]:
    """Return the full names of all that a file imports, modules and what may be one."""
    return _imported_by(path.read_text(encoding="utf-8"), _package(module, path))


@cache
def _imported_by(text: str, package: str) -> tuple[str, ...]:
    found: list[str] = []
    for node in _statements(ast.parse(text)):
        if isinstance(node, ast.Import):
            found += (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and (package or not node.level):
            source = _source(node, package)
            homes = api.HOMES if source == api.__name__ else {}
            found += (source, *(homes.get(alias.name, f"{source}.{alias.name}") for alias in node.names))
    return tuple(found)


def _package(module: str, path: Path) -> str:
    return module if path.name == "__init__.py" else module.rpartition(".")[0]


def _source(node: ast.ImportFrom, package: str) -> str:
    """Return the full name of the module that names are imported from."""
    name = "." * node.level + (node.module or "")
    return importlib.util.resolve_name(name, package) if node.level else name


def _statements(tree: ast.AST) -> Iterator[ast.AST]:
    """Yield all nodes of a tree but those that are for type checkers alone."""
    yield tree
    for child in ast.iter_child_nodes(tree):
        if not _is_for_types(child):
            yield from _statements(child)


def _is_for_types(node: ast.AST) -> bool:
    return isinstance(node, ast.If) and not node.orelse and ast.unparse(node.test) == "TYPE_CHECKING"


def _file(module: str) -> Path | None:
    """Return the source file of a module; None for what is no module, has no source or cannot be found."""
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
def _hash_of(text: str) -> str:
    tree = ast.parse(text)
    imports = (node for node in _statements(tree) if isinstance(node, ast.ImportFrom))
    known = {(alias.name, alias.asname) for node in imports for alias in node.names}  # the names, not where they lie
    return hashlib.sha256(repr((sorted(known, key=repr), _plain(tree))).encode()).hexdigest()


def _plain(value: Any) -> Any:
    """Return a syntax tree as nested tuples; empty parts are left out, for versions of Python differ in them."""
    if isinstance(value, list):
        return tuple(_plain(item) for item in value if not _says_nothing(item))
    if isinstance(value, ast.AST):
        parts = ((name, _plain(part)) for name, part in ast.iter_fields(value) if part not in (None, []))
        return (type(value).__name__, *((name, part) for name, part in parts if part != ()))
    return value


def _says_nothing(node: Any) -> bool:
    """Tell whether a statement is a text that nobody reads at run time, an import of names, or for type checkers."""
    text = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
    return text or isinstance(node, ast.ImportFrom) or _is_for_types(node)
