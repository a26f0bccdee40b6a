"""Hyperdimensional computing: the cells of a frame, each bound to where it is, summed to one long vector."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
import numpy.typing as npt

from vprbench.api import DescriptorMethod, Images, count_operations

from .parts.checks import require_arguments
from .parts.filters.oriented import OrientedEdges
from .parts.filters.patches import MEAN_LEVEL, PatchNormalisation, Variant
from .parts.vectors import unit

Hypervectors = npt.NDArray[np.float32]  # (n, components), 1 and -1
Cells = npt.NDArray[np.float32]  # (n_images, rows, columns, n_features)


@dataclass
class HyperDimensional(DescriptorMethod):
    """Describes a frame by a bundle of its cells, each bound to its position; a score is a cosine, -1 to 1.

    What a cell holds is projected to `components` numbers by random signs, multiplied number by number (bound) with
    the hypervector of its row and that of its column, and all cells are added (bundled). Positions `reach` cells or
    more apart, along either axis, have hypervectors that are unlike one another; in between the similarity falls
    evenly, so that a frame that is shifted a little stays alike. Everything random is drawn by `seed`, nothing is
    learnt. A frame without contrast scores 0 everywhere.
    Source: Neubert and Schubert, "Hyperdimensional computing as a framework for systematic aggregation of image
    descriptors" (CVPR 2021): their binding, bundling and graded positions. In place of descriptors of a network stand
    the patch-normalised pixels of a cell, or how strong its edges of eight orientations are (`OrientedEdges`). Here
    each number of a vector goes from one anchor to the next at a point of its own.
    """

    features: Literal["patches", "oriented"] = "patches"
    preprocessing: Variant = "C"  # of patches
    height: int = 32  # pixels
    width: int = 64
    patch: int = 7  # of patches, as is `cell`
    cell: int = 8  # pixels
    stride: int = 4  # pixels from one cell to the next
    reach: float = 2.0  # cells
    components: int = 4096
    seed: int = 0

    def encode(self, images: Images) -> npt.NDArray[np.float32]:
        """Return unit vectors, (n_images, components).

        Raises BadInput if a frame has no cell and for other sizes that make no vector.
        """
        self._check_arguments()
        cells = self._encode_edges(images) if self.features == "oriented" else self._cut_patches(images)
        n_images, rows, columns, n_features = cells.shape
        signs, positions = _draw_vectors(rows, columns, n_features, self.components, self.reach, self.seed)
        count_operations(cells.size * self.components, cells.size)
        bundles = np.zeros((n_images, self.components), np.float32)
        for number, sign in enumerate(signs):  # one feature of all cells: their sum comes before its projection
            bundles += (cells[..., number].reshape(n_images, rows * columns) @ positions) * sign
        return unit(bundles)

    def _cut_patches(self, images: Images) -> Cells:
        levels = PatchNormalisation(self.preprocessing, self.height, self.width, self.patch)(images)
        frames = levels.reshape(-1, self.height, self.width).astype(np.float32) - MEAN_LEVEL
        windows = np.lib.stride_tricks.sliding_window_view(frames, (self.cell, self.cell), axis=(1, 2))
        cells = windows[:, :: self.stride, :: self.stride]
        return cells.reshape(*cells.shape[:3], self.cell**2)

    def _encode_edges(self, images: Images) -> Cells:
        edges = OrientedEdges(self.height, self.width, self.height // self.stride, self.width // self.stride)
        return edges(images).reshape(len(images), edges.rows, edges.columns, edges.orientations)

    def _check_arguments(self) -> None:
        side = min(self.height, self.width)
        require_arguments(
            self,
            cell=(1 <= self.cell <= side, "1 pixel to the frame's smaller side"),
            stride=(1 <= self.stride <= side, "1 pixel to the frame's smaller side"),
            reach=(self.reach > 0, "more than 0 cells"),
            components=(self.components >= 1, "at least 1"),
        )


@lru_cache(maxsize=4)
def _draw_vectors(
    rows: int, columns: int, n_features: int, n_components: int, reach: float, seed: int
) -> tuple[Hypervectors, Hypervectors]:
    """Draw the signs that project a cell, (n_features, n_components), and the positions, (cells, n_components)."""
    generator = np.random.default_rng(seed)
    signs = _draw_signs(generator, n_features, n_components)
    down, right = (_draw_positions(generator, n, n_components, reach) for n in (rows, columns))
    return signs, (down[:, None] * right).reshape(rows * columns, n_components)


def _draw_positions(generator: np.random.Generator, n: int, n_components: int, reach: float) -> Hypervectors:
    """Draw hypervectors of positions 0 to n - 1 whose similarity is 1 - distance / reach, 0 from `reach` on."""
    scaled = np.arange(n)[:, None] / reach
    anchors = _draw_signs(generator, int(scaled.max()) + 2, n_components)
    passed = scaled + generator.random(n_components)  # which anchor each component has reached
    return anchors[passed.astype(np.int64), np.arange(n_components)]


def _draw_signs(generator: np.random.Generator, n: int, n_components: int) -> Hypervectors:
    return np.where(generator.random((n, n_components)) < 0.5, np.float32(-1), np.float32(1))
