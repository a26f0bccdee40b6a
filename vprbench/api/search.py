"""Nearest-neighbour search of unit descriptors: exact, or by an index that is smaller or faster and may be wrong."""

from __future__ import annotations

import logging
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
import numpy.typing as npt

Kind = Literal["exact", "hnsw", "ivfpq", "sq8"]
Vectors = npt.NDArray[np.float32]  # (n_images, n_dimensions)
ImageNumbers = npt.NDArray[np.int64]

_FEW_QUERIES = 3  # that are faster compared one by one: a product of matrices first rearranges the references
_CELLS = 1 << 24  # numbers of an intermediate result: 64 MiB
_TOGETHER = 1 << 16  # reference images, where several show a place

_ROUNDING = 1e-6  # of inner products of unit vectors

_LINKS = 32  # of an image to others, hnsw; twice as many on the lowest layer
_CANDIDATES = 64  # that hnsw follows at a query, at least

_LISTS_LOOKED_AT = 4  # one in so many, ivfpq
_BITS = 8  # of a code of ivfpq: one of 256 centroids
_SHORTEST_PART, _MOST_PARTS = 4, 512  # of a vector, each with a code of its own
_TRAINED_PER_CENTROID = 39  # images: what faiss asks for at least
_PQ_ITERATIONS = 10


@dataclass(frozen=True)
class Audit:
    """How much of what exact search finds an index finds too; shares, 0 to 1, mean over the queries."""

    recall_at_1: float  # of the exactly best place
    recall_at_10: float  # of the 10 best places


