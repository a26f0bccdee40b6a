"""Long arrays, a .npy file each: rows are appended block by block, and read memory-mapped."""

from __future__ import annotations

import errno
import logging
import os
import shutil
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from pathlib import Path
from typing import IO

import numpy as np
import numpy.typing as npt
from filelock import FileLock

from vprbench.errors import BadInput

logger = logging.getLogger(__name__)

Rows = npt.NDArray[np.float32]  # (n_rows, n_columns)

LARGE_BYTES = 1 << 30  # of rows: more are not held in memory whole
STRETCH = 1024  # rows: an unfinished file is continued after a multiple of this


def load_rows(path: Path, n_rows: int) -> Rows | None:
    """Return the rows of a finished file, memory-mapped and read-only.

    None if there is no file, or one that holds anything but `n_rows` rows of float32, which is logged.
    """
    try:
        rows: Rows = np.load(path, mmap_mode="r", allow_pickle=False)
        if rows.dtype != np.float32 or rows.ndim != 2 or len(rows) != n_rows:
            raise ValueError(f"{rows.dtype} of shape {rows.shape}; wanted float32 of {n_rows} rows")
    except FileNotFoundError:
        return None
    except (OSError, ValueError, EOFError) as error:
        logger.warning("%s cannot be used (%s): making it anew", path, error)
        return None
    return rows.view(np.ndarray)


def keep_rows(
    path: Path, n_rows: int, make_blocks: Callable[[int], Iterable[Rows]], name: str = "rows"
) -> tuple[Rows, int]:
    """Return the rows of a file, which is written first if it is not there, and how many were kept already.

    What a killed process has written is continued. Of several processes one writes, and the others wait.

    Args:
        path: The file. While it is unfinished, its name ends in `.part`.
        n_rows: How many rows it has.
        make_blocks: Yields blocks of consecutive rows, (n, n_columns), from the row of a given number on.
        name: The rows in messages, as in "descriptors".

    Raises:
        BadInput: The disk refuses rows of more than 1 GiB, or refuses once it has taken some. If it refuses fewer at
            the start, they are returned in memory, with a warning.
        ValueError: `make_blocks` yields more or fewer than the missing rows.
    """
    folder, part = path.parent, path.with_name(f"{path.name}.part")
    refusal: OSError | None = None
    kept = n_done = 0
    with ExitStack() as stack:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            stack.enter_context(FileLock(path.with_name(f".{path.name}.lock")))
            if (rows := load_rows(path, n_rows)) is not None:
                return rows, n_rows
            file = stack.enter_context(part.open("a+b", buffering=0))
            kept = n_done = _cut_to_stretches(file, n_rows)
        except OSError as error:
            refusal = error
        blocks = iter(make_blocks(kept))
        for block in blocks:
            n_columns = block.shape[1]
            try:
                if refusal is not None:
                    raise refusal
                if n_done == kept:
                    _require_room(folder, 4 * (n_rows - kept) * n_columns)
                if n_done == 0:
                    header = {"descr": "<f4", "fortran_order": False, "shape": (n_rows, n_columns)}
                    np.lib.format.write_array_header_1_0(file, header)
                _write(file, block)
            except OSError as error:
                n_bytes, reason = 4 * n_rows * n_columns, error.strerror or error
                if n_bytes > LARGE_BYTES or n_done:
                    raise BadInput(
                        f"{n_rows} {name} of {n_columns} numbers fill {n_bytes / 1e9:.1f} GB, too much for {folder} "
                        f"({reason}): make room there; what is done stays"
                    ) from error
                logger.warning("no %s are kept in %s: %s", name, folder, reason)
                return np.concatenate([block, *blocks]), 0
            n_done += len(block)
        if n_done != n_rows:
            raise ValueError(f"{n_done} rows came for {path}; wanted {n_rows}")
        file.close()
        part.replace(path)
        return np.load(path, mmap_mode="r", allow_pickle=False).view(np.ndarray), kept


def _cut_to_stretches(file: IO[bytes], n_rows: int) -> int:
    """Cut an unfinished file after its last whole stretch; returns how many rows are left."""
    file.seek(0)
    try:
        np.lib.format.read_magic(file)
        (n_stated, n_columns), _, kind = np.lib.format.read_array_header_1_0(file)
        if n_stated != n_rows or kind != np.float32 or not n_columns:
            raise ValueError(f"{n_stated} rows of {kind}")
    except ValueError:
        file.truncate(0)
        return 0
    start = file.tell()
    n_done: int = (file.seek(0, os.SEEK_END) - start) // (4 * n_columns)
    if n_done < n_rows:
        n_done -= n_done % STRETCH
    file.truncate(start + 4 * n_columns * n_done if n_done else 0)
    return n_done


def _require_room(folder: Path, n_bytes: int) -> None:
    if shutil.disk_usage(folder).free < n_bytes:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def _write(file: IO[bytes], block: Rows) -> None:
    content = np.ascontiguousarray(block, "<f4").reshape(-1).view(np.uint8)
    while len(content):  # the disk may take a part
        content = content[file.write(content.data) :]
