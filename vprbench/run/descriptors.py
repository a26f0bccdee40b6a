"""The descriptors of a run's traverses: from the cache if they are kept there, else encoded and kept."""

from __future__ import annotations

from collections.abc import Callable, Mapping
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


class Described:
    """Gives the descriptors of whole traverses; a method whose descriptors are not worth keeping has none."""

    def __init__(self, folder: Path, origin: Mapping[str, Any]) -> None:
        """Keep descriptors in a folder; `origin` is all but the images that a descriptor comes from."""
        self._kept = ArrayCache(folder, "descriptors")
        self._origin = origin

    @classmethod
    def of(cls, folder: Path | None, method: Method, config: Mapping[str, Any]) -> Described | None:
        """Return what gives the descriptors of a run's method; None if none are kept.

        The path and the name of a file of weights do not count, for its content does.
        """
        if folder is None or not isinstance(method, DescriptorMethod) or not method.keeps_descriptors():
            return None
        apart = {"_target_", "device", *method.query_arguments, *method.search_arguments}
        apart |= {name for name in config["method"] if isinstance(getattr(method, name, None), Weights)}
        origin = {
            "arguments": {name: value for name, value in config["method"].items() if name not in apart},
            "code": source_hash(type(method)),
            "files": [sha256 for _, sha256 in config.get("files", [])],
            "device": machine.device_class(config["device"]),
            "libraries": machine.library_versions(),
        }
        return cls(folder, origin)

    def descriptors(
        self, images: Images, encode: Callable[[Images], Descriptors], done: Callable[[int], None]
    ) -> tuple[Descriptors, bool]:
        """Return the descriptors of a traverse, (n_images, n_dimensions), and whether they were kept already.

        `encode` describes a block of images, `done` is told how many are described. Descriptors that the disk refuses
        are returned all the same, in memory.
        """
        origin = {**self._origin, "images": images.content_hash()}
        key = content_key(origin)
        kept = self._kept.find(key, (len(images), None), np.float32)
        if kept is not None:
            return kept, True
        blocks = encoded_blocks(images)
        first = encode(next(blocks))
        shape = (len(images), first.shape[1])

        def fill(descriptors: Descriptors) -> None:
            count = len(first)
            descriptors[:count] = first
            done(count)
            for block in blocks:
                descriptors[count : count + len(block)] = encode(block)
                count += len(block)
                done(count)

        about = {**origin, "n_images": shape[0], "n_dimensions": shape[1]}
        return self._kept.keep(key, shape, np.float32, fill, lambda: about), False