class Search:
    """Scores places by the inner product with the most similar of their images.

    `exact` compares every reference. `sq8` does so too, but in 8 bits a number: a quarter of the memory. `hnsw` (a
    graph) and `ivfpq` (inverted lists of codes of a few bytes) retrieve the `neighbours` most similar images or nearly
    those; a place without any of them scores -inf: no candidate. The same references give the same index.
    """

    def __init__(
        self, references: Vectors, places: npt.NDArray[np.int64], kind: Kind = "exact", neighbours: int = 100
    ) -> None:
        """Index `references`, which stay where they are (they may be memory-mapped), with the place of each.

        An approximate index answers without them; they are kept to be compared with. Raises ValueError for an unknown
        kind, for fewer than one neighbour and for too few references.
        """
        check_index(kind, neighbours, len(references))
        if references.ndim != 2 or not len(references) or places.shape != (len(references),):
            raise ValueError(
                f"references {references.shape} came with places {places.shape}: wanted (n_images, n_dimensions) of an "
                "image or more, and a place for each"
            )
        self.references: Vectors = np.ascontiguousarray(references, np.float32)
        self.places = places
        self.kind = kind
        self._n_places = int(places.max()) + 1
        self._neighbours = min(neighbours, len(references))
        self._index: _Flat | _Retrieving = _INDEXES[kind](self.references)
        one_each = np.array_equal(places, np.arange(len(places)))
        self._blocks = None if one_each else [*_blocks_of_places(places)]

    @property
    def bytes_per_place(self) -> int:
        """The memory that answers need, for each place."""
        return round(self._index.n_bytes / self._n_places)

    def scores(self, codes: Vectors) -> Vectors:
        """Return for each place the best inner product, (n_queries, n_places), with `codes` (n_queries, n_dimensions).

        Beside the result, memory is bounded: about 200 MB. Raises ValueError for codes of another length.
        """
        codes = self._checked(codes)
        if isinstance(self._index, _Retrieving):
            return self._best_of_retrieved(codes, self._index)
        if self._blocks is None:
            return self._index.similarity(codes, 0, len(self.references))
        scores = np.full((len(codes), self._n_places), -np.inf, np.float32)
        for queries in _parts(len(codes), _CELLS // _TOGETHER):
            for block in self._blocks:
                similarity = self._index.similarity(codes[queries], block.first, block.last)
                best = np.maximum.reduceat(similarity[:, block.order], block.starts, axis=1)
                scores[queries, block.places] = np.maximum(scores[queries, block.places], best)
        return scores

    def exactly(self) -> Search:
        """Return exact search of the same references."""
        return Search(self.references, self.places)

    def blocks(self, codes: Vectors) -> Iterator[Vectors]:
        """Yield `codes` in parts whose scores take up to 64 MiB."""
        for queries in _parts(len(codes), max(1, _CELLS // self._n_places)):
            yield codes[queries]

    def _best_of_retrieved(self, codes: Vectors, index: _Retrieving) -> Vectors:
        scores = np.full((len(codes), self._n_places), -np.inf, np.float32)
        similarity, images = index.retrieve(codes, self._neighbours)
        rows, columns = np.nonzero(images >= 0)
        np.maximum.at(scores, (rows, self.places[images[rows, columns]]), similarity[rows, columns])
        return scores

    def _checked(self, codes: Vectors) -> Vectors:
        n_dimensions = self.references.shape[1]
        if codes.ndim != 2 or codes.shape[1] != n_dimensions:
            raise ValueError(f"codes {codes.shape} came; this map compares (n_queries, {n_dimensions})")
        return np.ascontiguousarray(codes, np.float32)


def check_index(kind: str, neighbours: int, n_images: int) -> None:
    """Raise ValueError for what no index can be made of: an unknown kind, no neighbour, too few images."""
    if kind not in get_args(Kind):
        raise ValueError(f"{kind} is unknown: give {', '.join(get_args(Kind))}")
    if neighbours < 1:
        raise ValueError(f"{neighbours} neighbours: give at least 1")
    if kind == "ivfpq" and n_images < 1 << _BITS:
        raise ValueError(
            f"ivfpq needs at least {1 << _BITS} reference images, {n_images} came: take exact, hnsw or sq8"
        )


def agreement(scores: Vectors, exact: Vectors) -> npt.NDArray[np.float64]:
    """Return how many of the best 1 and 10 places by `exact` are so by `scores`, as shares: (n_queries, 2).

    Both are (n_queries, n_places). Of places that are exactly as good as one another each counts as found.
    """
    n_places = exact.shape[1]
    shares = []
    for n in (1, min(10, n_places)):
        best = np.argpartition(scores, n_places - n, axis=1)[:, n_places - n :]
        own = np.where(
            np.take_along_axis(scores, best, axis=1) > -np.inf, np.take_along_axis(exact, best, axis=1), -np.inf
        )
        least = np.partition(exact, n_places - n, axis=1)[:, n_places - n, None]
        shares.append((own >= least - _ROUNDING).mean(1))
    return np.stack(shares, axis=1)


def faiss_module() -> Any:
    """Import faiss, quietly, and return it; it is slow to import, so only what needs it asks for it.

    Imported after threads were pinned it uses as many: it takes their number from OMP_NUM_THREADS.
    """
    logging.getLogger("faiss.loader").setLevel(logging.WARNING)  # it would tell of every instruction set that it tries
    import faiss

    return faiss


class _Flat(ABC):
    """An index that compares all images."""

    n_bytes: int

    @abstractmethod
    def similarity(self, codes: Vectors, first: int, last: int) -> Vectors:
        """Return the inner products with images `first` to `last`, (n_queries, last - first)."""


class _Exact(_Flat):
    """The vectors themselves; numpy's product is the fastest on two cores, for one query and for many.

    Beside it were measured PyTorch's product and faiss.IndexFlatIP.
    """

    def __init__(self, references: Vectors) -> None:
        self._references = references
        self.n_bytes = references.nbytes

    def similarity(self, codes: Vectors, first: int, last: int) -> Vectors:
        references = self._references[first:last]
        if 0 < len(codes) <= _FEW_QUERIES:
            return np.stack([references @ code for code in codes])
        return codes @ references.T


class _EightBits(_Flat):
    """Faiss's scalar quantiser: each dimension in 256 even steps between its extremes.

    A number is lowest + (code + 1/2) * step, so codes are compared with step * query as they are, made floats block by
    block. All images are scored, for all have to be looked at: faiss, which would return the best, takes twice as long
    for many queries at once.
    """

    def __init__(self, references: Vectors) -> None:
        faiss = faiss_module()
        n_dimensions = references.shape[1]
        quantiser = faiss.ScalarQuantizer(n_dimensions, faiss.ScalarQuantizer.QT_8bit)
        quantiser.train(references)
        self._codes: npt.NDArray[np.uint8] = quantiser.compute_codes(references)
        lowest, extent = faiss.vector_to_array(quantiser.trained).reshape(2, n_dimensions)
        self._step: npt.NDArray[np.float32] = extent / np.float32(255)
        self._middle: npt.NDArray[np.float32] = lowest + self._step / 2  # of the lowest step
        self.n_bytes = self._codes.nbytes + self._step.nbytes + self._middle.nbytes

    def similarity(self, codes: Vectors, first: int, last: int) -> Vectors:
        similarity = np.empty((len(codes), last - first), np.float32)
        stepped = codes * self._step
        together = min(last - first, max(1, _CELLS // codes.shape[1]))
        floats = np.empty((together, codes.shape[1]), np.float32)
        for images in _parts(last - first, together):
            numbers = self._codes[first + images.start : first + images.stop]
            floats[: len(numbers)] = numbers
            similarity[:, images] = stepped @ floats[: len(numbers)].T
        similarity += (codes @ self._middle)[:, None]
        return similarity


class _Retrieving(ABC):
    """A faiss index that looks for the most similar images among a part of them."""

    n_bytes: int
    _index: Any

    def retrieve(self, codes: Vectors, n: int) -> tuple[Vectors, ImageNumbers]:
        """Return similarities and images, (n_queries, n) each, best first; the image is -1 where there is none."""
        similarity, images = self._index.search(self._prepared(codes), n)
        return similarity, images

    def _prepared(self, vectors: Vectors) -> Vectors:
        return vectors


class _Graph(_Retrieving):
    """A graph of near images, climbed from layer to layer (Malkov and Yashunin 2018); it holds the vectors."""

    def __init__(self, references: Vectors) -> None:
        faiss = faiss_module()
        n_images, n_dimensions = references.shape
        self._index = faiss.IndexHNSWFlat(n_dimensions, _LINKS, faiss.METRIC_INNER_PRODUCT)
        self._index.hnsw.efSearch = _CANDIDATES  # faiss takes more where more neighbours are asked for
        with _one_thread(faiss):  # of several, the fastest would decide what is linked
            self._index.add(references)
        hnsw = self._index.hnsw
        links = 4 * hnsw.neighbors.size() + 8 * hnsw.offsets.size() + 4 * hnsw.levels.size()
        self.n_bytes = 4 * n_images * n_dimensions + links


class _ProductCodes(_Retrieving):
    """Inverted lists of product codes (Jégou et al. 2011): a list for each of about sqrt(n) centroids.

    A vector is cut into parts of 4 numbers, or more where that were more than 512 parts; zeros fill up the last.
    A part is stored as the number of one of 256 centroids. A query looks at a quarter of the lists.
    """

    def __init__(self, references: Vectors) -> None:
        faiss = faiss_module()
        n_images, n_dimensions = references.shape
        n_centroids = 1 << _BITS
        self._part = max(_SHORTEST_PART, -(-n_dimensions // _MOST_PARTS))
        n_parts = -(-n_dimensions // self._part)
        n_lists = round(n_images**0.5)
        self._index = faiss.IndexIVFPQ(
            faiss.IndexFlatIP(n_parts * self._part),
            n_parts * self._part,
            n_lists,
            n_parts,
            _BITS,
            faiss.METRIC_INNER_PRODUCT,
        )
        self._index.nprobe = -(-n_lists // _LISTS_LOOKED_AT)
        for clustering in (self._index.cp, self._index.pq.cp):
            clustering.min_points_per_centroid = 1  # faiss would print that there are few
        self._index.pq.cp.niter = _PQ_ITERATIONS
        wanted = _TRAINED_PER_CENTROID * max(n_lists, n_centroids)
        chosen = np.sort(np.random.default_rng(0).permutation(n_images)[:wanted])
        self._index.train(self._prepared(references[chosen]))
        for images in _parts(n_images, max(1, _CELLS // n_dimensions)):
            self._index.add(self._prepared(references[images]))
        tables = 4 * n_parts * self._part * (n_lists + n_centroids)
        self.n_bytes = n_images * (self._index.code_size + 8) + tables  # 8: the number of an image

    def _prepared(self, vectors: Vectors) -> Vectors:
        missing = -vectors.shape[1] % self._part
        return np.pad(vectors, ((0, 0), (0, missing))) if missing else np.ascontiguousarray(vectors)


_INDEXES: dict[Kind, type[_Exact | _EightBits | _Graph | _ProductCodes]] = {
    "exact": _Exact,
    "hnsw": _Graph,
    "ivfpq": _ProductCodes,
    "sq8": _EightBits,
}


@dataclass(frozen=True)
class _Block:
    """Consecutive images, and which of them show which place."""

    first: int
    last: int
    order: npt.NDArray[np.int64]  # the images by place
    starts: npt.NDArray[np.int64]  # where each place begins in that order
    places: npt.NDArray[np.int64]  # that they show


def _blocks_of_places(places: npt.NDArray[np.int64]) -> Iterator[_Block]:
    for images in _parts(len(places), _TOGETHER):
        order = np.argsort(places[images], kind="stable")
        shown, starts = np.unique(places[images][order], return_index=True)
        yield _Block(images.start, images.stop, order, starts, shown)


def _parts(n: int, size: int) -> Iterator[slice]:
    for first in range(0, n, size):
        yield slice(first, min(first + size, n))


@contextmanager
def _one_thread(faiss: Any) -> Iterator[None]:
    before = faiss.omp_get_max_threads()
    faiss.omp_set_num_threads(1)
    try:
        yield
    finally:
        faiss.omp_set_num_threads(before)
