"""The files of a run: a summary in JSON and its arrays in one file of safetensors; no pickle, and read checked."""

from __future__ import annotations

import hashlib
import json
import logging
import os
import stat
from collections.abc import Mapping
from dataclasses import asdict, fields, is_dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt
from pydantic import TypeAdapter, ValidationError

from vprbench.runs.notes import Note
from vprbench.runs.record import Failure, Run
from vprbench.storage.tensors import mapped_arrays, write_arrays

Record = TypeVar("Record")

logger = logging.getLogger(__name__)

SCHEMA = 10
SUMMARY, _ARRAYS, _FAILURE = "run.json", "arrays.safetensors", "failure.json"
_LARGEST_SUMMARY = 1 << 26  # bytes
_SHOWN = 60  # characters of a value in a message
_RIGHT, _RIGHT_COUNTS = "positives", "positives_per_query"  # which are stored joined
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
    arrays: dict[str, npt.NDArray[Any]] = {}
    summary = _without_arrays(run, "", arrays)
    if run.view is not None:
        raise ValueError("a view of a run is never stored")
    summary = json.loads(json.dumps(summary))
    _checked_run(json.loads(json.dumps(summary)), arrays)
    write_arrays(folder / _ARRAYS, arrays)
    summary |= {"schema": SCHEMA, "sha256": _digest(folder / _ARRAYS)}
    _write_json(folder / SUMMARY, {**summary, "content_key": content_key(summary)})


def load(folder: Path) -> Run:
    """Read a run of this layout.

    Raises DamagedRunError if a part is missing, changed, impossible or unreadable, OtherLayoutError for another layout.
    """
    try:
        summary = _summary(_content(folder / SUMMARY, _LARGEST_SUMMARY))
        if _digest(_regular(folder / _ARRAYS)) != summary.pop("sha256"):
            raise DamagedRunError(f"{_ARRAYS} is not what was written")
        return _checked_run(summary, mapped_arrays(folder / _ARRAYS))
    except (DamagedRunError, OtherLayoutError):
        raise
    except Exception as error:  # a damaged file may upset its reader in any way
        raise DamagedRunError(f"{type(error).__name__}: {error}") from error


def write_failure(failure: Failure, folder: Path) -> None:
    """Write a failure into an empty folder; raises OSError if the disk refuses."""
    _write_json(folder / _FAILURE, asdict(failure))


def read_failure(folder: Path) -> Failure | None:
    """Read a failure; None if there is none or, with a warning, none whole."""
    path = folder / _FAILURE
    try:
        return _checked(_FAILED, json.loads(_content(path, _LARGEST_SUMMARY)), {})
    except (FileNotFoundError, NotADirectoryError):
        return None
    except (OSError, MemoryError, ValueError, TypeError, RecursionError) as error:
        logger.warning("%s cannot be used (%s)", path, _reason(error))
        return None


def _summary(content: bytes) -> dict[str, Any]:
    """Return what is no array of a run, as it was written."""
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


def _without_arrays(value: Any, path: str, arrays: dict[str, npt.NDArray[Any]]) -> Any:
    """Return a record as plain values; its arrays go to `arrays`, by the names of the fields that lead to them."""
    if isinstance(value, Note):
        return value._asdict()
    if is_dataclass(value):
        plain = {}
        for part in fields(value):
            inner, name = getattr(value, part.name), f"{path}{part.name}"
            if part.name == _RIGHT:
                arrays[name] = np.concatenate([np.empty(0, np.int64), *inner])
                arrays[_RIGHT_COUNTS] = np.array([len(right) for right in inner])
            elif isinstance(inner, np.ndarray):
                arrays[name] = inner
            elif part.name != "view":
                plain[part.name] = _without_arrays(inner, f"{name}.", arrays)
        return plain
    if isinstance(value, tuple):
        return [_without_arrays(inner, f"{path}{number}.", arrays) for number, inner in enumerate(value)]
    return value


def _checked_run(summary: dict[str, Any], arrays: Mapping[str, npt.NDArray[Any]]) -> Run:
    """Return the run of a summary and its arrays; raises ValueError that names the first value that cannot be."""
    parts = dict(arrays)
    right, counts = parts.pop(_RIGHT), parts.pop(_RIGHT_COUNTS)
    if counts.min(initial=0) < 0 or counts.sum() != len(right):
        raise ValueError(f"{_RIGHT_COUNTS} does not add up to the {len(right)} positives")
    for path, array in parts.items():
        part: Any = summary
        *outer, last = path.split(".")
        for name in outer:
            part = part[int(name) if name.isdigit() else name]
        part[last] = array
    summary[_RIGHT] = tuple(np.split(right, np.cumsum(counts)[:-1])) if len(counts) else ()
    n_places, n_queries = summary["outcome"]["n_places"], len(summary["outcome"]["best_score"])
    lengths = {"places": n_places, "queries": n_queries, "last place": n_places - 1, "last query": n_queries - 1}
    run = _checked(_RUN, summary, lengths)
    if run.outcome.n_places > run.n_references:
        raise ValueError(f"n_places is {run.outcome.n_places}, of {run.n_references} references")
    for fewer, more in (("top_tied_correct", "top_tied"), ("tied_correct", "tied")):
        if (getattr(run.outcome, fewer) > getattr(run.outcome, more)).any():
            raise ValueError(f"{fewer} is more than {more} somewhere")
    return run


def _checked(adapter: TypeAdapter[Record], content: Any, lengths: dict[str, int]) -> Record:
    try:
        return adapter.validate_python(content, context=lengths)
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False)[0]
        where, came = ".".join(map(str, first["loc"])), repr(first["input"])
        raise ValueError(f"{where} is {came[:_SHOWN]}{'...' * (len(came) > _SHOWN)}: {first['msg']}") from None


def _write_json(path: Path, content: Mapping[str, Any]) -> None:
    with path.open("x", encoding="utf-8") as file:
        json.dump(content, file, indent=1)
        file.flush()
        os.fsync(file.fileno())


def _content(path: Path, most_bytes: int) -> bytes:
    with _regular(path).open("rb") as file:
        content = file.read(most_bytes + 1)
    if len(content) > most_bytes:
        raise ValueError(f"{path.name} is larger than {most_bytes} bytes")
    return content


def _regular(path: Path) -> Path:
    """Return the path of a file; raises ValueError for a pipe or a device, which might never end."""
    if not stat.S_ISREG(path.stat().st_mode):
        raise ValueError(f"{path.name} is no file")
    return path


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _reason(error: Exception) -> str:
    return getattr(error, "strerror", None) or f"{type(error).__name__}: {error}"
