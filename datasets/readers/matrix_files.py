"""A ground truth in an .npz file: a matrix of yes and no, or the arrays that it is made of."""

from __future__ import annotations

import lzma
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from vprbench.api import BadInput, MissingData

from .positives import check_matrix

# RuntimeError of zipfile: encrypted, or compressed in a way that it does not know.
_ZIP_ERRORS = (zipfile.BadZipFile, zlib.error, lzma.LZMAError)
_SHOWN = 10  # names in a message


def names_in(file: Path, advice: str) -> tuple[str, ...]:
    """Return the names of the arrays in an .npz file; raises MissingData, with `advice`, without one, or BadInput."""
    if not file.is_file():
        raise MissingData(f"{file} is no file: {advice}")
    try:
        with zipfile.ZipFile(file) as members:
            return tuple(name.removesuffix(".npy") for name in members.namelist())
    except (OSError, RuntimeError, *_ZIP_ERRORS) as error:
        raise _unreadable(file, error) from error


def array_in(file: Path, key: str, most_values: int, wanted: str, advice: str) -> npt.NDArray[Any]:
    """Return an array of plain numbers from an .npz file.

    `wanted` is what the file has to hold, and how many values. Raises MissingData, with `advice`, without a file,
    BadInput for one that cannot be read, lacks the array or holds more.
    """
    names = names_in(file, advice)
    if key not in names:
        raise BadInput(
            f"{file} holds no {key}, but {', '.join(names[:_SHOWN]) or 'nothing'}: wanted is {wanted}; {advice}"
        )
    try:
        with zipfile.ZipFile(file) as members:
            size = members.getinfo(f"{key}.npy").file_size
        if size > 8 * most_values + (1 << 16):
            raise BadInput(
                f"{key} in {file} unpacks to {size} bytes, and wanted is {wanted}: check that no image is missing"
            )
        with np.load(file, allow_pickle=False) as stored:
            array: npt.NDArray[Any] = stored[key]
    except BadInput:
        raise
    except (KeyError, ValueError, OSError, EOFError, MemoryError, RuntimeError, *_ZIP_ERRORS) as error:
        raise _unreadable(file, error) from error
    return array


def matrix_in(
    file: Path, key: str, shape: tuple[int, int], axes: tuple[str, str], advice: str
) -> npt.NDArray[np.bool_]:
    """Return a matrix of yes and no of that shape from an .npz file, which may hold plain numbers alone.

    `axes` are what its rows and columns stand for. Raises MissingData, with `advice`, without a file, BadInput for any
    other matrix.
    """
    wanted = f"a matrix {key} of yes and no, {shape[0]} {axes[0]} by {shape[1]} {axes[1]}"
    matrix = array_in(file, key, shape[0] * shape[1], wanted, advice)
    check_matrix(f"{key} in {file}", matrix, shape, axes)
    return np.asarray(matrix, dtype=np.bool_)


def _unreadable(file: Path, error: Exception) -> BadInput:
    reason = (str(error).splitlines() or [""])[0]
    return BadInput(f"{file} cannot be read ({reason}): get it from its source again")
