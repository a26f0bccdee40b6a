"""Descriptors of whole traverses on disk, found by what they came from, and read memory-mapped."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from vprbench.storage.arrays import ArrayCache

Descriptors = npt.NDArray[np.float32]  # (n_images, n_dimensions)


@dataclass(frozen=True)
class DescriptorCache:
    """A folder of descriptors, those of one traverse under each key; used as `ArrayCache` says."""

    folder: Path

    def find(self, key: str, n_images: int) -> Descriptors | None:
        """Return the descriptors under a key, memory-mapped and read-only; None where there are none for `n_images`."""
        return self._arrays.find(key, (n_images, None), np.float32)

    def keep(self, key: str, n_images: int, blocks: Iterator[Descriptors], origin: Mapping[str, Any]) -> Descriptors:
        """Write descriptors block by block as they come and return them all; `origin` says what they are of.

        Where writing fails they are returned all the same, in memory. An error of `blocks` leaves nothing behind.
        """
        first = next(blocks)
        shape = (n_images, first.shape[1])

        def fill(descriptors: Descriptors) -> None:
            descriptors[: len(first)] = first
            done = len(first)
            for block in blocks:
                descriptors[done : done + len(block)] = block
                done += len(block)

        about = {**origin, "n_images": n_images, "n_dimensions": first.shape[1]}
        return self._arrays.keep(key, shape, np.float32, fill, lambda: about)

    @property
    def _arrays(self) -> ArrayCache:
        return ArrayCache(self.folder, "descriptors")
