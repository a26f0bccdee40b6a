"""The files of a run: a summary in JSON and its arrays in one file of safetensors; no pickle, and read checked."""

from __future__ import annotations

import hashlib
import json
import logging
import os
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt
from pydantic import TypeAdapter, ValidationError

from vprbench.runs.record import Failure, Run
from vprbench.storage.tensors import mapped_arrays, write_arrays

Record = TypeVar("Record")

logger = logging.getLogger(__name__)

SCHEMA = 11
SUMMARY, _FAILURE = "run.json", "failure.json"
_SHOWN = 60  # characters of a value in a message
_RUN, _FAILED = TypeAdapter(Run), TypeAdapter(Failure)


class DamagedRunError(Exception):
    """A folder of the store holds no whole run, or the system does not let it be read; the message says why."""


class OtherLayoutError(Exception):
    """A folder of the store holds a run of an earlier or later version of this program; the message names both."""


def content_key(content: Mapping[str, Any]) -> str:
    """Return the hash of plain values: of all that can change an outcome, or of a summary itself."""
    text = json.dumps({"schema": SCHEMA, **content}, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def write(run: Run, folder: Path) -> None:
    """Write a run into an empty folder, its summary last.

    Raises OSError if the disk refuses, ValueError for a run that `load` would not take, and for a view of a run.
    """
    if run.view is not None:
        raise ValueError("a view of a run is never stored")
    arrays: dict[str, npt.NDArray[Any]] = {}
    text = json.dumps(_take_arrays(_RUN.dump_python(run, warnings=False), "", arrays))
    _build_run(json.loads(text), arrays)
    partial = folder / "arrays.safetensors"
    write_arrays(partial, arrays)
    sha256 = _digest(partial)
    partial.rename(_arrays_file(folder, sha256))
    summary = json.loads(text) | {"schema": SCHEMA, "sha256": sha256}
    _write_json(folder / SUMMARY, {**summary, "content_key": content_key(summary)})


def load(folder: Path) -> Run:
    """Read a run of this layout.

    Raises DamagedRunError if a part is missing, changed, impossible or unreadable, OtherLayoutError for another layout.
    """
    try:
        summary = _read_summary((folder / SUMMARY).read_bytes())
        sha256 = summary.pop("sha256")
        path = _arrays_file(folder, sha256)
        if _digest(path) != sha256:
            raise DamagedRunError(f"{path.name} is not what was written")
        return _build_run(summary, mapped_arrays(path))
    except (DamagedRunError, OtherLayoutError):
        raise
    except Exception as error:  # a damaged file may upset its reader in any way
        raise DamagedRunError(f"{type(error).__name__}: {error}") from error


def find_arrays(folder: Path) -> Path | None:
    """Return the file of arrays that the summary of a folder names; None if there is no such summary."""
    with suppress(Exception):  # a damaged summary may upset its reader in any way
        return _arrays_file(folder, json.loads((folder / SUMMARY).read_bytes())["sha256"])
    return None


def write_failure(failure: Failure, folder: Path) -> None:
    """Write a failure into an empty folder; raises OSError if the disk refuses."""
    _write_json(folder / _FAILURE, asdict(failure))


def read_failure(folder: Path) -> Failure | None:
    """Read a failure; None if there is none or, with a warning, none whole."""
    path = folder / _FAILURE
    try:
        return _validate(_FAILED, json.loads(path.read_bytes()), {})
    except (FileNotFoundError, NotADirectoryError):
        return None
    except (OSError, MemoryError, ValueError, TypeError, RecursionError) as error:
        logger.warning("%s cannot be used (%s)", path, getattr(error, "strerror", None) or error)
        return None


def _read_summary(content: bytes) -> dict[str, Any]:
    """Return a run without its arrays, as it was written."""
    summary: dict[str, Any] = json.loads(content)
    layout = summary["schema"]
    if type(layout) is not int or layout < 1:
        raise DamagedRunError(f"its layout is {layout!r}")
    if layout != SCHEMA:
        raise OtherLayoutError(f"its layout is version {layout}, this program reads {SCHEMA}: run it again")
    if summary.pop("content_key") != content_key(summary):
        raise DamagedRunError(f"{SUMMARY} is not what was written")
    del summary["schema"]
    return summary


def _take_arrays(value: Any, path: str, arrays: dict[str, npt.NDArray[Any]]) -> Any:
    """Return plain values with None in the place of arrays; these go to `arrays`, by the names that lead to them."""
    if isinstance(value, np.ndarray):
        arrays[path] = value
        return None
    if isinstance(value, Mapping):
        return {name: _take_arrays(inner, f"{path}.{name}".strip("."), arrays) for name, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_take_arrays(inner, f"{path}.{number}", arrays) for number, inner in enumerate(value)]
    return value


def _build_run(summary: dict[str, Any], arrays: Mapping[str, npt.NDArray[Any]]) -> Run:
    """Return the run of a summary, which is changed, and its arrays; raises ValueError for the first invalid value."""
    for path, array in arrays.items():
        part: Any = summary
        *outer, last = path.split(".")
        for name in outer:
            part = part[int(name) if name.isdigit() else name]
        part[last] = array
    n_places, n_queries = summary["outcome"]["n_places"], len(summary["outcome"]["best_score"])
    lengths = {"places": n_places, "queries": n_queries, "last place": n_places - 1, "last query": n_queries - 1}
    return _validate(_RUN, summary, lengths)


def _validate(adapter: TypeAdapter[Record], content: Any, lengths: dict[str, int]) -> Record:
    try:
        return adapter.validate_python(content, context=lengths)
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False)[0]
        where, value = ".".join(map(str, first["loc"])), repr(first["input"])
        raise ValueError(f"{where} is {value[:_SHOWN]}: {first['msg']}") from None


def _arrays_file(folder: Path, sha256: str) -> Path:
    return folder / f"arrays-{sha256[:16]}.safetensors"


def _write_json(path: Path, content: Mapping[str, Any]) -> None:
    with path.open("x", encoding="utf-8") as file:
        json.dump(content, file, indent=1)
        file.flush()
        os.fsync(file.fileno())


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
