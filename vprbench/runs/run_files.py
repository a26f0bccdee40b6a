"""The files of a run: a summary in JSON and its arrays in one file of safetensors; no pickle, and read checked."""

from __future__ import annotations

import json
import logging
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from pydantic import TypeAdapter, ValidationError

from vprbench.runs.record import Failure, Mappings, Run
from vprbench.storage.hashes import compute_sha256
from vprbench.storage.tensors import map_arrays, write_arrays

Arrays = Mapping[str, npt.NDArray[Any]]

logger = logging.getLogger(__name__)

SCHEMA = 13
SUMMARY, FAILURE = "run.json", "failure.json"
_RUN, _FAILURE = TypeAdapter(Run), TypeAdapter(Failure)


class DamagedRunError(Exception):
    """A folder of the store holds no whole run, or the system does not let it be read; the message says why."""


class OtherLayoutError(DamagedRunError):
    """A folder of the store holds a run of an earlier or later version of this program; the message names both."""


def write(run: Run, folder: Path) -> None:
    """Write a run into an empty folder.

    Raises OSError if the disk refuses, ValueError for a run that `load` would not take, as a view of a run.
    """
    arrays: dict[str, npt.NDArray[Any]] = {}
    text = json.dumps(_take_arrays(_RUN.dump_python(run, warnings=False), "", arrays))
    partial = folder / "arrays"
    write_arrays(partial, arrays)
    _build_run(json.loads(text), map_arrays(partial))
    sha256 = compute_sha256(partial)
    partial.rename(_get_arrays_path(folder, sha256))
    content = {"schema": SCHEMA, "sha256": sha256, **json.loads(text)}
    (folder / SUMMARY).write_text(json.dumps(content, indent=1), encoding="utf-8")


def load(folder: Path) -> Run:
    """Read a run of this layout.

    Raises DamagedRunError if a part is missing, changed, impossible or unreadable, OtherLayoutError for another layout.
    """
    try:
        summary: dict[str, Any] = json.loads((folder / SUMMARY).read_bytes())
        if (layout := int(summary.pop("schema"))) != SCHEMA:
            raise OtherLayoutError(f"its layout is version {layout}, this program reads {SCHEMA}: run it again")
        path = _get_arrays_path(folder, sha256 := summary.pop("sha256"))
        if compute_sha256(path) != sha256:
            raise ValueError(f"{path.name} is not what was written")
        return _build_run(summary, map_arrays(path))
    except OtherLayoutError:
        raise
    except Exception as error:  # a damaged file may upset its reader in any way
        raise DamagedRunError(f"{type(error).__name__}: {error}") from error


def write_failure(failure: Failure, folder: Path) -> None:
    """Write a failure into an empty folder; raises OSError if the disk refuses."""
    (folder / FAILURE).write_text(json.dumps(asdict(failure), indent=1), encoding="utf-8")


def read_failure(path: Path) -> Failure | None:
    """Read the file of a failure; None, with a warning, if it is damaged."""
    try:
        failure: Failure = _validate_content(_FAILURE, json.loads(path.read_bytes()))
        return failure
    except Exception as error:  # a damaged file may upset its reader in any way
        logger.warning("%s cannot be used (%s)", path, error)
        return None


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


def _build_run(summary: dict[str, Any], arrays: Arrays) -> Run:
    """Return the run of a summary, which is changed, and its arrays; raises ValueError for the first invalid value."""
    for path, array in arrays.items():
        part: Any = summary
        *outer, last = path.split(".")
        for name in outer:
            part = part[int(name) if name.isdigit() else name]
        part[last] = array
    run: Run = _validate_content(_RUN, summary)
    return run


def _validate_content(adapter: TypeAdapter[Any], content: dict[str, Any]) -> Any:
    try:
        Mappings.model_validate(content)
        return adapter.validate_python(content)
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False)[0]
        where, value = ".".join(map(str, first["loc"])), repr(first["input"])
        raise ValueError(f"{where} is {value[:60]}: {first['msg']}") from None


def _get_arrays_path(folder: Path, sha256: str) -> Path:
    return folder / f"arrays-{sha256[:16]}.safetensors"
