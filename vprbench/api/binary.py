"""A method whose codes are bits: its map is the references' bits, compared by Hamming distance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Self

import numpy as np

from vprbench.api.arithmetic import count_operations
from vprbench.api.arrays import Places, Scores
from vprbench.api.descriptor import best_image_of_place, encoded_blocks
from vprbench.api.method import Method, require_codes
from vprbench.api.nearest import Words, compare_bits
from vprbench.errors import BadInput, NotFittedError

if TYPE_CHECKING:
    from vprbench.api.images import Images


@dataclass(kw_only=True, eq=False)
class BinaryMethod(Method):
    """A method whose codes are bits: only `encode` -> uint64 (n_images, n_words) is left to write; see `pack_bits`.

    A place scores minus the number of bits in which its most similar image differs.
    """

    #: The references' bits, (n_references, n_words), and the place of each; None before `fit`.
    known: tuple[Words, Places] | None = field(default=None, init=False, repr=False, compare=False)

    def fit(self, references: Images, places: Places) -> Self:
        """Encode the references block by block and keep their bits; raises BadInput for anything but words."""
        self.known = None
        blocks = encoded_blocks(references)
        codes = np.concatenate([require_codes(self.encode(block), len(block)) for block in blocks])
        if codes.dtype != np.uint64 or codes.ndim != 2 or not codes.size:
            raise BadInput(
                f"encode returned {codes.dtype} {codes.shape} for the references: return uint64 (n_images, n_words), "
                "as pack_bits makes of truth values"
            )
        self.known = np.ascontiguousarray(codes), places.copy()
        return self

    def match(self, codes: Words) -> Scores:
        """Return minus the bits that differ from the most similar reference image of each place.

        Raises ValueError for codes that are not words, or not as many as the references have.
        """
        if self.known is None:
            raise NotFittedError(f"{type(self).__name__} has no map yet: call fit(references, places) first")
        known, places = self.known
        n_words = known.shape[1]
        if codes.dtype != np.uint64 or codes.ndim != 2 or codes.shape[1] != n_words:
            raise ValueError(
                f"codes of {codes.dtype} {codes.shape} came; this map compares uint64 (n_queries, {n_words})"
            )
        count_operations(single=3 * len(codes) * known.size, kind="int64")  # differ, count, add
        return best_image_of_place(compare_bits(codes, known), places)

    @property
    def bytes_per_place(self) -> int | None:
        """The bytes of codes that answers need, for each place; None before `fit`."""
        return None if self.known is None else int(self.known[0].nbytes / (self.known[1].max() + 1))

    def notes(self) -> Sequence[str]:
        """Return how many bytes of codes the map holds for each place."""
        size = self.bytes_per_place
        return () if size is None else [f"binary codes: {size:,} bytes a place"]
