"""Frames of a route, drawn in memory: for measurements that need many places and no files."""

from dataclasses import dataclass

import cv2
import numpy as np

from vprbench.api import Images

PIXELS_PER_CELL = 4  # of the coarse grid that a frame is blown up from
NOISE = 12  # grey levels to either side by which a copy of a frame differs
QUERIES = 1_000_000  # a traverse number that no reference has


@dataclass(frozen=True)
class Route:
    """Frames (n_places, height, width) of uint8, one a place; a further traverse shows each with noise of its own."""

    frames: np.ndarray
    seed: int

    @classmethod
    def draw(cls, n_places, height=32, width=64, seed=0):
        """Draw the frames of a route."""
        generator = np.random.default_rng(seed)
        frames = np.empty((n_places, height, width), np.uint8)
        for frame in frames:
            coarse = generator.uniform(0, 255, (-(-height // PIXELS_PER_CELL), -(-width // PIXELS_PER_CELL)))
            blown_up = cv2.resize(coarse.astype(np.float32), (width, height), interpolation=cv2.INTER_CUBIC)
            np.clip(blown_up, 0, 255, out=frame, casting="unsafe")
        return cls(frames, seed)

    def references(self, n_places, traverses=1):
        """Return `traverses` traverses of the first places, and the place that each image shows."""
        shown = [self.frames[:n_places], *(self._noisy(np.arange(n_places), n) for n in range(1, traverses))]
        return Images.from_arrays([*np.concatenate(shown)]), np.tile(np.arange(n_places), traverses)

    def queries(self, n_places, count):
        """Return `count` noisy frames, evenly spread over the first places."""
        return Images.from_arrays([*self._noisy(np.linspace(0, n_places - 1, count).astype(np.int64), QUERIES)])

    def _noisy(self, places, traverse):
        generator = np.random.default_rng([self.seed, traverse])
        chosen = self.frames[places]
        noise = generator.integers(-NOISE, NOISE + 1, chosen.shape, np.int16)
        return np.clip(chosen + noise, 0, 255).astype(np.uint8)
