"""MATLAB's .mat files as plain Python: dicts, arrays and texts. Nothing that a file names is run."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

_MOST_BYTES = 1 << 32  # of a file
_LEAST_UNPACKED = 1 << 29  # bytes that the numbers of any file may take
_GROWTH = 8  # times its size that the numbers of a larger one may take
_BYTES = {"double": 8, "single": 4, "int64": 8, "uint64": 8, "int32": 4, "uint32": 4, "int16": 2, "uint16": 2}


class MatFileError(ValueError):
    """A .mat file that cannot be read; the text says why, and does not name the file."""


def read_mat(path: Path, variables: Sequence[str] | None = None, *, squeeze: bool = False) -> dict[str, Any]:
    """Return the variables of a .mat file before version 7.3, all of them if None are named.

    Numbers and matrices of characters are arrays, as scipy.io.loadmat gives them (`squeeze` is its `squeeze_me`). A
    structure is a dict in the order of its fields, cells and several structures are an array of objects, one line of
    text may be a str, and anything else is None. Raises MatFileError for a file that cannot be read, is larger than
    4 GB or states that its numbers take more than 512 MB and eight times its size, and OSError if it is not there.
    """
    import scipy.io

    size = path.stat().st_size
    if size > _MOST_BYTES:
        raise MatFileError(f"it has {size} bytes, more than the {_MOST_BYTES} that are read")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # scipy warns of variables that it cannot read; they are missing then
            _require_size(scipy.io.whosmat(path), variables, max(_LEAST_UNPACKED, _GROWTH * size))
            content = scipy.io.loadmat(path, variable_names=variables, struct_as_record=False, squeeze_me=squeeze)
        return {name: _as_plain(value) for name, value in content.items() if not name.startswith("__")}
    except MatFileError:
        raise
    except NotImplementedError as error:
        raise MatFileError("it is of MATLAB's version 7.3 (HDF5): save it again with save(..., '-v7')") from error
    except Exception as error:  # a damaged file fails in many ways
        if isinstance(error, OSError) and error.errno is not None:  # the disk's; scipy's have no number
            raise
        raise MatFileError(ascii(" ".join(str(error).split()) or type(error).__name__)[1:-1]) from error


def _require_size(
    declared: Sequence[tuple[str, tuple[int, ...], str]], variables: Sequence[str] | None, most_bytes: int
) -> None:
    """Raise MatFileError if the variables that are wanted state more numbers than a file of this size should have."""
    wanted = [(shape, kind) for name, shape, kind in declared if variables is None or name in variables]
    if sum(math.prod(shape) * _BYTES.get(kind, 1) for shape, kind in wanted) > most_bytes:
        raise MatFileError(f"it takes more than {most_bytes >> 20} MB of memory")


def _as_plain(value: Any) -> Any:
    from scipy.io.matlab import mat_struct

    if isinstance(value, mat_struct):
        return {name: _as_plain(getattr(value, name)) for name in value._fieldnames}
    if isinstance(value, str):
        return str(value)
    if not isinstance(value, np.ndarray | np.generic | int | float | complex):
        return None  # a sparse matrix, an object of a class, ...
    array = np.asarray(value)
    if array.dtype.kind == "O":
        cells = np.empty(array.size, dtype=object)
        for number, cell in enumerate(array.ravel()):
            cells[number] = _as_plain(cell)
        return cells.reshape(array.shape)
    return array if array.dtype.kind in "biufcU" else None
