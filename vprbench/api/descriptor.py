"""A method whose codes are unit vectors: its map is an index of the references' vectors."""

from __future__ import annotations

import shutil
import weakref
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
import numpy.typing as npt

from vprbench import progress
from vprbench.api.adaptation import Adapt
from vprbench.api.arrays import Descriptors, Places, Scores
from vprbench.api.method import Method, require_codes
from vprbench.api.search import Audit, Search, check_index, compare_best
from vprbench.api.search_indexes import Kind
from vprbench.errors import BadInput, NotFittedError
from vprbench.storage.atomic import name_unfinished, remove_leftovers
from vprbench.storage.folders import cache_folder
from vprbench.storage.row_files import LARGE_BYTES, STRETCH, keep_rows

if TYPE_CHECKING:
    from vprbench.api.images import Images


class Growing:
    """Rows (n, ...) with room behind them that doubles when it is full; what was taken of them stays as it is."""

    def __init__(self, rows: npt.NDArray[Any]) -> None:
        """Begin with rows that are never written to."""
        self._room, self._n = rows, len(rows)

    @property
    def rows(self) -> npt.NDArray[Any]:
        """All rows, as one view."""
        return self._room[: self._n]

    def append(self, more: npt.NDArray[Any]) -> None:
        """Add rows of the same type and shape at the end."""
        n = self._n + len(more)
        if n > len(self._room):
            room = np.empty((max(n, 2 * self._n), *self._room.shape[1:]), self._room.dtype)
            room[: self._n] = self.rows
            self._room = room
        self._room[self._n : n] = more
        self._n = n


def require_new_places(places: Places, n_images: int, n_known: int) -> None:
    """Raise BadInput unless `places` (n_images,) are the numbers from `n_known` on, each at least once."""
    numbers = np.unique(places)
    if len(places) != n_images or not n_images or not np.array_equal(numbers, n_known + np.arange(len(numbers))):
        came = f"places {numbers[:3].tolist()} and so on, {len(places)} in all, came of {n_images} new images"
        raise BadInput(f"{came}: give the place of each, from {n_known} on without a gap")


_BLOCK = 64  # references encoded together
_BLOCK_BYTES = 1 << 26  # of decoded images in such a block
_MEAN_ROWS = 4096  # descriptors whose mean is taken at once
_FOLDER = "VPRBENCH_SCRATCH"  # environment variable


