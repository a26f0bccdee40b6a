"""The descriptors of a run's traverses: from the cache if they are kept there, else encoded and kept."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from vprbench.api.arrays import Descriptors
from vprbench.api.descriptor import DescriptorMethod, encode_stretches
from vprbench.api.images import Images
from vprbench.api.method import Method
from vprbench.api.weights import Weights
from vprbench.runs import machine
from vprbench.runs.identity import hash_class, hash_content
from vprbench.storage.row_files import keep_rows


@dataclass(frozen=True)
class DescriptorCache:
    """Gives the descriptors of whole traverses; a method whose descriptors are not worth keeping has none."""

    folder: Path
    origin: Mapping[str, Any]  # all but the images that a descriptor comes from

    @classmethod
    def of(cls, folder: Path | None, method: Method, config: Mapping[str, Any]) -> DescriptorCache | None:
        """Return the cache for the descriptors of a run's method; None if none are kept.

        The path and the name of a file of weights do not count, for its content does.
        """
        if folder is None or not isinstance(method, DescriptorMethod) or not method.keeps_descriptors():
            return None
        apart = {"_target_", "device", *method.query_arguments, *method.search_arguments}
        apart |= {name for name in config["method"] if isinstance(getattr(method, name, None), Weights)}
        origin = {
            "arguments": {name: value for name, value in config["method"].items() if name not in apart},
            "code": hash_class(type(method)),
            "files": [sha256 for _, sha256 in config.get("files", [])],
            "device": machine.classify_device(config["device"]),
            "libraries": machine.list_library_versions(),
        }
        return cls(folder, origin)

    def descriptors(
        self, images: Images, encode: Callable[[Images], npt.NDArray[np.float32]], done: Callable[[int], None]
    ) -> tuple[Descriptors, int]:
        """Return the descriptors of a traverse, (n_images, n_dimensions), and how many were kept already.

        `encode` describes a block of images; `done` is called with the number of images described so far. A killed run
        is continued but for up to 1024 images. Raises BadInput if the disk refuses the descriptors.
        """
        key = hash_content({**self.origin, "images": images.content_hash()})
        path = self.folder / f"{key}.npy"
        return keep_rows(path, len(images), lambda first: encode_stretches(images, encode, done, first), "descriptors")
