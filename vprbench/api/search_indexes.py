"""The indexes behind a search, faiss's own: how each keeps the references, and how it compares or retrieves them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from vprbench.api.nearest import (
    CELLS,
    Compared,
    Numbers,
    Vectors,
    Words,
    compare_bits,
    compute_inner_products,
    count_rows_together,
    cut_into_parts,
    find_nearest,
    import_faiss,
    pack_bits,
)

Kind = Literal["exact", "sq8", "hnsw", "ivfpq", "rabitq", "binary", "binary_hnsw"]

FEWEST_OF_CODES = 256  # images that ivfpq needs: a centroid each

_SAMPLED = 1 << 27  # numbers that an index learns from, at most
_SAMPLED_BITS = 1 << 24  # numbers that thresholds of bits are medians of
_ADDED = 1 << 28  # numbers added to a graph at once
_COMPARED_BITS = 1 << 17  # images whose bits are compared together
_CANDIDATES = 64  # that hnsw follows at a query, at least
_BIT_CANDIDATES = 128  # that binary_hnsw follows
_SHORTEST_PART, _MOST_PARTS = 4, 512  # of a vector, each with a product code of its own
_TRAINED_PER_CENTROID = 39  # images: what faiss asks for at least
_ROTATED = 2048  # dimensions, at most: more are even enough, and a rotation would take long


class Exact:
    """The vectors themselves; all of them are compared."""

    def __init__(self, references: Vectors) -> None:
        self._references = references
        self.n_bytes = references.nbytes

    def similarity(self, codes: Vectors, first: int, last: int) -> Vectors:
        """Return the inner products with images `first` to `last`, (n_queries, last - first)."""
        return compute_inner_products(self._references[first:last], codes)


class EightBits(Exact):
    """Faiss's scalar quantiser: each dimension in 256 even steps between its extremes; all images are compared.

    A number is lowest + (code + 1/2) * step, so codes are compared with step * query, made floats block by block. All
    images are scored: faiss's search, which returns the best, takes twice as long for many queries at once.
    """

    def __init__(self, references: Vectors) -> None:
        faiss = import_faiss()
        n_images, n_dimensions = references.shape
        blocks = [*cut_into_parts(n_images, count_rows_together(references))]
        extremes = [extreme(references[rows], 0) for rows in blocks for extreme in (np.min, np.max)]
        quantiser = faiss.ScalarQuantizer(n_dimensions, faiss.ScalarQuantizer.QT_8bit)
        quantiser.train(np.stack([np.min(extremes, 0), np.max(extremes, 0)]))
        self._codes = np.empty((n_images, n_dimensions), np.uint8)
        for rows in blocks:
            self._codes[rows] = quantiser.compute_codes(references[rows])
        lowest, extent = faiss.vector_to_array(quantiser.trained).reshape(2, n_dimensions)
        self._step: npt.NDArray[np.float32] = extent / np.float32(255)
        self._middle: npt.NDArray[np.float32] = lowest + self._step / 2  # of the lowest step
        self.n_bytes = (n_images + 8) * n_dimensions

    def similarity(self, codes: Vectors, first: int, last: int) -> Vectors:
        """Return the inner products with images `first` to `last`, (n_queries, last - first)."""
        found = np.empty((len(codes), last - first), np.float32)
        stepped, together = codes * self._step, max(1, CELLS // codes.shape[1])
        floats = np.empty((min(last - first, together), codes.shape[1]), np.float32)
        for images in cut_into_parts(last - first, together):
            numbers = self._codes[first + images.start : first + images.stop]
            floats[: len(numbers)] = numbers
            found[:, images] = stepped @ floats[: len(numbers)].T
        return found + (codes @ self._middle)[:, None]


class Retrieving:
    """An index of faiss that looks for the most similar images among a part of them."""

    def __init__(self, index: Any, n_bytes: int) -> None:
        self._index = index
        self.n_bytes = n_bytes

    def retrieve(self, codes: Vectors, n: int) -> tuple[Vectors, Numbers]:
        """Return similarities and images, (n_queries, n) each, best first; the image is -1 if there is none."""
        similarity, images = self._index.search(codes, n)
        return similarity, images


def build_graph(references: Vectors) -> Retrieving:
    """Return a graph of near images, climbed from layer to layer (Malkov and Yashunin 2018); it holds the vectors."""
    faiss = import_faiss()
    index = faiss.index_factory(references.shape[1], "HNSW32", faiss.METRIC_INNER_PRODUCT)
    index.hnsw.efSearch = _CANDIDATES  # faiss takes more where more neighbours are asked for
    with _use_one_thread(faiss):
        for images in cut_into_parts(len(references), max(1, _ADDED // references.shape[1])):
            index.add(references[images])
    return Retrieving(index, references.nbytes + _count_link_bytes(index.hnsw))


def build_lists(kind: Kind, references: Vectors, probes: int) -> Retrieving:
    """Return inverted lists of codes, each of the images near one centroid; a query looks at `probes` of them.

    `ivfpq`: product codes (Jégou et al. 2011). A vector is cut into parts of 4 numbers, or more if that would make more
    than 512 parts; each is the number of one of 256 centroids. There are about sqrt(n) lists, a quarter looked at.
    `rabitq`: a bit for each dimension of what a list's centroid leaves (Gao and Long 2024), of vectors that are rotated
    first. There are about 4 sqrt(n) lists; one in 64 is looked at, 16 at least.
    """
    faiss = import_faiss()
    n_images, n_dimensions = references.shape
    n_lists = round(n_images**0.5)
    if kind == "ivfpq":
        part = max(_SHORTEST_PART, -(-n_dimensions // _MOST_PARTS))
        n_parts = -(-n_dimensions // part)
        length, looked_at = n_parts * part, -(-n_lists // 4)
        prepared = f"Pad{length}," * (length > n_dimensions)
        code = f"PQ{n_parts}x8np"  # np: its codes are not ordered for a comparison bit by bit, which takes long
        n_trained, n_learnt = _TRAINED_PER_CENTROID * max(n_lists, 256), n_lists + 256
    else:
        length = -(-n_dimensions // 8) * 8
        n_lists = max(1, min(round(4 * n_images**0.5), n_images // _TRAINED_PER_CENTROID))
        is_rotated = n_dimensions <= _ROTATED
        prepared, code = f"{'RR' if is_rotated else 'Pad'}{length},", "RaBitQfs_32"
        looked_at = max(16, -(-n_lists // 64))
        n_trained, n_learnt = 16 * n_lists, n_lists + n_dimensions * is_rotated
    index = faiss.index_factory(n_dimensions, f"{prepared}IVF{n_lists},{code}", faiss.METRIC_INNER_PRODUCT)
    lists = faiss.downcast_index(faiss.extract_index_ivf(index))
    lists.nprobe = min(probes or looked_at, n_lists)
    lists.cp.min_points_per_centroid = 1  # faiss would print that there are few
    if kind == "ivfpq":
        lists.pq.cp.min_points_per_centroid, lists.pq.cp.niter = 1, 10
    else:
        lists.qb = 4  # bits of each dimension of a query
    index.train(_sample(references, n_trained))
    for images in cut_into_parts(n_images, count_rows_together(references)):
        index.add(references[images])
    return Retrieving(index, n_images * (lists.code_size + 8) + 4 * length * n_learnt)  # 8: the number of an image


class Bits(Retrieving):
    """Whether each dimension is above its median in the map: Hamming distances tell how near two vectors are.

    Of vectors whose bits differ in a share s, the inner product is about cos(pi * s) (Charikar 2002). All images are
    compared, or those that a graph of near images leads to: faiss's IndexBinaryFlat answers one query of a million
    images of 512 bits in ten times the time of its function that counts all differing bits.
    """

    def __init__(self, references: Vectors, with_graph: bool) -> None:
        """Keep the bits of the references, read part by part."""
        faiss = import_faiss()
        n_images, n_dimensions = references.shape
        self._thresholds: Vectors = np.median(_sample(references, _SAMPLED_BITS // n_dimensions), axis=0)
        blocks = cut_into_parts(n_images, count_rows_together(references))
        self._graph = faiss.index_binary_factory(-(-n_dimensions // 64) * 64, "BHNSW16") if with_graph else None
        if self._graph is None:
            self._codes = np.empty((n_images, -(-n_dimensions // 64)), np.uint64)
            for rows in blocks:
                self._codes[rows] = self._take_bits(references[rows])
            self.n_bytes = self._codes.nbytes + self._thresholds.nbytes
            return
        self._graph.hnsw.efSearch = _BIT_CANDIDATES
        with _use_one_thread(faiss):
            for rows in blocks:
                self._graph.add(self._take_bits(references[rows]).view(np.uint8))
        self.n_bytes = n_images * self._graph.code_size + _count_link_bytes(self._graph.hnsw) + self._thresholds.nbytes

    def retrieve(self, codes: Vectors, n: int) -> tuple[Vectors, Numbers]:
        """Return similarities and images, (n_queries, n) each, best first; the image is -1 if there is none."""
        bits = self._take_bits(codes)
        if self._graph is not None:
            differing, images = self._graph.search(bits.view(np.uint8), n)
            return self._estimate_similarity(differing), images
        compared = Compared(
            len(self._codes),
            _COMPARED_BITS,
            None,
            lambda bits, first, last: compare_bits(bits, self._codes[first:last]),
            None,
        )
        best = find_nearest(bits, n, compared)  # of equals the lower image
        return np.where(best.places >= 0, self._estimate_similarity(-best.similarity), -np.inf), best.places

    def _take_bits(self, vectors: Vectors) -> Words:
        return pack_bits(vectors > self._thresholds)

    def _estimate_similarity(self, differing: npt.NDArray[Any]) -> Vectors:
        return np.asarray(np.cos(np.pi / len(self._thresholds) * differing), np.float32)


def _sample(references: Vectors, wanted: int) -> Vectors:
    """Return up to `wanted` of the references, drawn without replacement, in their order: 512 MiB at most."""
    n_images, n_dimensions = references.shape
    drawn = np.random.default_rng(0).permutation(n_images)[: max(1, min(wanted, _SAMPLED // n_dimensions))]
    return np.ascontiguousarray(references[np.sort(drawn)])


def _count_link_bytes(hnsw: Any) -> int:
    """Return the memory of a graph beside its vectors."""
    return int(4 * hnsw.neighbors.size() + 8 * hnsw.offsets.size() + 4 * hnsw.levels.size())


@contextmanager
def _use_one_thread(faiss: Any) -> Iterator[None]:
    """Let faiss use one thread: of several, the fastest would decide what a graph links."""
    before = faiss.omp_get_max_threads()
    faiss.omp_set_num_threads(1)
    try:
        yield
    finally:
        faiss.omp_set_num_threads(before)
