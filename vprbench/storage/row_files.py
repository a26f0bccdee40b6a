"""Long arrays, a .npy file each: rows are appended block by block, and read memory-mapped."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path

import numpy as np
import numpy.typing as npt
from filelock import FileLock

from vprbench.errors import BadInput

Rows = npt.NDArray[np.float32]  # (n_rows, n_columns)

LARGE_BYTES = 1 << 30  # of rows: more are not held in memory whole
STRETCH = 1024  # rows: an unfinished file is continued after a multiple of this


def keep_rows(
    path: Path, n_rows: int, make_blocks: Callable[[int], Iterable[Rows]], name: str = "rows"
) -> tuple[Rows, int]:
    """Return the rows of a file, memory-mapped and read-only, and how many of them were kept already.

    A missing or damaged file is written first. Rows that a killed process has written are continued. Of several
    processes one writes, and the others wait.

    Args:
        path: The file. While it is unfinished, its name ends in `.part`.
        n_rows: How many rows it has.
        make_blocks: Yields blocks of consecutive rows, (n, n_columns), from the row of a given number on.
        name: The rows in messages, as in "descriptors".

    Raises:
        BadInput: The disk is full, or the folder cannot be written. Rows that are written stay.
        ValueError: `make_blocks` yields more or fewer than the missing rows.
    """
    part = path.with_name(f"{path.name}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with FileLock(path.with_name(f".{path.name}.lock")):
            with suppress(FileNotFoundError, ValueError, EOFError):  # missing or damaged
                return _map_rows(path), n_rows
            kept = _write_missing_rows(part, n_rows, make_blocks)
            part.replace(path)
            return _map_rows(path), kept
    except OSError as error:
        raise BadInput(
            f"{n_rows} {name} cannot be kept in {path.parent} ({error}): make room there; finished rows stay"
        ) from error


def _map_rows(path: Path) -> Rows:
    rows: Rows = np.load(path, mmap_mode="r", allow_pickle=False)
    return rows.view(np.ndarray)


def _write_missing_rows(part: Path, n_rows: int, make_blocks: Callable[[int], Iterable[Rows]]) -> int:
    """Append the missing rows to an unfinished file; returns how many it had."""
    kept = n_done = _cut_to_stretches(part)
    with part.open("ab") as file:
        for block in make_blocks(kept):
            n_columns = block.shape[1]
            if n_done == 0:
                header = {"descr": "<f4", "fortran_order": False, "shape": (n_rows, n_columns)}
                np.lib.format.write_array_header_1_0(file, header)
            file.write(np.ascontiguousarray(block, "<f4").data)
            n_done += len(block)
    if n_done != n_rows:
        raise ValueError(f"{n_done} rows came for {part}; wanted {n_rows}")
    return kept


def _cut_to_stretches(part: Path) -> int:
    """Cut an unfinished file after its last whole stretch; returns how many rows are left."""
    n_rows = 0
    with suppress(FileNotFoundError, ValueError), part.open("r+b") as file:  # missing, or killed in its header
        np.lib.format.read_magic(file)
        (_, n_columns), _, _ = np.lib.format.read_array_header_1_0(file)
        start = file.tell()
        n_rows = (file.seek(0, os.SEEK_END) - start) // (4 * n_columns) // STRETCH * STRETCH
        file.truncate(start + 4 * n_columns * n_rows)
    if not n_rows:
        part.unlink(missing_ok=True)
    return n_rows
