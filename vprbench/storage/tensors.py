"""Arrays in files of safetensors: no pickle, no code."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save_file

Array = npt.NDArray[Any]
Arrays = Mapping[str, Array]

_KINDS = {"F32": "<f4", "F64": "<f8", "I32": "<i4", "I64": "<i8"}


def require_plain_numbers(array: Array, name: str) -> Array:
    """Return an array as safetensors writes it, byte after byte; raises TypeError for anything but numbers."""
    if not isinstance(array, np.ndarray) or array.dtype.kind not in "biuf":
        raise TypeError(f"{name} is {getattr(array, 'dtype', type(array).__name__)}; wanted a numpy array of numbers")
    return array.astype(array.dtype.newbyteorder("<"), order="C", copy=False)


def write_arrays(path: Path, arrays: Arrays) -> None:
    """Write arrays into a new file; raises OSError if the disk refuses, TypeError for anything but numbers."""
    try:
        save_file({name: require_plain_numbers(array, name) for name, array in arrays.items()}, path)
    except SafetensorError as error:
        raise OSError(str(error)) from error


def map_arrays(path: Path) -> dict[str, Array]:
    """Return the arrays of a file, which are read from the disk when they are used, and cannot be written to.

    Raises OSError for a file that cannot be read and ValueError for one that holds no such arrays.
    """
    try:
        with safe_open(path, framework="np") as file:  # it checks types, shapes and places against the file's length
            names = list(file.keys())
        content = np.memmap(path, np.uint8, "r").view(np.ndarray)
        start = 8 + int.from_bytes(content[:8].tobytes(), "little")
        entries = json.loads(content[8:start].tobytes())
        return {name: _map_array(content[start:], entries[name]) for name in names}
    except (SafetensorError, KeyError) as error:
        raise ValueError(f"{error}; wanted arrays of {', '.join(_KINDS)}") from error


def _map_array(content: Array, entry: Mapping[str, Any]) -> Array:
    first, end = entry["data_offsets"]
    return content[first:end].view(_KINDS[entry["dtype"]]).reshape(entry["shape"])
