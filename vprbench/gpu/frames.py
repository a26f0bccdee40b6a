"""Frames in memory that cost what real ones cost: for checks and benchmarks, which say nothing about accuracy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import cv2
import numpy as np
import numpy.typing as npt

from vprbench.api.arrays import Places
from vprbench.api.images import Images

_PIXELS_PER_CELL = 4  # of the coarse grid that a frame is blown up from
_NOISE = 12  # grey levels to either side that a copy of a frame differs by
_QUERIES = 1_000_000  # a traverse number that no reference has


@dataclass(frozen=True)
class Route:
    """Frames, one a place; a further traverse shows each of them with noise of its own."""

    frames: npt.NDArray[np.uint8]  # (n_places, height, width)
    seed: int

    @classmethod
    def drawn(cls, n_places: int, height: int = 32, width: int = 64, seed: int = 0) -> Self:
        """Draw the frames of a route."""
        generator = np.random.default_rng(seed)
        frames = np.empty((n_places, height, width), np.uint8)
        for frame in frames:
            coarse = generator.uniform(0, 255, (-(-height // _PIXELS_PER_CELL), -(-width // _PIXELS_PER_CELL)))
            blown_up = cv2.resize(coarse.astype(np.float32), (width, height), interpolation=cv2.INTER_CUBIC)
            np.clip(blown_up, 0, 255, out=frame, casting="unsafe")
        return cls(frames, seed)

    def references(self, n_places: int, traverses: int = 1) -> tuple[Images, Places]:
        """Return `traverses` traverses of the first places, and the place that each image shows."""
        shown = [self.frames[:n_places], *(self._noisy(np.arange(n_places), n) for n in range(1, traverses))]
        return Images.from_arrays([*np.concatenate(shown)]), np.tile(np.arange(n_places), traverses)

    def queries(self, n_places: int, count: int) -> Images:
        """Return `count` noisy frames, evenly spread over the first places."""
        return Images.from_arrays([*self._noisy(np.linspace(0, n_places - 1, count).astype(np.int64), _QUERIES)])

    def _noisy(self, places: Places, traverse: int) -> npt.NDArray[np.uint8]:
        generator = np.random.default_rng([self.seed, traverse])
        chosen = self.frames[places]
        noise = generator.integers(-_NOISE, _NOISE + 1, chosen.shape, np.int16)
        return np.asarray(np.clip(chosen + noise, 0, 255), np.uint8)
