"""A ground truth in an .npz file: a matrix of yes and no, or the arrays that it is made of."""

from __future__ import annotations

import lzma
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from vprbench.api import BadInput, MissingData

from .positives import Positives, read_matrix

# RuntimeError of zipfile: encrypted, or compressed in a way that it does not know.
_ERRORS = (OSError, RuntimeError, ValueError, EOFError, MemoryError, zipfile.BadZipFile, zlib.error, lzma.LZMAError)
_SHOWN = 10  # names in a message


def arrays_in(file: Path, most_values: Mapping[str, int], wanted: str, advice: str) -> dict[str, npt.NDArray[Any]]:
    """Return those of the named arrays that an .npz file holds; it may hold plain numbers alone.

    `most_values` bounds the size of each, and `wanted` says what the file has to hold. Raises MissingData, with
    `advice`, without a file, BadInput for one that cannot be read, holds none of them, or holds more.
    """
    if not file.is_file():
        raise MissingData(f"{file} is no file: {advice}")
    try:
        with zipfile.ZipFile(file) as members:
            sizes = {member.filename.removesuffix(".npy"): member.file_size for member in members.infolist()}
        large = [key for key, most in most_values.items() if sizes.get(key, 0) > 8 * most + (1 << 16)]
        with np.load(file, allow_pickle=False) as stored:
            arrays = {} if large else {key: stored[key] for key in most_values if key in sizes}
    except _ERRORS as error:
        reason = (str(error).splitlines() or [""])[0]
        raise BadInput(f"{file} cannot be read ({reason}): get it from its source again") from error
    if large:
        excess = f"{large[0]} in {file} unpacks to {sizes[large[0]]} bytes"
        raise BadInput(f"{excess}, and wanted is {wanted}: check that no image is missing")
    if not arrays:
        held = ", ".join([*sizes][:_SHOWN]) or "nothing"
        raise BadInput(f"{file} holds no {next(iter(most_values))}, but {held}: wanted is {wanted}; {advice}")
    return arrays


def matrix_in(
    file: Path, key: str, shape: tuple[int, int], axes: tuple[str, str], advice: str, of_columns: bool = False
) -> Positives:
    """Return of each row of a matrix in an .npz file which columns are right, ascending; or of each column which rows.

    The matrix has that shape and holds yes and no; `axes` are what its rows and columns stand for. Raises MissingData,
    with `advice`, without a file, BadInput for any other matrix.
    """
    wanted = f"a matrix {key} of yes and no, {shape[0]} {axes[0]} by {shape[1]} {axes[1]}"
    arrays = arrays_in(file, {key: shape[0] * shape[1]}, wanted, advice)
    return read_matrix(f"{key} in {file}", arrays[key], shape, axes, of_columns)
