"""Arrays on disk that are found by what they came from, and read memory-mapped."""

from __future__ import annotations

import contextlib
import json
import logging
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from vprbench.storage.atomic import remove_leftovers, unfinished

logger = logging.getLogger(__name__)

Array = npt.NDArray[Any]


@dataclass(frozen=True)
class ArrayCache:
    """A folder of arrays: `<key>.npy` holds an array, `<key>.json` says what it came from.

    Several processes may use it at once. A disk that is full or cannot be written costs the cache and never the run:
    a warning is logged, and the array stays in memory. `what` names the content of the arrays: descriptors, ...
    """

    folder: Path
    what: str

    def find(self, key: str, shape: tuple[int | None, ...], dtype: type[np.generic]) -> Array | None:
        """Return the array under a key, memory-mapped to be read; None if there is none of this shape.

        A length of None in `shape` stands for any length.
        """
        path = self.folder / f"{key}.npy"
        try:
            stored: Array = np.load(path, mmap_mode="r", allow_pickle=False)
        except FileNotFoundError:
            return None
        except (OSError, ValueError, EOFError) as error:
            logger.warning("%s cannot be used (%s): making it anew", path, error)
            return None
        fits = len(stored.shape) == len(shape) and all(
            wanted in (None, found) for wanted, found in zip(shape, stored.shape, strict=True)
        )
        if stored.dtype != dtype or not fits:
            logger.warning(
                "%s holds %s of shape %s; wanted %s of shape %s: making it anew",
                path,
                stored.dtype,
                stored.shape,
                np.dtype(dtype),
                tuple("any" if length is None else length for length in shape),
            )
            return None
        return stored

    def keep(
        self,
        key: str,
        shape: tuple[int, ...],
        dtype: type[np.generic],
        fill: Callable[[Array], None],
        origin: Callable[[], Mapping[str, Any]],
    ) -> Array:
        """Let `fill` write an array, keep it and return it; `origin`, asked afterwards, says what it is of.

        If it cannot be kept it is returned all the same. An error of `fill` leaves nothing behind.
        """
        partial = unfinished(self.folder, ".npy")
        about = partial.with_suffix(".json")
        remove_leftovers(self.folder)
        try:
            array, on_disk = self._room(partial, shape, dtype)
            fill(array)
            if not on_disk:
                return array
            try:
                assert isinstance(array, np.memmap)
                array.flush()
                about.write_text(json.dumps({**origin(), "bytes": array.nbytes}, indent=1), encoding="utf-8")
                about.replace(self.folder / f"{key}.json")
                partial.replace(self.folder / f"{key}.npy")
                logger.info("%.1f MB of %s are kept in %s", array.nbytes / 1e6, self.what, self.folder)
            except OSError as error:
                logger.warning("%s could not be kept in %s (%s)", self.what, self.folder, error.strerror or error)
            return array
        finally:
            for path in (partial, about):
                with contextlib.suppress(OSError):
                    path.unlink(missing_ok=True)

    def _room(self, partial: Path, shape: tuple[int, ...], dtype: type[np.generic]) -> tuple[Array, bool]:
        """Return an array to fill and whether it lies on disk."""
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            array = np.lib.format.open_memmap(partial, "w+", dtype, shape)
            if hasattr(os, "posix_fallocate"):  # a full disk is an error now, not a crash while the array is filled
                with partial.open("r+b") as file:
                    os.posix_fallocate(file.fileno(), 0, file.seek(0, os.SEEK_END))
            return array, True
        except OSError as error:
            logger.warning("no %s are kept in %s: %s", self.what, self.folder, error.strerror or error)
            return np.empty(shape, dtype), False
