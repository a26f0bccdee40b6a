"""Scorers answer the queries of a run: a method itself, its best places alone, several views, or adapted codes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from vprbench.api.adaptation import Adaptation
from vprbench.api.arrays import Scores
from vprbench.api.descriptor import DescriptorMethod
from vprbench.api.images import Images
from vprbench.api.method import Method, batch_size_for
from vprbench.api.nearest import Nearest
from vprbench.runs.viewpoints import Viewpoint, render_view

LARGE_MAP = 1 << 18  # places: of more, a run keeps the best ones of each query alone
_TOGETHER = 1024  # queries compared with such a map at once
_BLOCK = 128  # queries scored together
_BLOCK_CELLS = 1 << 25  # scores of such a block

Answer = Scores | Nearest  # of several queries


class Scorer(Protocol):
    """Answers queries in two steps, which are timed; every fitted method is one."""

    @property
    def code_bytes(self) -> int:
        """Bytes of the codes of one query."""

    def encode(self, images: Images) -> npt.NDArray[Any]:
        """Turn queries into codes, (n_queries, ...)."""

    def match(self, codes: npt.NDArray[Any]) -> Answer:
        """Return the scores of all places, (n_queries, n_places), or the best places of each query."""


@dataclass(frozen=True)
class NearestScorer:
    """Answers a query by its best `depth` places, for a map that is too large to score every place."""

    method: DescriptorMethod
    depth: int

    @property
    def code_bytes(self) -> int:
        """Bytes of one image's code, as the method's."""
        return self.method.code_bytes

    def encode(self, images: Images) -> npt.NDArray[Any]:
        """Turn images into codes, (n_images, ...)."""
        return self.method.encode(images)

    def match(self, codes: npt.NDArray[np.float32]) -> Nearest:
        """Return the best places for every code, (n_queries, depth)."""
        return Nearest(*self.method.nearest(codes, self.depth))


@dataclass(frozen=True)
class ViewsScorer:
    """Answers a query from several viewpoints: a place's score is that of the view that shows it best."""

    method: Method
    views: Sequence[Viewpoint]

    @property
    def code_bytes(self) -> int:
        """Bytes of the codes of one query."""
        return self.method.code_bytes * len(self.views)

    def encode(self, images: Images) -> npt.NDArray[Any]:
        """Turn queries into the codes of their views, (n_queries, n_views, ...)."""
        frames = [render_view(image, view) for image in images for view in self.views]
        codes = self.method.encode(Images.from_arrays(frames))
        return codes.reshape(len(images), len(self.views), *codes.shape[1:])

    def match(self, codes: npt.NDArray[Any]) -> Scores:
        """Return the best score of every place among the views, (n_queries, n_places)."""
        scores = self.method.match(codes.reshape(-1, *codes.shape[2:]))
        return np.asarray(scores.reshape(*codes.shape[:2], -1).max(1), np.float32)


@dataclass(frozen=True)
class AdaptedScorer:
    """Answers one traverse of queries, whose codes are adapted in their order between encode and match."""

    scorer: Scorer
    adaptation: Adaptation

    @property
    def code_bytes(self) -> int:
        """Bytes of the codes of one query."""
        return self.scorer.code_bytes

    def encode(self, images: Images) -> npt.NDArray[Any]:
        """Turn queries into codes that are not adapted, (n_queries, ...)."""
        return self.scorer.encode(images)

    def match(self, codes: npt.NDArray[Any]) -> Answer:
        """Return the answers to the next queries of the traverse."""
        return self.scorer.match(self.adaptation.apply(codes))


def choose_scorer(
    method: Method, n_places: int, depth: int, whole: bool = False, views: Sequence[Viewpoint] = ()
) -> Scorer:
    """Return the scorer of a fitted method.

    A method scores all places of a small map, where all scores are wanted (`whole`), and where it overrides `match` but
    not `nearest`. From several viewpoints all places are scored.
    """
    if views:
        return ViewsScorer(method, views)
    if whole or n_places <= LARGE_MAP or not isinstance(method, DescriptorMethod):
        return method
    match, nearest = (
        next(kind for kind in type(method).__mro__ if name in vars(kind)) for name in ("match", "nearest")
    )
    return NearestScorer(method, min(depth, n_places)) if issubclass(nearest, match) else method


def block_size(scorer: Scorer, n_places: int) -> int:
    """Return how many queries are scored together at most, fewer if codes are large or scored places many."""
    if isinstance(scorer, NearestScorer):
        return batch_size_for(scorer, _TOGETHER)
    return batch_size_for(scorer, max(1, min(_BLOCK, _BLOCK_CELLS // n_places)))


def best_place(answer: Answer) -> int:
    """Return the best place of the first query; -1 if no place is a candidate of a shortlist."""
    return int(answer.places[0, 0] if isinstance(answer, Nearest) else answer[0].argmax())
