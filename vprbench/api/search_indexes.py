"""The indexes behind a search: how each keeps the references, and how it compares or retrieves them."""

from __future__ import annotations

import logging
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from vprbench.api.nearest import CELLS, Numbers, Vectors, inner_products, parts, rows_together

Kind = Literal["exact", "sq8", "hnsw", "ivfpq", "rabitq", "binary", "binary_hnsw"]
_SAMPLED = 1 << 27  # numbers that an index learns from, at most
_ADDED = 1 << 28  # to a graph at once, from which larger maps come in parts

_LINKS = 32  # of an image to others, hnsw; twice as many on the lowest layer
_CANDIDATES = 64  # that hnsw follows at a query, at least

_LISTS_LOOKED_AT = 4  # one in so many, ivfpq
BITS = 8  # of a code of ivfpq: one of 256 centroids
_SHORTEST_PART, _MOST_PARTS = 4, 512  # of a vector, each with a code of its own
TRAINED_PER_CENTROID = 39  # images: what faiss asks for at least
_PQ_ITERATIONS = 10


def faiss_module() -> Any:
    """Import faiss, quietly, and return it; it is slow to import, so only an index that needs faiss imports it.

    Imported after threads were pinned it uses as many: it takes their number from OMP_NUM_THREADS.
    """
    logging.getLogger("faiss.loader").setLevel(logging.WARNING)  # it would tell of every instruction set that it tries
    import faiss

    return faiss


class Flat(ABC):
    """An index that compares all images."""

    n_bytes: int

    @abstractmethod
    def similarity(self, codes: Vectors, first: int, last: int) -> Vectors:
        """Return the inner products with images `first` to `last`, (n_queries, last - first)."""


class Exact(Flat):
    """The vectors themselves."""

    def __init__(self, references: Vectors) -> None:
        self._references = references
        self.n_bytes = references.nbytes

    def similarity(self, codes: Vectors, first: int, last: int) -> Vectors:
        """Return the inner products with images `first` to `last`, (n_queries, last - first)."""
        return inner_products(self._references[first:last], codes)


