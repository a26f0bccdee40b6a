"""The descriptors of a run's traverses: from the cache if they are kept there, else encoded and kept."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from vprbench.api.descriptor import DescriptorMethod, encoded_blocks
from vprbench.api.images import Images
from vprbench.api.method import Method
from vprbench.api.weights import Weights
from vprbench.run import machine
from vprbench.run.record import content_key
from vprbench.run.sources import source_hash
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


class Described:
    """Gives the descriptors of whole traverses; a method whose descriptors are not worth keeping has none."""

    def __init__(self, cache: DescriptorCache, method: DescriptorMethod, origin: Mapping[str, Any]) -> None:
        """Take `origin`, all but the images that a descriptor comes from."""
        self._cache = cache
        self._method = method
        self._origin = origin

    @classmethod
    def of(cls, cache: DescriptorCache | None, method: Method, config: Mapping[str, Any]) -> Described | None:
        """Return what gives the descriptors of a run's method; None where none are kept.

        Where a file of weights lies and what it is called does not count, for its content does.
        """
        if cache is None or not isinstance(method, DescriptorMethod) or not method.keeps_descriptors():
            return None
        apart = {"_target_", "device", *method.query_arguments, *method.search_arguments}
        apart |= {name for name in config["method"] if isinstance(getattr(method, name, None), Weights)}
        return cls(
            cache,
            method,
            {
                "arguments": {name: value for name, value in config["method"].items() if name not in apart},
                "code": source_hash(type(method)),
                "files": [sha256 for _, sha256 in config.get("files", [])],
                "device": machine.device_class(config["device"]),
                "libraries": machine.library_versions(),
            },
        )

    def descriptors(
        self, images: Images, encode: Callable[[Images], Descriptors], done: Callable[[int], None]
    ) -> tuple[Descriptors, bool]:
        """Return the descriptors of a traverse, (n_images, n_dimensions), and whether they were kept already.

        `encode` describes a block of images, `done` is told how many are.
        """
        origin = {**self._origin, "images": images.content_hash()}
        key = content_key(origin)
        kept = self._cache.find(key, len(images))
        if kept is not None:
            return kept, True

        def blocks() -> Iterator[Descriptors]:
            count = 0
            for block in encoded_blocks(images):
                yield encode(block)
                count += len(block)
                done(count)

        return self._cache.keep(key, len(images), blocks(), origin), False
