"""Nearest-neighbour search of unit descriptors: exact, or by an index that is smaller or faster and may be wrong."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from time import perf_counter
from typing import get_args

import numpy as np
import numpy.typing as npt

from vprbench.api.arithmetic import count_operations
from vprbench.api.nearest import (
    CELLS,
    ROUNDING,
    Compared,
    Numbers,
    Vectors,
    choose_nearest,
    count_rows_together,
    cut_into_parts,
    find_nearest,
)
from vprbench.api.search_indexes import (
    FEWEST_OF_CODES,
    Bits,
    EightBits,
    Exact,
    Kind,
    Retrieving,
    build_graph,
    build_lists,
)
from vprbench.errors import BadInput

_TOGETHER = 1 << 16  # reference images, if several show a place

_INDEXES: dict[Kind, Callable[[Vectors, int], Exact | Retrieving]] = {
    "exact": lambda references, _: Exact(references),
    "sq8": lambda references, _: EightBits(references),
    "hnsw": lambda references, _: build_graph(references),
    "ivfpq": partial(build_lists, "ivfpq"),
    "rabitq": partial(build_lists, "rabitq"),
    "binary": lambda references, _: Bits(references, with_graph=False),
    "binary_hnsw": lambda references, _: Bits(references, with_graph=True),
}


@dataclass(frozen=True)
class Audit:
    """The share of the places found by exact search that an index finds too, 0 to 1, mean over the queries."""

    recall_at_1: float  # of the exactly best place
    recall_at_10: float  # of the 10 best places


class Search:
    """Scores places by the inner product with the most similar of their images.

    `exact` compares every reference. `sq8` does so too, but in 8 bits a number: a quarter of the memory. The others
    retrieve the `neighbours` most similar images or nearly those; a place without any of them scores -inf: no
    candidate. `hnsw` is a graph that holds the vectors; `ivfpq` (codes of a few bytes) and `rabitq` (a bit a dimension)
    are inverted lists, of which a query looks at `probes` (0: a share that the index chooses); `binary` (a bit a
    dimension) compares all images, `binary_hnsw` is a graph of these. Of any approximate index, the `rerank` images
    that it finds best are compared again by the vectors, exactly, and these alone are candidates. The same references
    give the same index.
    """

    def __init__(
        self,
        references: Vectors,
        places: Numbers,
        kind: Kind = "exact",
        neighbours: int = 100,
        rerank: int = 0,
        probes: int = 0,
    ) -> None:
        """Index `references`, which stay where they are, memory-mapped or not, with the place of each.

        An approximate index answers without them, but to compare exactly the `rerank` images that it finds best; they
        are kept to be compared with. Raises BadInput as `check_index` does, and for places that are not one for each
        reference.
        """
        check_index(kind, neighbours, len(references), rerank, probes)
        if len(references.shape) != 2 or places.shape != (len(references),):
            raise BadInput(
                f"references {references.shape} came with places {places.shape}: wanted (n_images, n_dimensions) of an "
                "image or more, and a place for each"
            )
        self.references = references = np.ascontiguousarray(references, np.float32)
        self.places = places
        self.kind = kind
        self._n_places = int(places.max()) + 1
        self._neighbours = min(rerank or neighbours, len(references))
        self.rerank = 0 if kind == "exact" else rerank
        started = perf_counter()
        self._index = _INDEXES[kind](references, probes)
        self.build_seconds = perf_counter() - started
        one_each = np.array_equal(places, np.arange(len(places)))
        self._shown = None if one_each else places
        self._blocks = None if one_each else [*_blocks_of_places(places)]

    @property
    def bytes_per_place(self) -> int:
        """The memory that answers need, for each place."""
        return round(self._index.n_bytes / self._n_places)

    def scores(self, codes: Vectors) -> Vectors:
        """Return for each place the best inner product, (n_queries, n_places), with `codes` (n_queries, n_dimensions).

        Beside the result, memory is bounded: about 200 MB. Raises ValueError for codes of another length.
        """
        codes = self._require_codes(codes)
        if self.rerank or isinstance(self._index, Retrieving):
            return self._score_retrieved(codes)
        count_operations(float(len(codes)) * self.references.shape[0] * self.references.shape[1])
        if self._blocks is None:
            return self._index.similarity(codes, 0, len(self.references))
        scores = np.full((len(codes), self._n_places), -np.inf, np.float32)
        for queries in cut_into_parts(len(codes), CELLS // _TOGETHER):
            for block in self._blocks:
                similarity = self._index.similarity(codes[queries], block.first, block.last)
                best = np.maximum.reduceat(similarity[:, block.order], block.starts, axis=1)
                scores[queries, block.places] = np.maximum(scores[queries, block.places], best)
        return scores

    def nearest(self, codes: Vectors, n: int) -> tuple[Vectors, Numbers]:
        """Return the similarity of the `n` best places, (n_queries, n), and these places, best first.

        Of places as good as one another the lower comes first; where there is none, the similarity is -inf and the
        place -1. Exact similarities are sums in float64, then rounded: the same in any batch. Raises ValueError for
        codes of another length.
        """
        codes = self._require_codes(codes)
        if self.rerank or isinstance(self._index, Retrieving):
            best = choose_nearest(*self._retrieve(codes), len(codes), n)
        elif self.kind == "exact":
            compared = replace(self._compare(self._index, self._shown), exactly=self._multiply_pairs)
            best = find_nearest(codes, n, compared)
        else:
            best = find_nearest(codes, n, self._compare(self._index, self._shown))
        return best.similarity, best.places

    def split_codes(self, codes: Vectors) -> Iterator[Vectors]:
        """Yield `codes` in parts whose scores take up to 64 MiB."""
        for queries in cut_into_parts(len(codes), max(1, CELLS // self._n_places)):
            yield codes[queries]

    def _compare(self, index: Exact, places: Numbers | None) -> Compared:
        """Return how an index compares all images; without `places`, images are found."""
        return Compared(len(self.references), count_rows_together(self.references), places, index.similarity, None)

    def _multiply_pairs(self, codes: Vectors, queries: Numbers, images: Numbers) -> Vectors:
        from vprbench.api.pairs import multiply_pairs  # here, for it needs PyTorch

        return multiply_pairs(self.references, codes, queries, images)

    def _score_retrieved(self, codes: Vectors) -> Vectors:
        scores = np.full((len(codes), self._n_places), -np.inf, np.float32)
        rows, similarity, places = self._retrieve(codes)
        np.maximum.at(scores, (rows, places), similarity)
        return scores

    def _retrieve(self, codes: Vectors) -> tuple[Numbers, Vectors, Numbers]:
        """Return the query, the similarity and the place of each image that an index finds."""
        if isinstance(self._index, Retrieving):
            similarity, images = self._index.retrieve(codes, self._neighbours)
        else:
            found = find_nearest(codes, self._neighbours, self._compare(self._index, None))
            similarity, images = found.similarity, found.places
        rows, columns = np.nonzero(images >= 0)
        chosen = images[rows, columns]
        values = self._multiply_pairs(codes, rows, chosen) if self.rerank else similarity[rows, columns]
        return rows, values, self.places[chosen]

    def _require_codes(self, codes: Vectors) -> Vectors:
        n_dimensions = self.references.shape[1]
        if codes.ndim != 2 or codes.shape[1] != n_dimensions:
            raise ValueError(f"codes {codes.shape} came; this map compares (n_queries, {n_dimensions})")
        return np.ascontiguousarray(codes, np.float32)


def check_index(kind: str, neighbours: int, n_images: int, rerank: int = 0, probes: int = 0) -> None:
    """Raise BadInput for an unknown kind, for numbers out of their range, and for too few images."""
    if kind not in get_args(Kind):
        raise BadInput(f"method.index={kind} is unknown: give {', '.join(get_args(Kind))}")
    if neighbours < 1:
        raise BadInput(f"method.neighbours={neighbours}: give at least 1")
    for name, number in (("rerank", rerank), ("probes", probes)):
        if number < 0:
            raise BadInput(f"method.{name}={number}: give 0 or more")
    if n_images < (least := FEWEST_OF_CODES if kind == "ivfpq" else 1):
        raise BadInput(
            f"method.index={kind} needs at least {least} reference images, {n_images} came"
            + (": take exact, hnsw or sq8" if kind == "ivfpq" else "")
        )


def compare_best(scores: Vectors, exact: Vectors) -> npt.NDArray[np.float64]:
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
        shares.append((own >= least - ROUNDING).mean(1))
    return np.stack(shares, axis=1)


@dataclass(frozen=True)
class _ImageBlock:
    """Consecutive images, and which of them show which place."""

    first: int
    last: int
    order: npt.NDArray[np.int64]  # the images by place
    starts: npt.NDArray[np.int64]  # where each place begins in that order
    places: npt.NDArray[np.int64]  # that they show


def _blocks_of_places(places: npt.NDArray[np.int64]) -> Iterator[_ImageBlock]:
    for images in cut_into_parts(len(places), _TOGETHER):
        order = np.argsort(places[images], kind="stable")
        shown, starts = np.unique(places[images][order], return_index=True)
        yield _ImageBlock(images.start, images.stop, order, starts, shown)