class EightBits(Flat):
    """Faiss's scalar quantiser: each dimension in 256 even steps between its extremes.

    A number is lowest + (code + 1/2) * step, so codes are compared with step * query as they are, made floats block by
    block. All images are scored, for all have to be looked at: faiss, which would return the best, takes twice as long
    for many queries at once.
    """

    def __init__(self, references: Vectors) -> None:
        faiss = faiss_module()
        n_images, n_dimensions = references.shape
        quantiser = faiss.ScalarQuantizer(n_dimensions, faiss.ScalarQuantizer.QT_8bit)
        blocks = [*parts(n_images, rows_together(references))]
        quantiser.train(
            np.stack(
                [
                    np.min([references[rows].min(0) for rows in blocks], axis=0),
                    np.max([references[rows].max(0) for rows in blocks], axis=0),
                ]
            )
        )
        self._codes = np.empty((n_images, n_dimensions), np.uint8)
        for rows in blocks:
            self._codes[rows] = quantiser.compute_codes(references[rows])
        lowest, extent = faiss.vector_to_array(quantiser.trained).reshape(2, n_dimensions)
        self._step: npt.NDArray[np.float32] = extent / np.float32(255)
        self._middle: npt.NDArray[np.float32] = lowest + self._step / 2  # of the lowest step
        self.n_bytes = self._codes.nbytes + self._step.nbytes + self._middle.nbytes

    def similarity(self, codes: Vectors, first: int, last: int) -> Vectors:
        """Return the inner products with images `first` to `last`, (n_queries, last - first)."""
        similarity = np.empty((len(codes), last - first), np.float32)
        stepped = codes * self._step
        together = min(last - first, max(1, CELLS // codes.shape[1]))
        floats = np.empty((together, codes.shape[1]), np.float32)
        for images in parts(last - first, together):
            numbers = self._codes[first + images.start : first + images.stop]
            floats[: len(numbers)] = numbers
            similarity[:, images] = stepped @ floats[: len(numbers)].T
        similarity += (codes @ self._middle)[:, None]
        return similarity


class Retrieving(ABC):
    """A faiss index that looks for the most similar images among a part of them."""

    n_bytes: int
    _index: Any

    def retrieve(self, codes: Vectors, n: int) -> tuple[Vectors, Numbers]:
        """Return similarities and images, (n_queries, n) each, best first; the image is -1 if there is none."""
        similarity, images = self._index.search(self._prepared(codes), n)
        return similarity, images

    def _prepared(self, vectors: Vectors) -> Vectors:
        return vectors


class Graph(Retrieving):
    """A graph of near images, climbed from layer to layer (Malkov and Yashunin 2018); it holds the vectors."""

    def __init__(self, references: Vectors) -> None:
        faiss = faiss_module()
        n_images, n_dimensions = references.shape
        self._index = faiss.IndexHNSWFlat(n_dimensions, _LINKS, faiss.METRIC_INNER_PRODUCT)
        self._index.hnsw.efSearch = _CANDIDATES  # faiss takes more where more neighbours are asked for
        with one_thread(faiss):
            for images in parts(n_images, max(1, _ADDED // n_dimensions)):
                self._index.add(references[images])
        self.n_bytes = 4 * n_images * n_dimensions + bytes_of_links(self._index.hnsw)


class ProductCodes(Retrieving):
    """Inverted lists of product codes (Jégou et al. 2011): a list for each of about sqrt(n) centroids.

    A vector is cut into parts of 4 numbers, or more if that would make more than 512 parts; zeros fill up the last.
    A part is stored as the number of one of 256 centroids. A query looks at a quarter of the lists.
    """

    def __init__(self, references: Vectors, probes: int = 0) -> None:
        faiss = faiss_module()
        n_images, n_dimensions = references.shape
        n_centroids = 1 << BITS
        self._part = max(_SHORTEST_PART, -(-n_dimensions // _MOST_PARTS))
        n_parts = -(-n_dimensions // self._part)
        n_lists = round(n_images**0.5)
        self._index = faiss.IndexIVFPQ(
            faiss.IndexFlatIP(n_parts * self._part),
            n_parts * self._part,
            n_lists,
            n_parts,
            BITS,
            faiss.METRIC_INNER_PRODUCT,
        )
        self._index.nprobe = min(probes or -(-n_lists // _LISTS_LOOKED_AT), n_lists)
        for clustering in (self._index.cp, self._index.pq.cp):
            clustering.min_points_per_centroid = 1  # faiss would print that there are few
        self._index.pq.cp.niter = _PQ_ITERATIONS
        self._index.train(self._prepared(sample(references, TRAINED_PER_CENTROID * max(n_lists, n_centroids))))
        for images in parts(n_images, max(1, CELLS // n_dimensions)):
            self._index.add(self._prepared(references[images]))
        tables = 4 * n_parts * self._part * (n_lists + n_centroids)
        self.n_bytes = n_images * (self._index.code_size + 8) + tables  # 8: the number of an image

    def _prepared(self, vectors: Vectors) -> Vectors:
        missing = -vectors.shape[1] % self._part
        return np.pad(vectors, ((0, 0), (0, missing))) if missing else np.ascontiguousarray(vectors)


def sample(references: Vectors, wanted: int) -> Vectors:
    """Return up to `wanted` of the references, drawn without replacement, in their order: 512 MiB at most."""
    n_images, n_dimensions = references.shape
    drawn = np.random.default_rng(0).permutation(n_images)[: max(1, min(wanted, _SAMPLED // n_dimensions))]
    return references[np.sort(drawn)]


def bytes_of_links(hnsw: Any) -> int:
    """Return the memory of a graph beside its vectors."""
    return int(4 * hnsw.neighbors.size() + 8 * hnsw.offsets.size() + 4 * hnsw.levels.size())


@contextmanager
def one_thread(faiss: Any) -> Iterator[None]:
    """Let faiss use one thread: of several, the fastest would decide what a graph links."""
    before = faiss.omp_get_max_threads()
    faiss.omp_set_num_threads(1)
    try:
        yield
    finally:
        faiss.omp_set_num_threads(before)
