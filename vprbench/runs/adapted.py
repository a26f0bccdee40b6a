"""A fitted method that is asked under its argument `adapt`: between encode and match a mean is taken off the codes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy.typing as npt

from vprbench.api.adaptation import Adaptation
from vprbench.api.images import Images
from vprbench.api.method import Method
from vprbench.runs.notes import Note
from vprbench.runs.shortlist import Answer, Scorer

_NOTES = {
    "references": "the mean of the references is taken off the descriptors of references and queries",
    "running": "adapted to the queries so far: their mean is taken off each query, so the order of the queries counts",
    "traverse": "adapted to all queries: their mean is taken off each query, which can be done only offline",
}


@dataclass(frozen=True)
class Adapted:
    """Stands in for a method where it is asked: one traverse of queries, adapted in their order."""

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
        """Return the scores, or the best places, of the next queries of the traverse."""
        return self.scorer.match(self.adaptation.apply(codes))


Asked = Scorer | Adapted


def describe_adaptation(method: Method) -> Iterator[Note]:
    """Yield a note on the mean that is taken off, if one is."""
    if method.adapt != "none":
        yield Note("adapted", _NOTES[method.adapt])
