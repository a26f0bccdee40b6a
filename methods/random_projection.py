"""Random projections: patch-normalised frames seen from a few hundred random directions."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
import numpy.typing as npt

from vprbench.api import BadInput, DescriptorMethod, Images, count_operations

from .parts.filters.patches import MEAN_LEVEL, PatchNormalisation, Variant
from .parts.vectors import unit

Directions = Literal["gaussian", "signs", "sparse_signs"]


@dataclass
class RandomProjection(DescriptorMethod):
    """Describes a frame by its products with random directions, drawn by `seed`; a score is a cosine, -1 to 1.

    Nothing is learnt: the cosine of two codes is that of the patch-normalised frames, but for an error of about
    1 / sqrt(components) (Johnson and Lindenstrauss 1984). Directions are Gaussian, or signs as in Achlioptas (2003):
    +1 and -1 alike, or `sparse_signs`, two thirds of them 0. A frame without contrast scores 0 everywhere.
    """

    preprocessing: Variant = "C"
    height: int = 28  # pixels
    width: int = 28
    patch: int = 7
    components: int = 512
    directions: Directions = "gaussian"
    seed: int = 0

    def encode(self, images: Images) -> npt.NDArray[np.float32]:
        """Return unit vectors, (n_images, components); raises BadInput for fewer than one component."""
        if self.components < 1:
            raise BadInput(f"method.components={self.components}: give at least 1")
        levels = PatchNormalisation(self.preprocessing, self.height, self.width, self.patch)(images)
        contrasts = levels.astype(np.float32) - MEAN_LEVEL
        count_operations(levels.size * self.components)
        return unit(contrasts @ _draw_directions(self.directions, levels.shape[1], self.components, self.seed))


@lru_cache(maxsize=4)
def _draw_directions(kind: Directions, n_pixels: int, n_components: int, seed: int) -> npt.NDArray[np.float32]:
    """Draw the directions, (n_pixels, n_components)."""
    generator = np.random.default_rng(seed)
    if kind == "gaussian":
        return generator.standard_normal((n_pixels, n_components), np.float32)
    shares = (1 / 2, 0, 1 / 2) if kind == "signs" else (1 / 6, 2 / 3, 1 / 6)
    return generator.choice(np.array((-1, 0, 1), np.float32), (n_pixels, n_components), p=shares)
