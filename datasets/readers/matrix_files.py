"""A ground truth as a matrix of yes and no in an .npz file."""

from __future__ import annotations

import lzma
import zipfile
import zlib
from pathlib import Path

import numpy as np
import numpy.typing as npt

from vprbench.api import BadInput, NotThere

# RuntimeError of zipfile: encrypted, or compressed in a way that it does not know.
_ZIP_ERRORS = (zipfile.BadZipFile, zlib.error, lzma.LZMAError)


def matrix_in(
    file: Path, key: str, shape: tuple[int, int], axes: tuple[str, str], advice: str
) -> npt.NDArray[np.bool_]:
    """Return a matrix of yes and no of that shape from an .npz file, which may hold plain numbers alone.

    `axes` are what its rows and columns stand for. Raises NotThere, with `advice`, without a file, BadInput for any
    other matrix.
    """
    if not file.is_file():
        raise NotThere(f"{file} is no file: {advice}")
    try:
        with zipfile.ZipFile(file) as members:
            size = members.getinfo(f"{key}.npy").file_size
        if size > 8 * shape[0] * shape[1] + (1 << 16):
            raise BadInput(
                f"{key} in {file} unpacks to {size} bytes, too many for {shape[0]} {axes[0]} and {shape[1]} {axes[1]}: "
                "check that no image is missing"
            )
        with np.load(file, allow_pickle=False) as stored:
            matrix = stored[key]
    except BadInput:
        raise
    except (KeyError, ValueError, OSError, EOFError, MemoryError, RuntimeError, *_ZIP_ERRORS) as error:
        reason = (str(error).splitlines() or [""])[0]
        told = f"holds no {key}" if isinstance(error, KeyError) else f"cannot be read ({reason})"
        raise BadInput(f"{file} {told}: get it from its source again") from error
    if matrix.shape != shape:
        turned = " (it is transposed)" if matrix.shape == shape[::-1] else ""
        raise BadInput(
            f"{key} in {file} has the shape {matrix.shape}{turned}; wanted is {shape}, {axes[0]} by {axes[1]}, for "
            "the images that are there"
        )
    if matrix.dtype.kind not in "buif" or not np.isin(matrix, (0, 1)).all():
        raise BadInput(f"{key} in {file} holds {matrix.dtype} values other than 0 and 1: yes and no are wanted")
    return np.asarray(matrix, dtype=np.bool_)