@dataclass(kw_only=True, eq=False)
class DescriptorMethod(Method):
    """A method whose codes are unit vectors: only `encode` -> float32 (n_images, n_dimensions) is left to write.

    A place scores the inner product with its most similar image. `index` chooses how they are found; approximate ones
    retrieve `neighbours` images, or `rerank` ones whose inner products are then computed exactly, and a place without
    any of these scores -inf; `sq8` without `rerank` scores all. `probes` lists are looked at, see `Search`.
    """

    query_arguments: ClassVar[frozenset[str]] = frozenset({"index", "neighbours", "rerank", "probes"})
    #: Arguments that do not change descriptors: cached descriptors stay valid whatever the values of these arguments.
    search_arguments: ClassVar[frozenset[str]] = frozenset({"index", "neighbours", "rerank", "probes", "adapt"})

    adapts: ClassVar[bool] = True
    adapt: Adapt = "none"
    index: Kind = "exact"
    neighbours: int = 100
    rerank: int = 0
    probes: int = 0

    #: The indexed references; None before `fit`, and None in a subclass that matches in its own way.
    searched: Search | None = field(default=None, init=False, repr=False, compare=False)
    reference_mean: npt.NDArray[np.float32] | None = field(default=None, init=False, repr=False, compare=False)
    _grown: tuple[Growing, Growing] | None = field(default=None, init=False, repr=False, compare=False)

    def fit(self, references: Images, places: Places) -> Self:
        """Encode the references block by block and learn the map from the descriptors.

        More than 1 GiB lie in a file in the folder VPRBENCH_SCRATCH, or in the user's cache, until nobody holds them.
        """
        self.searched = None
        self.require_index(len(references))
        descriptors = np.empty((0, 0), np.float32)
        done = 0
        for block in encoded_blocks(references):
            codes = require_codes(self.encode(block), len(block))
            if not done:
                if 4 * len(references) * codes.shape[1] > LARGE_BYTES:
                    return self.fit_encoded(self._encode_into_scratch(references), places)
                descriptors = np.empty((len(references), codes.shape[1]), np.float32)
            descriptors[done : done + len(block)] = codes
            done += len(block)
            del block, codes  # or they would be held while the next ones are made
        return self.fit_encoded(descriptors, places)

    def fit_encoded(self, descriptors: Descriptors, places: Places) -> Self:
        """Learn the map from what `encode` gave of the references, (n_references, n_dimensions), centred under `adapt`.

        Raises BadInput as `fit_descriptors` does.
        """
        self.reference_mean = None
        if self.adapt == "none":
            return self.fit_descriptors(descriptors, places)
        blocks = [slice(first, first + _MEAN_ROWS) for first in range(0, len(descriptors), _MEAN_ROWS)]
        total = sum(descriptors[rows].sum(0, dtype=np.float64) for rows in blocks)
        self.reference_mean = mean = np.asarray(total / len(descriptors), np.float32)
        if descriptors.nbytes <= LARGE_BYTES:
            return self.fit_descriptors(self.centre(descriptors, mean), places)

        centred = (self.centre(descriptors[rows], mean) for rows in blocks)
        return self.fit_descriptors(_put_into_scratch(len(descriptors), centred), places)

    def centre(self, codes: npt.NDArray[np.float32], mean: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        """Return descriptors (..., n_dimensions) without a mean, of unit length; zero where they are the mean."""
        centred = codes - mean
        return np.asarray(centred / np.maximum(np.linalg.norm(centred, axis=-1, keepdims=True), 1e-12), np.float32)

    def fit_descriptors(self, descriptors: Descriptors, places: Places) -> Self:
        """Learn the map from the codes of the references, (n_references, n_dimensions), and forget any earlier map.

        They are not copied; more than 1 GiB are memory-mapped. Raises BadInput if `index` cannot be made of them.
        """
        self.searched = self._grown = None
        self.searched = Search(descriptors, places.copy(), self.index, self.neighbours, self.rerank, self.probes)
        return self

    @property
    def extends(self) -> bool:
        """Whether new vectors are appended: to exact search, of descriptors as they are encoded."""
        return self.index == "exact" and type(self).fit_descriptors is DescriptorMethod.fit_descriptors

    def extend(self, references: Images, places: Places) -> Self:
        """Encode the references of new places and append their vectors."""
        known = self._require_index()
        if not self.extends:
            return super().extend(references, places)
        require_new_places(places, len(references), int(known.places.max()) + 1)
        vectors, numbers = self._grown = self._grown or (Growing(known.references), Growing(known.places))
        blocks = encoded_blocks(references)
        codes = np.concatenate([require_codes(self.encode(block), len(block)) for block in blocks])
        vectors.append(codes if self.reference_mean is None else self.centre(codes, self.reference_mean))
        numbers.append(places)
        self.searched = Search(vectors.rows, numbers.rows)
        return self

    def _encode_into_scratch(self, references: Images) -> Descriptors:
        total = len(references)
        report = partial(progress.report, "fit, reading images")
        return _put_into_scratch(total, encode_stretches(references, self.encode, lambda done: report(done / total)))

    def require_index(self, n_references: int) -> None:
        """Raise BadInput if `index` cannot be made of so many references, before they are encoded."""
        check_index(self.index, self.neighbours, n_references, self.rerank, self.probes)

    def match(self, codes: npt.NDArray[np.float32]) -> Scores:
        """Return the inner product with the best reference image of each place; -inf if none was retrieved."""
        return self._require_index().scores(codes)

    def nearest(self, codes: npt.NDArray[np.float32], n: int) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.int64]]:
        """Return the scores of the best `n` places of each code, best first, and these places, as `Search.nearest`.

        So queries of a large map are answered. A subclass that overrides `match` overrides this as well, or all places
        are scored.
        """
        return self._require_index().nearest(codes, n)

    def keeps_descriptors(self) -> bool:
        """Tell whether descriptors of whole traverses are worth keeping on disk; False if `fit` changes descriptors."""
        return False

    def audit(self, codes: npt.NDArray[np.float32]) -> Audit:
        """Return the share of the places found by exact search for `codes` that the index finds too.

        Of places that are exactly as good as one another each counts as found.
        """
        index = self._require_index()
        exact = Search(index.references, index.places)
        blocks = [*index.split_codes(codes)]
        shares = [compare_best(self._match_by(index, block), self._match_by(exact, block)) for block in blocks]
        return Audit(*np.concatenate(shares).mean(0).tolist())

    def _match_by(self, index: Search, codes: npt.NDArray[np.float32]) -> Scores:
        """Call `match`, as a subclass may override it, with another index."""
        kept, self.searched = self.searched, index
        try:
            return self.match(codes)
        finally:
            self.searched = kept

    def _require_index(self) -> Search:
        if self.searched is None:
            raise NotFittedError(f"{type(self).__name__} has no map yet: call fit(references, places) first")
        return self.searched


def _put_into_scratch(n_rows: int, blocks: Iterable[npt.NDArray[np.float32]]) -> Descriptors:
    """Return rows in a file, which is removed when nobody holds the rows any more."""
    scratch = cache_folder(_FOLDER, "scratch")
    remove_leftovers(scratch)
    folder = name_unfinished(scratch)
    try:
        rows, _ = keep_rows(folder / "descriptors.npy", n_rows, lambda first: blocks, "descriptors")
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    weakref.finalize(rows if rows.base is None else rows.base, shutil.rmtree, folder, ignore_errors=True)
    return rows


def encode_stretches(
    images: Images, encode: Callable[[Images], npt.NDArray[np.float32]], done: Callable[[int], None], first: int = 0
) -> Iterator[npt.NDArray[np.float32]]:
    """Yield descriptors of consecutive images from the `first` on, (n, n_dimensions).

    Each stretch of 1024 images is encoded on its own, so whoever goes on after a stretch gets the same bits. `done` is
    called with the number of images encoded so far.
    """
    for start in range(first, len(images), STRETCH):
        n_encoded = start - first
        for block in encoded_blocks(images[start : start + STRETCH]):
            yield require_codes(encode(block), len(block))
            n_encoded += len(block)
            done(n_encoded)


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
