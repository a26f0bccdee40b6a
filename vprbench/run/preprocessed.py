"""The preprocessed frames of whole traverses: from the cache where they are kept, made and kept where they are not."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from vprbench.api.images import Images
from vprbench.api.preprocess import PatchNormalisation
from vprbench.run import machine
from vprbench.run.record import content_key
from vprbench.run.sources import source_hash
from vprbench.storage.arrays import ArrayCache

Levels = npt.NDArray[np.uint8]  # (n_images, n_pixels)

_FEWEST = 256  # images; fewer are made at once
_SECONDS, _READING_SECONDS = "seconds", "reading_seconds"


class Preprocessed:
    """Keeps the patch-normalised frames of one run's traverses, and adds up what was spent on those it had already.

    They are found by the content of the files, the arguments, the source code behind, and all that the time depends
    on: processor, threads and libraries.
    """

    def __init__(self, folder: Path, threads: int) -> None:
        """Keep them in `folder`; nothing is touched until a method asks."""
        self._arrays = ArrayCache(folder, "preprocessed frames")
        self._origin = {
            "code": source_hash(PatchNormalisation),
            "processor": machine.device_class("cpu"),
            "threads": threads,
            "libraries": machine.library_versions(),
        }
        self.images = 0  # that were had from the cache
        self.seconds = 0.0  # that reading and preprocessing them took when they were made
        self.reading_seconds = 0.0  # of these, spent waiting for images

    def kept(self, images: Images) -> Images:
        """Return a traverse whose preprocessing is kept; what is no file, or too little to be worth it, as it is."""
        if not images.are_files or len(images) < _FEWEST:
            return images
        return images.kept_by(partial(self._levels, images.content_hash()))

    def _levels(
        self,
        content: str,
        images: Images,
        arguments: Mapping[str, Any],
        n_columns: int,
        fill: Callable[[Levels], None],
    ) -> Levels:
        origin = {**self._origin, "images": content, "arguments": dict(arguments)}
        key, shape = content_key(origin), (len(images), n_columns)
        found = self._find(key, shape)
        if found is not None:
            levels, seconds, reading_seconds = found
            self.images += len(images)
            self.seconds += seconds
            self.reading_seconds += reading_seconds
            return levels
        spent: dict[str, float] = {}

        def timed(levels: Levels) -> None:
            started, read = time.perf_counter(), images.reading.seconds
            fill(levels)
            spent[_SECONDS] = time.perf_counter() - started
            spent[_READING_SECONDS] = images.reading.seconds - read

        made = self._arrays.keep(key, shape, np.uint8, timed, lambda: {**origin, **spent})
        found = self._find(key, shape)
        return made if found is None else found[0]

    def _find(self, key: str, shape: tuple[int, int]) -> tuple[Levels, float, float] | None:
        """Return what is kept, memory-mapped, and the seconds spent on it; None where either is missing."""
        levels = self._arrays.find(key, shape, np.uint8, "c")  # written to, it would be a copy: it looks like any other
        origin = self._arrays.origin(key) or {}
        seconds, reading_seconds = origin.get(_SECONDS), origin.get(_READING_SECONDS)
        if levels is None or not isinstance(seconds, float) or not isinstance(reading_seconds, float):
            return None
        return levels, seconds, reading_seconds
