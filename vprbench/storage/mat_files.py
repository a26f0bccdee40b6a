"""MATLAB's .mat files as plain Python: dicts, arrays and texts. Nothing that a file names is run."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

_LEAST_UNPACKED = 1 << 29  # bytes that the numbers of any file may take, 8 each
_GROWTH = 8  # times its size that the numbers of a larger one may take


class MatFileError(ValueError):
    """A .mat file that cannot be read; the text says why, and does not name the file."""


def read_mat(path: Path, variables: Sequence[str] | None = None) -> dict[str, Any]:
    """Return the variables of a .mat file before version 7.3, all of them if None are named.

    They are as scipy.io.loadmat gives them with `simplify_cells`: a structure is a dict in the order of its fields,
    cells are an array of objects, several structures a list, and axes of length 1 are left out. Raises MatFileError for
    a file that cannot be read or that states more numbers than fit into 512 MB and into eight times its size, 8 bytes
    each, and OSError if it is not there.
    """
    import scipy.io

    most_bytes = max(_LEAST_UNPACKED, _GROWTH * path.stat().st_size)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # scipy warns of variables that it cannot read; they are missing then
            shapes = [shape for name, shape, _ in scipy.io.whosmat(path) if variables is None or name in variables]
            if 8 * sum(map(math.prod, shapes)) > most_bytes:
                raise ValueError(f"it takes more than {most_bytes >> 20} MB of memory")
            content = scipy.io.loadmat(path, variable_names=variables, simplify_cells=True)
        return {name: value for name, value in content.items() if not name.startswith("__")}
    except NotImplementedError as error:
        raise MatFileError("it is of MATLAB's version 7.3 (HDF5): save it again with save(..., '-v7')") from error
    except Exception as error:  # a damaged file fails in many ways
        if isinstance(error, OSError) and error.errno is not None:  # the disk's; scipy's have no number
            raise
        raise MatFileError(ascii(" ".join(str(error).split()) or type(error).__name__)[1:-1]) from error
