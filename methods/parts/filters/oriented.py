"""Oriented edges of frames, normalised by their neighbourhood: an input of spiking networks beside patches."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from vprbench.api import BadInput, Image, Images, count_operations, encode_blocks

from . import oriented_compiled


@dataclass(frozen=True)
class OrientedEdges:
    """How strong edges of each orientation are in every cell of a frame, 0 to 1.

    A frame becomes grey, then `height` x `width` pixels by means over areas. Central differences, borders
    replicated, give each pixel a magnitude, which it shares between the two nearest of `orientations` bins of half a
    turn. Each bin is averaged over the pixels of a cell, `rows` x `columns` of them, and divided by the root of the
    cells' energy, averaged over `block` x `block` cells (borders reflected), plus `epsilon` grey levels, and raised to
    `power`: below 1 weak edges count for more. A frame of one level gives zeros. As histograms of oriented gradients
    (Dalal and Triggs 2005), but with energies of blocks around each cell and without gamma.
    All threads that PyTorch may use share the frames. Raises BadInput for sizes under which there is no code.
    """

    height: int = 32  # pixels
    width: int = 64
    rows: int = 8  # cells
    columns: int = 16
    orientations: int = 8
    block: int = 3  # cells
    epsilon: float = 16.0  # grey levels
    power: float = 1.0

    def __post_init__(self) -> None:
        """Check the sizes."""
        for name, least in {"height": 1, "width": 1, "rows": 1, "columns": 1, "orientations": 2, "block": 1}.items():
            if getattr(self, name) < least:
                raise BadInput(f"method.{name}={getattr(self, name)}: give at least {least}")
        if self.block % 2 == 0:
            raise BadInput(f"method.block={self.block}: a block needs a cell in its centre, give an odd number")
        if not 0 < self.epsilon < math.inf:
            raise BadInput(f"method.epsilon={self.epsilon}: give grey levels, more than 0")
        if not 0 < self.power < math.inf:
            raise BadInput(f"method.contrast_power={self.power}: give a finite power, more than 0")

    @property
    def n_inputs(self) -> int:
        """The length of a code."""
        return self.rows * self.columns * self.orientations

    def __call__(self, images: Images) -> npt.NDArray[np.float32]:
        """Return (n_images, rows * columns * orientations): the orientations of a cell side by side."""
        codes = np.empty((len(images), self.n_inputs), np.float32)
        encode_blocks(images, codes, self._write)
        return codes

    def _write(self, images: Sequence[Image], codes: npt.NDArray[np.float32]) -> None:
        cells = codes.reshape(-1, self.rows, self.columns, self.orientations)
        small, n_cells = len(images) * self.height * self.width, len(images) * self.rows * self.columns
        # Grey and means of the frame; differences, length, angle and votes of a small pixel; energies and divisions.
        count_operations(
            4 * sum(image.size // 3 for image in images) + 6 * small + codes.size, 10 * small + 3 * codes.size
        )
        count_operations(single=n_cells * (self.block**2 + 2))
        for image, code in zip(images, cells, strict=True):
            pixels = np.ascontiguousarray(image)
            oriented_compiled.encode(pixels, self.height, self.width, self.block, self.epsilon, code)
            if self.power == 0.75:  # two roots take less time than a power
                np.sqrt(code, out=code)
                code *= np.sqrt(code)
            elif self.power != 1:
                np.power(code, np.float32(self.power), out=code)
