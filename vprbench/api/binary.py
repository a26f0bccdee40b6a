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


class BinaryMap:
    """The bits of a map's references."""

    def __init__(self, codes: Words, places: Places) -> None:
        """Keep a copy of the codes, (n_references, n_words), with the place of each.

        Raises BadInput for anything but words of one image or more.
        """
        if codes.dtype != np.uint64 or codes.ndim != 2 or places.shape != (len(codes),) or not codes.size:
            raise BadInput(
                f"references of {codes.dtype} {codes.shape} came with places {places.shape}: wanted uint64 "
                "(n_images, n_words) of an image or more, and a place for each"
            )
        self._places = places
        self._codes = codes.copy(order="C")

    @property
    def bytes_per_place(self) -> int:
        """The bytes of codes that answers need, for each place."""
        return int(self._codes.nbytes / (self._places.max() + 1))

    def scores(self, codes: Words) -> Scores:
        """Return for each place minus the bits in which its most similar image differs, (n_queries, n_places).

        Raises ValueError for codes that are not words, or not as many as the references have.
        """
        n_words = self._codes.shape[1]
        if codes.dtype != np.uint64 or codes.ndim != 2 or codes.shape[1] != n_words:
            raise ValueError(
                f"codes of {codes.dtype} {codes.shape} came; this map compares uint64 (n_queries, {n_words})"
            )
        count_operations(single=3 * len(codes) * self._codes.size, kind="int64")  # differ, count, add
        return best_image_of_place(compare_bits(codes, self._codes), self._places)


@dataclass(kw_only=True, eq=False)
class BinaryMethod(Method):
    """A method whose codes are bits: only `encode` -> uint64 (n_images, n_words) is left to write; see `pack_bits`.

    A place scores minus the number of bits in which its most similar image differs.
    """

    #: The references' bits; None before `fit`.
    known: BinaryMap | None = field(default=None, init=False, repr=False, compare=False)

    def fit(self, references: Images, places: Places) -> Self:
        """Encode the references block by block and keep their bits."""
        self.known = None
        blocks = encoded_blocks(references)
        codes = np.concatenate([require_codes(self.encode(block), len(block)) for block in blocks])
        self.known = BinaryMap(codes, places.copy())
        return self

    def match(self, codes: Words) -> Scores:
        """Return minus the bits that differ from the most similar reference image of each place."""
        if self.known is None:
            raise NotFittedError(f"{type(self).__name__} has no map yet: call fit(references, places) first")
        return self.known.scores(codes)

    def notes(self) -> Sequence[str]:
        """Return how many bytes of codes the map holds for each place."""
        return () if self.known is None else [f"binary codes: {self.known.bytes_per_place:,} bytes a place"]
