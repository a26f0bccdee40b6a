"""How codes are compared, and the places nearest to one in a map of any size: of each block the best are kept."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt

Vectors = npt.NDArray[np.float32]  # (n_images, n_dimensions)
Codes = npt.NDArray[Any]  # (n_queries, ...)
Numbers = npt.NDArray[np.int64]
Words = npt.NDArray[np.uint64]  # (n_images, n_words): bits packed, in any order that all share

CELLS = 1 << 24  # numbers of an intermediate result: 64 MiB
ROUNDING = 1e-6  # of inner products of unit vectors
_FIRST = 1 << 14  # images of a block that bound what the others have to exceed
_FEW_QUERIES = 3  # that are faster compared one by one: a product of matrices first rearranges the references


@cache
def import_faiss() -> Any:
    """Import faiss, quietly, and return it; it is slow to import, so only an index that needs faiss imports it.

    Imported after threads were pinned it uses as many: it takes their number from OMP_NUM_THREADS.
    """
    logging.getLogger("faiss.loader").setLevel(logging.WARNING)  # it would log every instruction set that it tries
    import faiss

    return faiss


def pack_bits(bits: npt.NDArray[Any]) -> Words:
    """Return truth values (n_images, n_bits) as words of 64 bits, (n_images, n_words), zeros at the end."""
    missing = -bits.shape[1] % 64
    return np.packbits(np.pad(bits.astype(bool), ((0, 0), (0, missing))), axis=1).view(np.uint64)


def compare_bits(codes: Words, references: Words) -> Vectors:
    """Return minus the bits in which codes (n_queries, n_words) and references differ, (n_queries, n_references)."""
    faiss = import_faiss()
    differing = np.empty((len(codes), len(references)), np.int32)
    if differing.size:
        ours, theirs = (np.ascontiguousarray(words).view(np.uint8) for words in (codes, references))
        pointers = faiss.swig_ptr(ours), faiss.swig_ptr(theirs)
        faiss.hammings(*pointers, *differing.shape, ours.shape[1], faiss.swig_ptr(differing))
    return -differing.astype(np.float32)


@dataclass(frozen=True)
class Compared:
    """All images of a map, and how codes are compared with them."""

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


def count_rows_together(vectors: Vectors) -> int:
    """Return how many vectors are compared at once: up to 64 MiB."""
    return max(1, CELLS // int(vectors.shape[1]))


def compute_inner_products(rows: Vectors, codes: Vectors) -> Vectors:
    """Return the inner products of codes with vectors, (n_queries, n_rows).

    numpy's product is the fastest on two cores, for one query and for many: beside it were measured PyTorch's product
    and faiss.IndexFlatIP.
    """
    if 0 < len(codes) <= _FEW_QUERIES:
        return np.stack([rows @ code for code in codes])
    return codes @ rows.T


def find_nearest(codes: Codes, n: int, images: Compared) -> Nearest:
    """Return the `n` best places for each of the codes."""
    best = Nearest(np.full((len(codes), n), -np.inf, np.float32), np.full((len(codes), n), -1, np.int64))
    for block in cut_into_parts(images.n_images, images.together):
        for queries in cut_into_parts(len(codes), max(1, CELLS // (block.stop - block.start))):
            known = Nearest(best.similarity[queries], best.places[queries])
            found = _add_candidates(known, *_find_candidates(codes[queries], known, images, block))
            best.similarity[queries], best.places[queries] = found.similarity, found.places
    return best


def choose_nearest(queries: Numbers, similarity: Vectors, places: Numbers, n_queries: int, n: int) -> Nearest:
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


def cut_into_parts(n: int, size: int) -> Iterator[slice]:
    """Yield the slices that cut `n` into parts of `size`, the last one shorter."""
    for first in range(0, n, size):
        yield slice(first, min(first + size, n))


def _find_candidates(codes: Codes, known: Nearest, images: Compared, block: slice) -> tuple[Numbers, Vectors, Numbers]:
    """Return candidates of a block that may enter the current best n: query, similarity and place of each."""
    scores = images.similarity(codes, block.start, block.stop)
    places = None if images.places is None else images.places[block]
    floor = known.similarity[:, -1]
    if np.isneginf(floor).any():
        floor = np.maximum(floor, _nth_best(scores, places, known.places.shape[1]))
    rows, columns = np.divmod(np.flatnonzero(scores >= floor[:, None] - np.float32(ROUNDING)), scores.shape[1])
    shown = block.start + columns
    exact = scores[rows, columns] if images.exactly is None else images.exactly(codes, rows, shown)
    return rows, exact, shown if images.places is None else images.places[shown]


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


def _add_candidates(known: Nearest, rows: Numbers, similarity: Vectors, places: Numbers) -> Nearest:
    """Return the best of the known places of each query and of candidates: query, similarity and place of each."""
    own, columns = np.nonzero(known.places >= 0)
    return choose_nearest(
        np.concatenate([own, rows]),
        np.concatenate([known.similarity[own, columns], similarity]),
        np.concatenate([known.places[own, columns], places]),
        *known.places.shape,
    )
