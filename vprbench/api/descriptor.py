"""A method whose codes are unit vectors: its map is an index of the references' vectors."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar, Self

import numpy as np
import numpy.typing as npt

from vprbench.api.arrays import Places, Scores
from vprbench.api.method import Method
from vprbench.api.search import Audit, Search, agreement, check_index
from vprbench.api.search_indexes import Kind
from vprbench.errors import NotFittedError

if TYPE_CHECKING:
    from vprbench.api.images import Images

_BLOCK = 64  # references encoded together
_BLOCK_BYTES = 1 << 26  # of decoded images in such a block


@dataclass(kw_only=True, eq=False)
class DescriptorMethod(Method):
    """A method whose codes are unit vectors: only `encode` -> float32 (n_images, n_dimensions) is left to write.

    A place scores the inner product with its most similar image. `index` chooses how they are found; approximate ones
    (`hnsw`, `ivfpq`) retrieve `neighbours` images, and a place without any of these scores -inf.
    """

    query_arguments: ClassVar[frozenset[str]] = frozenset({"index", "neighbours"})
    #: Arguments that do not change descriptors: cached descriptors stay valid whatever the values of these arguments.
    search_arguments: ClassVar[frozenset[str]] = frozenset({"index", "neighbours"})

    index: Kind = "exact"
    neighbours: int = 100

    #: The indexed references; None before `fit`, and None in a subclass that matches in its own way.
    searched: Search | None = field(default=None, init=False, repr=False, compare=False)

    def fit(self, references: Images, places: Places) -> Self:
        """Encode the references block by block, into one array, and learn the map from it."""
        self.searched = None
        self.insist_on_index(len(references))
        descriptors = np.empty((0, 0), np.float32)
        done = 0
        for block in encoded_blocks(references):
            codes = self.encode(block)
            if not done:
                descriptors = np.empty((len(references), codes.shape[1]), np.float32)
            descriptors[done : done + len(block)] = codes
            done += len(block)
            del block, codes  # or they would be held while the next ones are made
        return self.fit_descriptors(descriptors, places)

    def fit_descriptors(self, descriptors: npt.NDArray[np.float32], places: Places) -> Self:
        """Learn the map from the codes of the references, (n_references, n_dimensions), and forget any earlier map.

        The array is not copied and may be memory-mapped. Raises BadInput if `index` cannot be made of it.
        """
        self.searched = None
        self.searched = Search(descriptors, places.copy(), self.index, self.neighbours)
        return self

    def insist_on_index(self, n_references: int) -> None:
        """Raise BadInput if `index` cannot be made of so many references, before they are encoded."""
        check_index(self.index, self.neighbours, n_references)

    def match(self, codes: npt.NDArray[np.float32]) -> Scores:
        """Return the inner product with the best reference image of each place; -inf if none was retrieved."""
        return self._indexed().scores(codes)

    def keeps_descriptors(self) -> bool:
        """Tell whether descriptors of whole traverses are worth keeping on disk; False if `fit` changes descriptors."""
        return False

    def audit(self, codes: npt.NDArray[np.float32]) -> Audit:
        """Return the share of the places found by exact search for `codes` that the index finds too."""
        index = self._indexed()
        if index.kind == "exact":
            return Audit(1.0, 1.0)
        exact = index.exactly()
        blocks = [*index.blocks(codes)]
        shares = [agreement(self._matched(index, block), self._matched(exact, block)) for block in blocks]
        return Audit(*np.concatenate(shares).mean(0).tolist())

    def _matched(self, index: Search, codes: npt.NDArray[np.float32]) -> Scores:
        """Call `match`, as a subclass may override it, with another index."""
        kept, self.searched = self.searched, index
        try:
            return self.match(codes)
        finally:
            self.searched = kept

    def _indexed(self) -> Search:
        if self.searched is None:
            raise NotFittedError(f"{type(self).__name__} has no map yet: call fit(references, places) first")
        return self.searched


def encoded_blocks(images: Images) -> Iterator[Images]:
    """Yield consecutive images that are decoded and encoded together, fewer if they are large."""
    return images.blocks(_BLOCK, _BLOCK_BYTES)


def best_image_of_place(similarity: Scores, places: Places) -> Scores:
    """Reduce (n_queries, n_references) to (n_queries, n_places): a place is worth its most similar image."""
    if np.array_equal(places, np.arange(len(places))):
        return similarity
    order = np.argsort(places, kind="stable")
    starts = np.flatnonzero(np.diff(places[order], prepend=-1))
    return np.maximum.reduceat(similarity[:, order], starts, axis=1)
