"""Bits of Gabor filters and of oriented edges: small maps, compared by Hamming distance."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import numpy.typing as npt

from vprbench.api import BadInput, BinaryMethod, Images, pack_bits

from .parts.filters.gabor import GaborBank
from .parts.filters.oriented import OrientedEdges

Within = Literal["map", "cell"]


@dataclass
class GaborBinary(BinaryMethod):
    """Keeps where each of 32 Gabor filters answers most strongly; a score is minus the bits that differ.

    A bit is set for the strongest `shares` of the cells in a filter's map, or, `within` a cell, of the filters, as far
    as they respond at all; several shares give a bit each. Of this project; bits by cell as binary patterns have.
    """

    height: int = 32  # pixels
    width: int = 64
    patch: int = 11  # pixels, of the patch normalisation
    block: int = 5  # cells, by whose energy responses are normalised
    epsilon: float = 0.1  # in shares of the grey levels
    within: Within = "map"
    shares: list[float] = field(default_factory=lambda: [0.3])

    def encode(self, images: Images) -> npt.NDArray[np.uint64]:
        """Return the bits, packed: (n_images, n_words)."""
        bank = GaborBank(self.height, self.width, self.patch, self.block, self.epsilon)
        n_cells = bank.rows * bank.columns
        codes = bank(images).reshape(len(images), n_cells, bank.n_inputs // n_cells)
        return pack_bits(mark_strongest(codes, self.within, self.shares))


@dataclass
class OrientedBinary(BinaryMethod):
    """Keeps where edges of each orientation are strongest; a score is minus the bits that differ.

    A bit is set for the strongest `shares` of the cells in an orientation's map, or, `within` a cell, of the
    orientations, as far as there are any; several shares give a bit each. Of this project.
    """

    height: int = 32  # pixels
    width: int = 64
    rows: int = 16  # cells
    columns: int = 16
    orientations: int = 6
    block: int = 5  # cells, by whose energy edges are normalised
    epsilon: float = 16.0  # grey levels
    within: Within = "map"
    shares: list[float] = field(default_factory=lambda: [0.03, 0.1, 0.25])

    def encode(self, images: Images) -> npt.NDArray[np.uint64]:
        """Return the bits, packed: (n_images, n_words)."""
        sizes = (self.height, self.width, self.rows, self.columns, self.orientations)
        edges = OrientedEdges(*sizes, self.block, self.epsilon)
        codes = edges(images).reshape(len(images), self.rows * self.columns, self.orientations)
        return pack_bits(mark_strongest(codes, self.within, self.shares))


def mark_strongest(values: npt.NDArray[np.float32], within: Within, shares: list[float]) -> npt.NDArray[np.bool_]:
    """Return for each share which values are among the strongest, (n_images, len(shares) * n_cells * n_maps).

    `values` (n_images, n_cells, n_maps) are 0 or more; a 0 is never among the strongest, and values as strong as the
    last of them all are. Raises BadInput for shares outside 0..1.
    """
    if not shares or not all(0 < share <= 1 for share in shares):
        raise BadInput(f"method.shares={shares}: give shares of more than 0, up to 1, as in [0.3]")
    axis = {"map": 1, "cell": 2}[within]
    n = values.shape[axis]
    places = [n - max(1, round(share * n)) for share in shares]
    ranked = np.partition(values, places, axis=axis)
    least = [np.take(ranked, [place], axis=axis) for place in places]
    bits = [(values >= level) & (values > 0) for level in least]
    return np.concatenate(bits, axis=1).reshape(len(values), -1)
