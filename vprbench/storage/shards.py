"""Long arrays in shards: files of consecutive rows, written whole one after the other, read memory-mapped."""

from __future__ import annotations

import errno
import json
import logging
import os
import shutil
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from vprbench.errors import BadInput
from vprbench.storage.atomic import remove_leftovers, replace_text, unfinished

logger = logging.getLogger(__name__)

Array = npt.NDArray[np.float32]  # (n_rows, n_columns)

LARGE_BYTES = 1 << 30  # of descriptors: more are not held in memory whole
_LEAST_ROWS, _MOST_SHARDS, _MULTIPLE = 1024, 256, 64


def rows_each(n_rows: int) -> int:
    """Return how many rows a shard has, the last one fewer: of so many rows always the same, a multiple of 64."""
    return max(_LEAST_ROWS, -(-n_rows // (_MOST_SHARDS * _MULTIPLE)) * _MULTIPLE)


@dataclass(frozen=True, eq=False)
class Piece:
    """One shard. Sent to another process it goes as the name of its file, or as its rows if it lies in memory."""

    first: int  # its first row
    last: int
    source: Path | Array

    def rows(self) -> Array:
        """Return its rows, (last - first, n_columns); those of a file memory-mapped, as long as somebody holds them."""
        if isinstance(self.source, np.ndarray):
            return self.source
        rows: Array = np.load(self.source, mmap_mode="r", allow_pickle=False)
        return rows


@dataclass(frozen=True, eq=False)
class Shards:
    """Rows of float32, (n_rows, n_columns), in files or in memory.

    The borders of the shards depend on the number of rows alone, wherever these lie.
    """

    shape: tuple[int, int]
    pieces: tuple[Piece, ...]
    array: Array | None = None  # all rows, if they lie in memory as one

    @classmethod
    def of(cls, array: Array) -> Shards:
        """Return the shards of an array in memory, which is not copied."""
        n_rows, n_columns = array.shape
        pieces = (Piece(rows.start, rows.stop, array[rows]) for rows in borders(n_rows))
        return cls((n_rows, n_columns), tuple(pieces), array)

    @classmethod
    def find(cls, folder: Path, n_rows: int) -> Shards | None:
        """Return what a writer has finished in a folder; None if a shard is missing, or damaged, which is logged."""
        found = [_read(folder, rows) for rows in borders(n_rows)]
        if any(part is None or part.shape[1] != found[0].shape[1] for part in found):  # type: ignore[union-attr]
            return None
        return Writer(folder, n_rows).shards()

    def __len__(self) -> int:
        """Return the number of rows."""
        return self.shape[0]

    @property
    def each(self) -> int:
        """The rows of a shard, the last one fewer; in another process too what it was when they were made."""
        return self.pieces[0].last

    @property
    def nbytes(self) -> int:
        """The bytes of all rows."""
        return 4 * self.shape[0] * self.shape[1]

    def __getitem__(self, rows: slice) -> Array:
        """Return consecutive rows: a view if the memory or one shard has them, else a copy."""
        first, last, step = rows.indices(len(self))
        if step != 1:
            raise ValueError(f"rows {rows} came; wanted consecutive ones")
        if self.array is not None:
            return self.array[first:last]
        touched = self.pieces[first // self.each : -(-last // self.each)] if first < last else self.pieces[:1]
        cut = [piece.rows()[max(first - piece.first, 0) : max(last - piece.first, 0)] for piece in touched]
        return cut[0] if len(cut) == 1 else np.concatenate(cut)

    def take(self, rows: npt.NDArray[np.integer[Any]]) -> Array:
        """Return a copy of the rows of these numbers, 0 or more, in their order: (..., n_columns)."""
        taken = np.empty((*rows.shape, self.shape[1]), np.float32)
        numbers = rows // self.each
        for number in np.unique(numbers):
            chosen, piece = numbers == number, self.pieces[number]
            taken[chosen] = piece.rows()[rows[chosen] - piece.first]
        return taken


class Writer:
    """Writes shards into a folder; those that an earlier writer finished stay, so a killed one costs its last shard.

    Several processes may write the same rows at once: each file is replaced whole. What the disk refuses stays in
    memory, with a warning that names `what` it is; more than 1 GiB raises BadInput.
    """

    def __init__(self, folder: Path, n_rows: int, what: str = "rows") -> None:
        """Go on with the shards of `n_rows` rows in all; raises ValueError for none."""
        if n_rows < 1:
            raise ValueError("shards have a row or more")
        self._folder = folder
        self._n_rows = n_rows
        self._what = what
        self._held: dict[int, Array] = {}
        remove_leftovers(folder)

    def missing(self) -> Iterator[slice]:
        """Yield the rows of each shard that is not there when it is its turn."""
        for rows in borders(self._n_rows):
            if rows.start not in self._held and _read(self._folder, rows) is None:
                yield rows

    def write(self, rows: slice, blocks: Iterable[Array]) -> None:
        """Write one shard, from consecutive blocks of its rows; an error of theirs leaves nothing behind."""
        blocks = iter(blocks)
        first = next(blocks)
        partial = unfinished(self._folder, ".npy")
        try:
            part, on_disk = self._room(partial, rows, first.shape[1])
            done = 0
            for block in chain((first,), blocks):
                part[done : done + len(block)] = block
                done += len(block)
            if done != len(part):
                raise ValueError(f"{done} rows came for rows {rows.start} to {rows.stop}")
            if on_disk:
                part.flush()  # type: ignore[attr-defined]  # a memmap
                partial.replace(_path(self._folder, rows))
            else:
                self._held[rows.start] = part
        finally:
            with suppress(OSError):
                partial.unlink(missing_ok=True)

    def shards(self, about: Mapping[str, Any] | None = None) -> Shards:
        """Return all rows, and write beside them what they are, `about.json`; every shard has to be there."""
        pieces = tuple(
            Piece(rows.start, rows.stop, self._held.get(rows.start, _path(self._folder, rows)))
            for rows in borders(self._n_rows)
        )
        shards = Shards((self._n_rows, pieces[0].rows().shape[1]), pieces)
        if about is not None and not self._held:
            text = json.dumps({**about, "shape": shards.shape, "bytes": shards.nbytes}, indent=1)
            with suppress(OSError):
                replace_text(self._folder / "about.json", text)
        return shards

    def _room(self, partial: Path, rows: slice, n_columns: int) -> tuple[Array, bool]:
        """Return rows to fill and whether they lie on disk; a disk too small for all is known at once."""
        shape = (rows.stop - rows.start, n_columns)
        if self._held:
            return np.empty(shape, np.float32), False
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            if shutil.disk_usage(self._folder).free < 4 * (self._n_rows - rows.start) * n_columns:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            part = np.lib.format.open_memmap(partial, "w+", np.float32, shape)
            if hasattr(os, "posix_fallocate"):  # a full disk is an error now, not a crash while the rows are filled
                with partial.open("r+b") as file:
                    os.posix_fallocate(file.fileno(), 0, file.seek(0, os.SEEK_END))
            return part, True
        except OSError as error:
            n_bytes = 4 * self._n_rows * n_columns
            if n_bytes > LARGE_BYTES:
                raise BadInput(
                    f"{self._n_rows} {self._what} of {n_columns} numbers fill {n_bytes / 1e9:.1f} GB, too much for "
                    f"{self._folder} ({error.strerror or error}): make room there; what is done stays"
                ) from error
            logger.warning("no %s are kept in %s: %s", self._what, self._folder, error.strerror or error)
            return np.empty(shape, np.float32), False


def borders(n_rows: int) -> list[slice]:
    """Return which rows each shard has."""
    size = rows_each(n_rows)
    return [slice(first, min(first + size, n_rows)) for first in range(0, n_rows, size)]


def _path(folder: Path, rows: slice) -> Path:
    return folder / f"{rows.start:09d}.npy"


def _read(folder: Path, rows: slice) -> Array | None:
    """Return a finished shard; None if it is not there, or cannot be used, which is logged."""
    path = _path(folder, rows)
    try:
        part: Array = np.load(path, mmap_mode="r", allow_pickle=False)
        if part.dtype != np.float32 or part.ndim != 2 or len(part) != rows.stop - rows.start:
            raise ValueError(f"{part.dtype} of shape {part.shape}; wanted float32 of {rows.stop - rows.start} rows")
    except FileNotFoundError:
        return None
    except (OSError, ValueError, EOFError) as error:
        logger.warning("%s cannot be used (%s): making it anew", path, error)
        return None
    return part
