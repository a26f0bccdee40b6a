"""The process that `mat_files` lets read a .mat file: started as a script, it knows nothing of this project."""

from __future__ import annotations

import contextlib
import json
import sys
import warnings
from pathlib import Path
from typing import IO, Any

import numpy as np

TOO_LARGE = 3  # exit codes
UNREADABLE = 4


def main(path: str, folder: str, options: str) -> int:
    """Write the content of a .mat file to a folder: `tree.json`, and `arrays`, .npy files one after the other.

    Prints why the file cannot be read if it returns `UNREADABLE`.
    """
    import scipy.io

    asked = json.loads(options)
    _limit(asked["memory_bytes"], asked["seconds"])
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of what cannot be read, which is missed where it is wanted
            content = scipy.io.loadmat(
                path, variable_names=asked["variables"], struct_as_record=False, squeeze_me=asked["squeeze"]
            )
        with Path(folder, "arrays").open("wb") as file:
            tree = {name: _node(value, file) for name, value in content.items() if not name.startswith("__")}
        Path(folder, "tree.json").write_text(json.dumps(tree), encoding="ascii")
    except MemoryError:
        return TOO_LARGE
    except NotImplementedError:
        print("it is of MATLAB's version 7.3 (HDF5): save it again with save(..., '-v7')")
        return UNREADABLE
    except Exception as error:  # a damaged file fails in many ways
        print(ascii(" ".join(str(error).split()) or type(error).__name__)[1:-1])
        return UNREADABLE
    return 0


def _node(value: Any, file: IO[bytes]) -> Any:
    """Return a value as plain JSON; numbers are left to the file, in this order."""
    from scipy.io.matlab import mat_struct

    if isinstance(value, mat_struct):
        return {"struct": {name: _node(getattr(value, name), file) for name in value._fieldnames}}
    if isinstance(value, str):
        return str(value)
    if not isinstance(value, np.ndarray | np.generic | int | float | complex):
        return None  # a sparse matrix, an object of a class, ...
    array = np.asarray(value)
    if array.dtype.kind == "O":
        return {"cells": [_node(cell, file) for cell in array.ravel()], "shape": array.shape}
    if array.dtype.kind == "U" and array.shape == (1,):
        return str(array[0])  # a list of names holds thousands
    if array.dtype.kind not in "biufcU":
        return None
    np.save(file, array, allow_pickle=False)
    return {"array": True}


def _limit(memory_bytes: int, seconds: int) -> None:
    """Bound memory, time and the size of written files, if the system can."""
    try:
        import resource
    except ImportError:
        return
    wanted = {
        resource.RLIMIT_CORE: 0,
        resource.RLIMIT_CPU: seconds,
        resource.RLIMIT_FSIZE: memory_bytes,
        resource.RLIMIT_AS: memory_bytes + _mapped_bytes(resource.getpagesize()),
    }
    for limit, most in wanted.items():
        _, hard = resource.getrlimit(limit)
        with contextlib.suppress(OSError, ValueError):  # less is allowed already, or the system has no such limit
            resource.setrlimit(limit, (most, hard))


def _mapped_bytes(page_bytes: int) -> int:
    """Return the address space that is in use already: what the libraries take."""
    try:
        return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0]) * page_bytes
    except OSError:
        return 1 << 31


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
