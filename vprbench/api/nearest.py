"""The places nearest to a code in a map of any size: block by block, the best of each block merged with the others'."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from vprbench.storage.shards import Shards

if TYPE_CHECKING:
    from vprbench.api.rows import Rows

Vectors = npt.NDArray[np.float32]  # (n_images, n_dimensions)
Codes = npt.NDArray[Any]  # (n_queries, ...)
Numbers = npt.NDArray[np.int64]

CELLS = 1 << 24  # numbers of an intermediate result: 64 MiB
ROUNDING = 1e-6  # of inner products of unit vectors
_CELLS_OF_A_PART = 1 << 28
_FIRST = 1 << 14  # images of a block that bound what the others have to exceed
_FEW_QUERIES = 3  # that are faster compared one by one: a product of matrices first rearranges the references


@dataclass(frozen=True)
class Part:
    """Consecutive images of a map, searched together."""

    first: int  # the number of its first image
    n_images: int
    together: int  # images compared at once
    places: Numbers | None  # of each image; None: a place each, of its number
    similarity: Callable[[Codes, int, int], Vectors]  # of codes with images from one number to another
    exactly: Callable[[Codes, Numbers, Numbers], Vectors] | None  # of pairs of a query and an image


@dataclass(frozen=True)
class Nearest:
    """The best places of each query, best first; of equals the lower place comes first."""

    similarity: Vectors  # (n_queries, n), -inf where there is none
    places: Numbers  # (n_queries, n), -1 where there is none


def parts_of_map(vectors: Shards, places: Numbers | None) -> Iterator[Part]:
    """Yield the parts that a map is searched in exactly."""
    from vprbench.api.rows import Rows  # here, for it needs PyTorch

    shared = Rows(vectors)
    for own in parts(len(vectors), vectors.each * max(1, _CELLS_OF_A_PART // (vectors.each * vectors.shape[1]))):
        held, rows, start = vectors, shared, own.start
        if vectors.array is not None:
            held, start = Shards.of(vectors.array[own]), 0
            rows = Rows(held)
        yield Part(
            own.start,
            own.stop - own.start,
            rows_together(vectors),
            None if places is None else places[own],
            partial(inner_products, held, start),
            partial(products, rows, start),
        )


def rows_together(vectors: Shards) -> int:
    """Return how many vectors are compared at once without a copy: up to 64 MiB in memory, else those of a shard."""
    return vectors.each if vectors.array is None else max(1, CELLS // vectors.shape[1])


def inner_products(vectors: Shards, start: int, codes: Vectors, first: int, last: int) -> Vectors:
    """Return the inner products of codes with the vectors start + first to start + last, (n_queries, last - first).

    numpy's product is the fastest on two cores, for one query and for many: beside it were measured PyTorch's product
    and faiss.IndexFlatIP.
    """
    rows = vectors[start + first : start + last]
    if 0 < len(codes) <= _FEW_QUERIES:
        return np.stack([rows @ code for code in codes])
    return codes @ rows.T


def products(rows: Rows, start: int, codes: Vectors, queries: Numbers, images: Numbers) -> Vectors:
    """Return the exact inner products of pairs of a query and vector start + image, (n_pairs,)."""
    return rows.products(codes, queries, start + images)


def best_of_part(codes: Codes, n: int, part: Part) -> Nearest:
    """Return the `n` best places of a part for each of the codes."""
    best = Nearest(np.full((len(codes), n), -np.inf, np.float32), np.full((len(codes), n), -1, np.int64))
    for block in parts(part.n_images, part.together):
        places = None if part.places is None else part.places[block]
        for queries in parts(len(codes), max(1, CELLS // (block.stop - block.start))):
            known = Nearest(best.similarity[queries], best.places[queries])
            asked, similarity, images = _promising(codes[queries], known, part, block, places)
            shown = part.first + block.start + images if places is None else places[images]
            found = _with(known, asked, similarity, shown)
            best.similarity[queries], best.places[queries] = found.similarity, found.places
    return best


def merged(left: Nearest, right: Nearest) -> Nearest:
    """Return the best places of two parts of a map."""
    rows, columns = np.nonzero(right.places >= 0)
    return _with(left, rows, right.similarity[rows, columns], right.places[rows, columns])


def best_places(queries: Numbers, similarity: Vectors, places: Numbers, n_queries: int, n: int) -> Nearest:
    """Return the `n` best places of each query; a place is worth the most similar of its images.

    What was found is a query's number, a similarity and a place each, in any order.
    """
    order = np.lexsort((-similarity, places, queries))
    queries, similarity, places = queries[order], similarity[order], places[order]
    new = np.append(True, (np.diff(places) != 0) | (np.diff(queries) != 0))[: len(queries)]  # the best of its place
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


def _promising(
    codes: Codes, known: Nearest, part: Part, block: slice, places: Numbers | None
) -> tuple[Numbers, Vectors, Numbers]:
    """Return query, similarity and image in its block of whatever may be better than what is known."""
    scores = part.similarity(codes, block.start, block.stop)
    n = known.places.shape[1]
    floor = known.similarity[:, -1]
    if np.isneginf(floor).any():
        floor = np.maximum(floor, _nth_best(scores, places, n))
    rows, images = np.divmod(np.flatnonzero(scores >= floor[:, None] - np.float32(ROUNDING)), scores.shape[1])
    if part.exactly is None:
        return rows, scores[rows, images], images
    return rows, part.exactly(codes, rows, block.start + images), images


def _nth_best(scores: Vectors, places: Numbers | None, n: int) -> Vectors:
    """Return the similarity of each query's n-th best place of the first images, (n_queries,), or -inf: a bound."""
    scores = scores[:, :_FIRST]
    if places is not None:
        order = np.argsort(places[:_FIRST], kind="stable")
        starts = np.flatnonzero(np.diff(places[:_FIRST][order], prepend=-1))
        scores = np.maximum.reduceat(scores[:, order], starts, axis=1)
    if scores.shape[1] < n:
        return np.full(len(scores), -np.inf, np.float32)
    nth: Vectors = np.partition(scores, scores.shape[1] - n, axis=1)[:, scores.shape[1] - n]
    return nth


def _with(known: Nearest, rows: Numbers, similarity: Vectors, places: Numbers) -> Nearest:
    """Return the best of what is known of each query and what was found: query, similarity and place."""
    own, columns = np.nonzero(known.places >= 0)
    return best_places(
        np.concatenate([own, rows]),
        np.concatenate([known.similarity[own, columns], similarity]),
        np.concatenate([known.places[own, columns], places]),
        *known.places.shape,
    )
