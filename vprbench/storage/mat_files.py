"""MATLAB's .mat files, read in a process of its own: a damaged one may crash the reader, or fill the memory."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import IO, Any

import numpy as np

from vprbench.storage import mat_child

_LEAST_BYTES = 1 << 29  # of memory that any file may take
_GROWTH = 8  # times its size that a larger one may take: numbers shrink little, and are copied on the way
_LEAST_SECONDS = 60
_BYTES_PER_SECOND = 1 << 22
_PATIENCE = 5  # times the seconds of computing, on a machine that is busy


class MatFileError(ValueError):
    """A .mat file that cannot be read; the text says why, and does not name the file."""


def read_mat(path: Path, variables: Sequence[str] | None = None, *, squeeze: bool = False) -> dict[str, Any]:
    """Return the variables of a .mat file before version 7.3, all of them if None are named.

    Numbers and matrices of characters are arrays, as scipy.io.loadmat gives them (`squeeze` is its `squeeze_me`). A
    structure is a dict in the order of its fields, cells and several structures are an array of objects, one line of
    text may be a str, and what is anything else is None. Raises MatFileError for a file that cannot be read, or takes
    far more memory or time than one of its size should, and OSError if it is not there.
    """
    size = path.stat().st_size
    limits = {"memory_bytes": max(_LEAST_BYTES, _GROWTH * size), "seconds": _LEAST_SECONDS + size // _BYTES_PER_SECOND}
    asked = {"variables": None if variables is None else [*variables], "squeeze": squeeze, **limits}
    with tempfile.TemporaryDirectory() as folder:
        try:
            done = subprocess.run(
                [sys.executable, "-P", mat_child.__file__, path.absolute(), folder, json.dumps(asked)],
                capture_output=True,
                stdin=subprocess.DEVNULL,
                timeout=_PATIENCE * limits["seconds"],
                env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
                check=False,
            )
        except subprocess.TimeoutExpired as error:
            raise MatFileError(f"reading it takes more than {error.timeout:.0f} s") from error
        if done.returncode:
            raise MatFileError(_reason(done, limits["memory_bytes"]))
        try:
            tree = json.loads(Path(folder, "tree.json").read_text(encoding="ascii"))
            with Path(folder, "arrays").open("rb") as arrays:
                return {name: _value(node, arrays) for name, node in tree.items()}
        except RecursionError as error:
            raise MatFileError("it is nested too deeply") from error


def _reason(done: subprocess.CompletedProcess[bytes], memory_bytes: int) -> str:
    """Return why the process gave nothing."""
    if done.returncode == mat_child.UNREADABLE:
        return done.stdout.decode("ascii", "replace").strip()
    if done.returncode == mat_child.TOO_LARGE:
        return f"it takes more than {memory_bytes >> 20} MB of memory"
    if done.returncode < 0:
        return f"its reader was ended by {signal.Signals(-done.returncode).name}"
    last = done.stderr.decode("utf-8", "replace").split("\n")[-2:]
    return " ".join(" ".join(last).split()) or f"its reader ended with code {done.returncode}"


def _value(node: Any, arrays: IO[bytes]) -> Any:
    """Return what the process wrote as a node; the numbers are in `arrays`, in this order."""
    if not isinstance(node, dict):
        return node
    if "struct" in node:
        return {name: _value(field, arrays) for name, field in node["struct"].items()}
    if "array" in node:
        return np.load(arrays, allow_pickle=False)
    cells = np.empty(len(node["cells"]), dtype=object)
    for number, cell in enumerate(node["cells"]):
        cells[number] = _value(cell, arrays)
    return cells.reshape(node["shape"])
