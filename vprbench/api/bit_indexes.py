"""Indexes of a bit or so for each dimension, 1/32 of the vectors: compared one by one, in lists, or in a graph."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from vprbench.api.hamming import packed, similarity
from vprbench.api.nearest import Compared, Numbers, Vectors, find_best, parts, rows_together
from vprbench.api.search_indexes import (
    TRAINED_PER_CENTROID,
    Retrieving,
    bytes_of_links,
    faiss_module,
    one_thread,
    sample,
)

_SAMPLED = 1 << 24  # numbers that thresholds are medians of
_ADDED = 1 << 24  # numbers made bits at once
_COMPARED = 1 << 17  # images together

_LINKS = 16  # of an image to others, binary_hnsw; twice as many on the lowest layer
_CANDIDATES = 128  # that binary_hnsw follows at a query, at least

_TRAINED_PER_LIST = 16  # images: with more, lists take long to learn and find hardly more
_LISTS_OF_ROOT = 4  # rabitq: so many times sqrt(n_images) lists, each of 39 images or more
_LISTS_LOOKED_AT, _FEWEST_LISTS = 64, 16  # one in so many, and at least these
_ROTATED = 2048  # dimensions, at most: more are even enough, and a rotation would take long
_QUERY_BITS = 4  # of each dimension of a query


class _Binary(Retrieving):
    """Whether each dimension is above its median in the map: Hamming distances tell how near two vectors are.

    Of vectors whose bits differ in a share s, the inner product is about cos(pi * s) (Charikar 2002).
    """

    def __init__(self, references: Vectors) -> None:
        self._thresholds: Vectors = np.median(sample(references, _SAMPLED // references.shape[1]), axis=0)

    def _bits(self, vectors: Vectors) -> npt.NDArray[np.uint64]:
        return packed(vectors > self._thresholds)

    def _similarity(self, differing: npt.NDArray[Any]) -> Vectors:
        return np.asarray(np.cos(np.pi / len(self._thresholds) * differing), np.float32)


class Bits(_Binary):
    """All images compared, by this project's own kernel: faster than faiss.IndexBinaryFlat."""

    def __init__(self, references: Vectors) -> None:
        """Keep the bits of the references, read part by part."""
        super().__init__(references)
        n_images, n_dimensions = references.shape
        self._codes = np.empty((n_images, -(-n_dimensions // 64)), np.uint64)
        for rows in parts(n_images, rows_together(references)):
            self._codes[rows] = self._bits(references[rows])
        self.n_bytes = self._codes.nbytes + self._thresholds.nbytes

    def retrieve(self, codes: Vectors, n: int) -> tuple[Vectors, Numbers]:
        """Return similarities and images, (n_queries, n) each, best first; of equals the lower image."""
        compared = Compared(len(self._codes), _COMPARED, None, self._compare, None)
        best = find_best(self._bits(codes), n, compared)
        return np.where(best.places >= 0, self._similarity(-best.similarity), -np.inf), best.places

    def _compare(self, bits: npt.NDArray[np.uint64], first: int, last: int) -> Vectors:
        """Return minus the differing bits, (n_queries, last - first)."""
        return similarity(bits, self._codes[first:last])


class BitGraph(_Binary):
    """A graph of images whose bits are near, climbed from layer to layer."""

    def __init__(self, references: Vectors) -> None:
        """Link the references one after the other."""
        faiss = faiss_module()
        super().__init__(references)
        n_images, n_dimensions = references.shape
        self._index = faiss.IndexBinaryHNSW(-(-n_dimensions // 64) * 64, _LINKS)
        self._index.hnsw.efSearch = _CANDIDATES
        with one_thread(faiss):
            for rows in parts(n_images, max(1, _ADDED // n_dimensions)):
                self._index.add(self._bits(references[rows]).view(np.uint8))
        self.n_bytes = n_images * self._index.code_size + bytes_of_links(self._index.hnsw) + self._thresholds.nbytes

    def retrieve(self, codes: Vectors, n: int) -> tuple[Vectors, Numbers]:
        """Return similarities and images, (n_queries, n) each, best first; the image is -1 if there is none."""
        differing, images = self._index.search(self._bits(codes).view(np.uint8), n)
        return self._similarity(differing), images


class RaBitQ(Retrieving):
    """Inverted lists of RaBitQ codes (Gao and Long 2024): a bit for each dimension of what a list's centroid leaves.

    Inner products are estimated from the bits, which are compared in steps of 32 images. A query looks at one list in
    64, and 16 at least, unless `probes` says how many.
    """

    def __init__(self, references: Vectors, probes: int) -> None:
        """Learn the lists from a sample, and put the references into them, read part by part."""
        faiss = faiss_module()
        n_images, n_dimensions = references.shape
        n_lists = max(1, min(round(_LISTS_OF_ROOT * n_images**0.5), n_images // TRAINED_PER_CENTROID))
        length = -(-n_dimensions // 8) * 8
        lists = faiss.IndexIVFRaBitQFastScan(faiss.IndexFlatIP(length), length, n_lists, faiss.METRIC_INNER_PRODUCT)
        lists.nprobe = min(probes or max(_FEWEST_LISTS, -(-n_lists // _LISTS_LOOKED_AT)), n_lists)
        lists.qb = _QUERY_BITS
        lists.cp.min_points_per_centroid = 1  # faiss would print that there are few
        self._rotation = faiss.RandomRotationMatrix(n_dimensions, length) if n_dimensions <= _ROTATED else None
        if self._rotation is not None:
            self._rotation.init(0)
        self._length = length
        self._index = lists
        lists.train(self._prepared(sample(references, _TRAINED_PER_LIST * n_lists)))
        for rows in parts(n_images, rows_together(references)):
            lists.add(self._prepared(references[rows]))
        rotation = 0 if self._rotation is None else 4 * n_dimensions * length
        self.n_bytes = n_images * (lists.code_size + 8) + 4 * length * n_lists + rotation  # 8: the number of an image

    def _prepared(self, vectors: Vectors) -> Vectors:
        if self._rotation is not None:
            turned: Vectors = self._rotation.apply(np.ascontiguousarray(vectors))
            return turned
        return np.pad(vectors, ((0, 0), (0, self._length - vectors.shape[1])))
