"""What the benchmark of speed shows to methods: smooth random frames of a route, and noisy copies of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import cv2
import numpy as np
import numpy.typing as npt

from vprbench.api.arrays import Places
from vprbench.api.images import Images

_PIXELS_PER_CELL = 4  # of the coarse noise that a frame is blown up from
_NOISE = 10  # grey levels to either side that a copy of a frame differs by
_QUERIES = 1_000_000  # a traverse number that no reference has


def unit_vectors(n: int, n_dimensions: int, generator: np.random.Generator) -> npt.NDArray[np.float32]:
    """Draw n descriptors of length 1, (n, n_dimensions)."""
    vectors = generator.standard_normal((n, n_dimensions), np.float32)
    vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
    return vectors


@dataclass(frozen=True)
class Route:
    """Frames in memory, one a place; a further traverse shows each of them with noise of its own.

    They cost what real frames of their size cost, but say nothing about accuracy.
    """

    frames: npt.NDArray[np.uint8]  # (n_places, height, width)
    seed: int

    @classmethod
    def drawn(cls, n_places: int, height: int, width: int, seed: int) -> Self:
        """Draw the frames of a route."""
        generator = np.random.default_rng(seed)
        frames = np.empty((n_places, height, width), np.uint8)
        for frame in frames:
            coarse = generator.uniform(0, 255, (-(-height // _PIXELS_PER_CELL), -(-width // _PIXELS_PER_CELL)))
            blown_up = cv2.resize(coarse.astype(np.float32), (width, height), interpolation=cv2.INTER_CUBIC)
            np.clip(blown_up, 0, 255, out=frame, casting="unsafe")
        return cls(frames, seed)

    def references(self, n_places: int, traverses: int) -> tuple[Images, Places]:
        """Return `traverses` traverses of the first places."""
        shown = [self.frames[:n_places], *(self._noisy(np.arange(n_places), n) for n in range(1, traverses))]
        return Images.from_arrays([*np.concatenate(shown)]), np.tile(np.arange(n_places), traverses)

    def queries(self, n_places: int, count: int) -> tuple[Images, Places]:
        """Return `count` noisy frames, evenly spread over the first places, and the place that each shows."""
        places = np.linspace(0, n_places - 1, count).astype(np.int64)
        return Images.from_arrays([*self._noisy(places, _QUERIES)]), places

    def _noisy(self, places: Places, traverse: int) -> npt.NDArray[np.uint8]:
        generator = np.random.default_rng([self.seed, traverse])
        chosen = self.frames[places]
        noise = generator.integers(-_NOISE, _NOISE + 1, chosen.shape, np.int16)
        return np.asarray(np.clip(chosen + noise, 0, 255), np.uint8)
