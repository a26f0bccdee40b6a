"""How a run asks a method on a large map: for the best places of a query, never for the scores of all places."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from vprbench.api.arrays import Scores
from vprbench.api.descriptor import DescriptorMethod
from vprbench.api.images import Images
from vprbench.api.method import Method
from vprbench.api.nearest import Nearest
from vprbench.runs.viewpoints import Viewed

LARGE_MAP = 1 << 18  # places: of more, a run keeps the best ones of each query alone
TOGETHER = 1024  # queries compared with such a map at once


@dataclass(frozen=True)
class Shortlisting:
    """Stands in for a method where it is asked: its answer to a query is the best `depth` places."""

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


Scorer = Method | Shortlisting | Viewed
Answer = Scores | Nearest  # of several queries


def best_place(answer: Answer) -> int:
    """Return the best place of the first query; -1 if no place is a candidate of a shortlist."""
    return int(answer.places[0, 0] if isinstance(answer, Nearest) else answer[0].argmax())


def scorer_for(method: Method, n_places: int, depth: int, whole: bool = False) -> Scorer:
    """Return how a run asks a fitted method: for the best places alone if the map is large and the method names them.

    A method that matches in its own way, and says nothing of `nearest`, is asked for all scores, and so is any if all
    are wanted (`whole`).
    """
    if whole or n_places <= LARGE_MAP or not isinstance(method, DescriptorMethod):
        return method
    match, nearest = (
        next(kind for kind in type(method).__mro__ if name in vars(kind)) for name in ("match", "nearest")
    )
    return Shortlisting(method, min(depth, n_places)) if issubclass(nearest, match) else method
