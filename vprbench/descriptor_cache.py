"""Descriptors of whole traverses on disk, found by what they came from, and read memory-mapped."""

from __future__ import annotations

import contextlib
import json
import logging
import os
import socket
import uuid
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import psutil

logger = logging.getLogger(__name__)

Descriptors = npt.NDArray[np.float32]  # (n_images, n_dimensions)

_PARTIAL = ".partial-"


@dataclass(frozen=True)
class DescriptorCache:
    """A folder of descriptors: `<key>.npy` holds those of one traverse, `<key>.json` says what they came from.

    Several processes may use it at once. A disk that is full or cannot be written costs the cache and never the run:
    it is said, and the descriptors stay in memory.
    """

    folder: Path

    def find(self, key: str, n_images: int) -> Descriptors | None:
        """Return the descriptors under a key, memory-mapped and read-only; None where there are none for `n_images`."""
        try:
            stored: npt.NDArray[Any] = np.load(self.folder / f"{key}.npy", mmap_mode="r", allow_pickle=False)
        except FileNotFoundError:
            return None
        except (OSError, ValueError, EOFError) as error:
            logger.warning("%s cannot be used (%s): encoding anew", self.folder / f"{key}.npy", error)
            return None
        if stored.dtype != np.float32 or stored.ndim != 2 or len(stored) != n_images:
            logger.warning(
                "%s holds %s of shape %s; wanted float32 for %d images: encoding anew",
                self.folder / f"{key}.npy",
                stored.dtype,
                stored.shape,
                n_images,
            )
            return None
        return stored

    def keep(self, key: str, n_images: int, blocks: Iterator[Descriptors], origin: Mapping[str, Any]) -> Descriptors:
        """Write descriptors block by block as they come and return them all; `origin` says what they are of.

        Where writing fails they are returned all the same, in memory. An error of `blocks` leaves nothing behind.
        """
        first = next(blocks)
        partial = self.folder / f"{_PARTIAL}{socket.gethostname()}-{os.getpid()}-{uuid.uuid4().hex[:8]}.npy"
        self._remove_leftovers()
        try:
            descriptors, on_disk = self._room(partial, (n_images, first.shape[1]))
            descriptors[: len(first)] = first
            done = len(first)
            for block in blocks:
                descriptors[done : done + len(block)] = block
                done += len(block)
            if not on_disk:
                return descriptors
            try:
                assert isinstance(descriptors, np.memmap)
                descriptors.flush()
                about = {**origin, "n_images": n_images, "n_dimensions": first.shape[1], "bytes": descriptors.nbytes}
                partial.with_suffix(".json").write_text(json.dumps(about, indent=1), encoding="utf-8")
                partial.with_suffix(".json").replace(self.folder / f"{key}.json")
                partial.replace(self.folder / f"{key}.npy")
                logger.info("%.1f MB of descriptors are kept in %s", descriptors.nbytes / 1e6, self.folder)
            except OSError as error:
                logger.warning("descriptors could not be kept in %s (%s)", self.folder, error.strerror or error)
            return descriptors
        finally:
            for path in (partial, partial.with_suffix(".json")):
                with contextlib.suppress(OSError):
                    path.unlink(missing_ok=True)

    def _remove_leftovers(self) -> None:
        """Remove what killed processes of this machine left unfinished."""
        prefix = f"{_PARTIAL}{socket.gethostname()}-"
        for path in self.folder.glob(f"{prefix}*"):
            pid = path.name.removeprefix(prefix).partition("-")[0]
            if pid.isdigit() and not psutil.pid_exists(int(pid)):
                with contextlib.suppress(OSError):
                    path.unlink(missing_ok=True)

    def _room(self, partial: Path, shape: tuple[int, int]) -> tuple[Descriptors, bool]:
        """Return an array to fill and whether it lies on disk."""
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            array = np.lib.format.open_memmap(partial, "w+", np.float32, shape)
            if hasattr(os, "posix_fallocate"):  # a full disk is an error now, not a crash while the array is filled
                with partial.open("r+b") as file:
                    os.posix_fallocate(file.fileno(), 0, file.seek(0, os.SEEK_END))
            return array, True
        except OSError as error:
            logger.warning("no descriptors are kept in %s: %s", self.folder, error.strerror or error)
            return np.empty(shape, np.float32), False
