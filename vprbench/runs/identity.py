"""Hashes by which a run is known: of plain values, of the frames of a dataset, and of the code of a method.

The code of a method is its own file and all files that it imports from its package.
"""

from __future__ import annotations

import ast
import hashlib
import importlib.util
import inspect
import json
import uuid
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import Any, TypedDict

from vprbench.api.dataset import Dataset
from vprbench.api.images import names_hash
from vprbench.api.method import Method
from vprbench.runs.run_files import SCHEMA

#: Raise it with a change by which a run may have other answers or times; a test holds that nobody forgets to decide.
VERSION = 6

#: A change of these modules is a decision about VERSION, beside those of `vprbench.api`.
MODULES = (
    *("vprbench.metrics.ranking", "vprbench.plugins.networks", "vprbench.runs.stopwatch", "vprbench.runs.fitting"),
    *("vprbench.runs.run", "vprbench.runs.answers", "vprbench.runs.scorers", "vprbench.runs.descriptors"),
    *("vprbench.runs.machine", "vprbench.runs.watch"),
    *("vprbench.runs.corruption", "vprbench.runs.viewpoints"),
)


def hash_content(content: Mapping[str, Any]) -> str:
    """Return the hash of plain values, as of all that can change an outcome."""
    text = json.dumps({"schema": SCHEMA, **content}, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:16]


class DataRecord(TypedDict):
    """The frames of a dataset, references first and then queries, each in its order."""

    names_sha256: str  # of all names, joined by line feeds, in UTF-8
    content_sha256: str | None  # of the SHA-256 (32 bytes) of each file, joined; None if an image is no file
    images: int  # a frame that is used twice counts twice
    bytes: int | None  # of all files together; None if an image is no file


def hash_code(method: type[Method]) -> str:
    """Return the hash of the code that computes a method's answers, its class, and the version of the harness.

    Of a class without source it is another one each time: its runs are never found again.
    """
    try:
        code = hash_class(method)
    except OSError:
        return uuid.uuid4().hex
    return hashlib.sha256(f"{code} {method.__qualname__} {VERSION}".encode()).hexdigest()


def hash_frames(dataset: Dataset) -> tuple[str, DataRecord]:
    """Return the hash of a dataset's images, order and ground truth, and the record of its frames.

    The record lets others tell whether they used the same frames. Raises BadInput if a file cannot be read.
    """
    traverses = dataset.references, dataset.queries
    hashes = [images.file_hashes() for images in traverses]  # None: images that are no files
    digest = hashlib.sha256()
    for images, files in zip(traverses, hashes, strict=True):
        digest.update(images.fingerprint(files).encode())
    digest.update(dataset.places.tobytes())
    for right in dataset.positives:
        digest.update(right.tobytes() + b";")
    known = [file for files in hashes for file in files or ()]
    are_files = None not in hashes
    return digest.hexdigest(), {
        "names_sha256": names_hash(*(images.names for images in traverses)).hexdigest(),
        "content_sha256": hashlib.sha256(b"".join(sha256 for _, sha256 in known)).hexdigest() if are_files else None,
        "images": sum(map(len, traverses)),
        "bytes": sum(size for size, _ in known) if are_files else None,
    }


def compute_fingerprint(dataset: Dataset) -> str:
    """Return the hash of a dataset's images, order and ground truth; raises BadInput if a file cannot be read."""
    return hash_frames(dataset)[0]


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
            if (
                imported not in found
                and _is_own_module(imported, name, file)
                and (path := _find_source_file(imported)) is not None
            ):
                found[imported] = path
                waiting.append(imported)
    return hash_files(found.values())


def _is_own_module(module: str, method: str, file: Path) -> bool:
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


def _find_source_file(module: str) -> Path | None:
    """Return the source file of a module; None for a name that is no module or has no source."""
    above = module.rpartition(".")[0]
    if above and (path := _find_source_file(above)) is not None and path.name != "__init__.py":
        return None  # a name in a module, which find_spec would import
    try:
        spec = importlib.util.find_spec(module)
    except (ImportError, AttributeError, ValueError):
        return None
    return Path(spec.origin) if spec is not None and spec.origin is not None and spec.origin.endswith(".py") else None
