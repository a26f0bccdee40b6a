"""Scorers answer the queries of a run in two steps, which are timed: encode and match."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from vprbench.api.adaptation import Adaptation, adapt_traverse
from vprbench.api.arrays import Scores
from vprbench.api.descriptor import DescriptorMethod
from vprbench.api.images import Images
from vprbench.api.method import Method, limit_batch_size
from vprbench.api.nearest import Nearest
from vprbench.runs.viewpoints import Viewpoint, render_view

LARGE_MAP = 1 << 18  # places: of more, a run keeps the best ones of each query alone
_TOGETHER = 1024  # queries compared with such a map at once
_BLOCK = 128  # queries scored together
_BLOCK_CELLS = 1 << 25  # scores of such a block
_SAMPLE = 256  # queries that are encoded once more

Answer = Scores | Nearest  # of several queries


@dataclass(frozen=True)
class QueryScorer:
    """Answers one traverse of queries by a fitted method, adapting codes in their order between encode and match."""

    method: Method
    adaptation: Adaptation
    views: Sequence[Viewpoint] = ()  # of each query: a place's score is that of the view that shows it best
    n_best: int | None = None  # places of each query on a map that is too large to score every place; None: all

    def begin_traverse(self) -> QueryScorer:
        """Return the scorer of another traverse; a mean of all queries that is known stays."""
        return replace(self, adaptation=Adaptation(self.method)) if self.adaptation.is_causal else self

    @property
    def code_bytes(self) -> int:
        """Bytes of the codes of one query."""
        return self.method.code_bytes * max(1, len(self.views))

    def encode(self, images: Images) -> npt.NDArray[Any]:
        """Turn queries into codes that are not adapted, (n_queries, ...), or (n_queries, n_views, ...)."""
        if not self.views:
            return self.method.encode(images)
        frames = [render_view(image, view) for image in images for view in self.views]
        codes = self.method.encode(Images.from_arrays(frames))
        return codes.reshape(len(images), len(self.views), *codes.shape[1:])

    def match(self, codes: npt.NDArray[Any]) -> Answer:
        """Return the answers to the next queries of the traverse."""
        codes = self.adaptation.apply(codes)
        if self.n_best is not None:
            assert isinstance(self.method, DescriptorMethod)
            return Nearest(*self.method.nearest(codes, self.n_best))
        if not self.views:
            return self.method.match(codes)
        scores = self.method.match(codes.reshape(-1, *codes.shape[2:]))
        return np.asarray(scores.reshape(*codes.shape[:2], -1).max(1), np.float32)


def choose_scorer(
    method: Method, n_places: int, depth: int, whole: bool = False, views: Sequence[Viewpoint] = ()
) -> QueryScorer:
    """Return the scorer of a fitted method.

    A method scores all places of a small map, where all scores are wanted (`whole`), where it overrides `match` but not
    `nearest`, and where a query has several views.
    """
    n_best = None
    if n_places > LARGE_MAP and not (whole or views) and isinstance(method, DescriptorMethod):
        kinds = type(method).__mro__
        match, nearest = (next(kind for kind in kinds if name in vars(kind)) for name in ("match", "nearest"))
        n_best = min(depth, n_places) if issubclass(nearest, match) else None
    return QueryScorer(method, Adaptation(method), views, n_best)


def choose_block_size(scorer: Method | QueryScorer, n_places: int) -> int:
    """Return how many queries are scored together at most, fewer if codes are large or scored places many."""
    if isinstance(scorer, QueryScorer) and scorer.n_best is not None:
        return limit_batch_size(_TOGETHER, scorer.code_bytes)
    return limit_batch_size(max(1, min(_BLOCK, _BLOCK_CELLS // n_places)), scorer.code_bytes)


def encode_sample(method: Method, queries: Images) -> npt.NDArray[Any]:
    """Return the adapted codes of up to 256 queries spread over all, by which indexes and spikes are judged."""
    wanted = limit_batch_size(min(_SAMPLE, len(queries)), method.code_bytes)
    sample = queries[np.linspace(0, len(queries) - 1, wanted).astype(np.int64)]
    codes = [
        np.array(method.encode(block)) for block in sample.blocks(choose_block_size(method, 1))
    ]  # it may reuse its array
    return np.asarray(adapt_traverse(method, np.concatenate(codes)))


def find_best_place(answer: Answer) -> int:
    """Return the best place of the first query; -1 if no place is a candidate of a shortlist."""
    return int(answer.places[0, 0] if isinstance(answer, Nearest) else answer[0].argmax())
