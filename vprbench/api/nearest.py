"""The places nearest to a code in a map of any size: block by block, the best of each block merged with the others'."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Protocol

import numpy as np
import numpy.typing as npt

Vectors = npt.NDArray[np.float32]  # (n_images, n_dimensions)
Numbers = npt.NDArray[np.int64]

CELLS = 1 << 24  # numbers of an intermediate result: 64 MiB
ROUNDING = 1e-6  # of inner products of unit vectors
_BLOCKS_OF_A_PART = 16


class Stored(Protocol):
    """References that are read piece by piece, (n_images, n_dimensions)."""

    @property
    def shape(self) -> tuple[int, int]:
        """Images and dimensions."""

    def __len__(self) -> int: ...

    def __getitem__(self, images: slice, /) -> Vectors:
        """Return consecutive vectors."""

    def take(self, images: Numbers, /) -> Vectors:
        """Return the vectors of some images."""


@dataclass(frozen=True)
class Held:
    """References that lie in one array, which may be memory-mapped."""

    array: Vectors

    @property
    def shape(self) -> tuple[int, int]:
        """Images and dimensions."""
        n_images, n_dimensions = self.array.shape
        return n_images, n_dimensions

    def __len__(self) -> int:
        return len(self.array)

    def __getitem__(self, images: slice, /) -> Vectors:
        """Return consecutive vectors, which are not copied."""
        return self.array[images]

    def take(self, images: Numbers, /) -> Vectors:
        """Return the vectors of some images."""
        return self.array[images]


class Comparing(Protocol):
    """Compares codes with consecutive images."""

    def similarity(self, codes: Vectors, first: int, last: int) -> Vectors:
        """Return the inner products with images `first` to `last`, (n_queries, last - first)."""


@dataclass(frozen=True)
class Part:
    """Consecutive images of a map, searched by one worker: their borders depend on the map alone."""

    first: int
    last: int
    places: Numbers | None  # of each image; None: a place each, of its number


@dataclass(frozen=True)
class Nearest:
    """The best places of each query, best first; of equals the lower place comes first."""

    similarity: Vectors  # (n_queries, n), -inf where there is none
    places: Numbers  # (n_queries, n), -1 where there is none


def parts_of_map(n_images: int, n_dimensions: int, places: Numbers | None) -> list[Part]:
    """Return the parts that a map is searched in."""
    together = _BLOCKS_OF_A_PART * _rows_together(n_dimensions)
    return [Part(own.start, own.stop, None if places is None else places[own]) for own in parts(n_images, together)]


def best_of_part(compared: Comparing, references: Stored | None, codes: Vectors, n: int, part: Part) -> Nearest:
    """Return the `n` best places of a part for each of the codes, (n_queries, n_dimensions).

    With `references` similarities are those of `products`, which the same vectors have wherever they lie.
    """
    similarity = np.full((len(codes), n), -np.inf, np.float32)
    found = np.full((len(codes), n), -1, np.int64)
    for block in parts(part.last - part.first, _rows_together(codes.shape[1])):
        first, last = part.first + block.start, part.first + block.stop
        places = np.arange(first, last) if part.places is None else part.places[block]
        for queries in parts(len(codes), max(1, CELLS // (last - first))):
            asked = codes[queries]
            scores = compared.similarity(asked, first, last)
            floor = similarity[queries, -1]
            if np.isneginf(floor).any():
                floor = np.maximum(floor, _nth_best(scores, None if part.places is None else places, n))
            rows, images = np.divmod(np.flatnonzero(scores >= floor[:, None] - np.float32(ROUNDING)), last - first)
            values = scores[rows, images]
            if references is not None:
                values = products(references, asked, rows, first + images)
            best = best_places(*_with(similarity[queries], found[queries], rows, values, places[images]), len(asked), n)
            similarity[queries], found[queries] = best.similarity, best.places
    return Nearest(similarity, found)


def merged(left: Nearest, right: Nearest) -> Nearest:
    """Return the best places of two parts of a map."""
    rows, columns = np.nonzero(right.places >= 0)
    flat = rows, right.similarity[rows, columns], right.places[rows, columns]
    return best_places(*_with(left.similarity, left.places, *flat), *left.places.shape)


def products(references: Stored, codes: Vectors, queries: Numbers, images: Numbers) -> Vectors:
    """Return inner products of pairs of a query (ascending numbers) and an image: sums in float64, then rounded."""
    found = np.empty(len(images), np.float32)
    together = max(1, CELLS // codes.shape[1])
    for code, (first, last) in zip(
        codes, pairwise(np.searchsorted(queries, np.arange(len(codes) + 1)).tolist()), strict=True
    ):
        for pairs in parts(last - first, together):
            own = slice(first + pairs.start, first + pairs.stop)
            found[own] = references.take(images[own]).astype(np.float64) @ code.astype(np.float64)
    return found


def best_places(queries: Numbers, similarity: Vectors, places: Numbers, n_queries: int, n: int) -> Nearest:
    """Return the `n` best places of each query; a place is worth the most similar of its images.

    What was found is a query's number, a similarity and a place each, in any order.
    """
    order = np.lexsort((-similarity, places, queries))
    queries, similarity, places = queries[order], similarity[order], places[order]
    if len(queries):
        new = np.append(True, (np.diff(places) != 0) | (np.diff(queries) != 0))  # the best of its place
        queries, similarity, places = queries[new], similarity[new], places[new]
    order = np.lexsort((-similarity, queries))  # stable: of equals the lower place
    rank = np.arange(len(queries)) - np.searchsorted(queries, queries)
    kept = rank < n
    best = Nearest(np.full((n_queries, n), -np.inf, np.float32), np.full((n_queries, n), -1, np.int64))
    best.similarity[queries[kept], rank[kept]] = similarity[order][kept]
    best.places[queries[kept], rank[kept]] = places[order][kept]
    return best


def parts(n: int, size: int) -> Iterator[slice]:
    """Yield the slices that cut `n` into parts of `size`, the last one shorter."""
    for first in range(0, n, size):
        yield slice(first, min(first + size, n))


def _rows_together(n_dimensions: int) -> int:
    return max(1, CELLS // n_dimensions)


def _nth_best(scores: Vectors, places: Numbers | None, n: int) -> Vectors:
    """Return the similarity of each query's n-th best place, (n_queries,); -inf if there are fewer."""
    if places is not None:
        order = np.argsort(places, kind="stable")
        starts = np.flatnonzero(np.diff(places[order], prepend=-1))
        scores = np.maximum.reduceat(scores[:, order], starts, axis=1)
    if scores.shape[1] < n:
        return np.full(len(scores), -np.inf, np.float32)
    nth: Vectors = np.partition(scores, scores.shape[1] - n, axis=1)[:, scores.shape[1] - n]
    return nth


def _with(
    similarity: Vectors, places: Numbers, rows: Numbers, values: Vectors, found: Numbers
) -> tuple[Numbers, Vectors, Numbers]:
    """Return what was known and what was found as one list of query, similarity and place."""
    known, columns = np.nonzero(places >= 0)
    return (
        np.concatenate([known, rows]),
        np.concatenate([similarity[known, columns], values]),
        np.concatenate([places[known, columns], found]),
    )
