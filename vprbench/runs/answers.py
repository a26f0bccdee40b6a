"""The answers of one run: every query scored block by block, in bounded memory."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
import numpy.typing as npt

from vprbench import progress
from vprbench.api.adaptation import Adaptation
from vprbench.api.arrays import Scores
from vprbench.api.binary import BinaryMethod
from vprbench.api.dataset import Dataset
from vprbench.api.descriptor import DescriptorMethod
from vprbench.api.images import Images
from vprbench.api.method import Method, batch_size_for, require_codes
from vprbench.api.nearest import Nearest
from vprbench.api.search import Audit, Search
from vprbench.errors import BadInput
from vprbench.metrics.ranking import (
    Outcome,
    checked_scores,
    concatenate,
    outcome,
    outcome_of_best,
    ranked_places,
)
from vprbench.runs.adapted import Adapted, Asked
from vprbench.runs.descriptors import DescriptorCache
from vprbench.runs.notes import Note
from vprbench.runs.shortlist import TOGETHER, Scorer, Shortlisting, scorer_for
from vprbench.runs.stopwatch import Stopwatch
from vprbench.runs.viewpoints import Viewed, Viewpoint

_BLOCK = 128  # queries scored together
_BLOCK_CELLS = 1 << 25  # scores of such a block
_AUDITED = 256  # queries by which an approximate index is compared with exact search, at most
_LARGEST_MATRIX = 10_000_000  # scores kept whole up to this number


class Answers:
    """Collects a method's answers block by block, in bounded memory."""

    def __init__(self, dataset: Dataset, depth: int, whole: bool = False) -> None:
        """Keep the best `depth` places of each query, and all scores if they are few or if `whole`."""
        self._positives = dataset.positives
        self._depth = depth
        self._shape = (len(dataset.queries), dataset.n_places)
        self.done = 0
        self.method_seconds = 0.0
        self._outcomes: list[Outcome] = []
        self._top_places: list[npt.NDArray[np.int32]] = []
        self._top_scores: list[Scores] = []
        kept = whole or self._shape[0] * self._shape[1] <= _LARGEST_MATRIX
        self._kept = np.empty(self._shape, np.float32) if kept else None  # the system gives memory as it is filled

    def add(self, n_queries: int, answer: Scores | Nearest) -> None:
        """Take the scores, or the best places, of the next queries; raises BadInput for a wrong shape or kind."""
        if isinstance(answer, Nearest):
            self._add_best(answer)
        else:
            self._add_scores(n_queries, answer)

    def _add_best(self, best: Nearest) -> None:
        scores = checked_scores(best.similarity, self.done)
        positives = self._positives[self.done : self.done + len(scores)]
        self._outcomes.append(outcome_of_best(scores, best.places, positives, self._shape[1]))
        self._top_places.append(_named(best.places).astype(np.int32))
        self._top_scores.append(scores)
        self._kept = None
        self.done += len(scores)

    def _add_scores(self, n_queries: int, scores: Scores) -> None:
        wanted = (n_queries, self._shape[1])
        if np.shape(scores) != wanted:
            raise BadInput(f"the method gave scores of shape {np.shape(scores)}; wanted {wanted}, one for each place")
        scores = checked_scores(scores, self.done)
        self._outcomes.append(outcome(scores, self._positives[self.done : self.done + len(scores)]))
        places, values = ranked_places(scores, self._depth)
        self._top_places.append(places)
        self._top_scores.append(values)
        if self._kept is not None:
            self._kept[self.done : self.done + len(scores)] = scores
        self.done += len(scores)

    @property
    def outcome(self) -> Outcome:
        """The outcome of all queries."""
        return concatenate(self._outcomes)

    @property
    def top_places(self) -> npt.NDArray[np.int32]:
        """The best places of each query, (n_queries, depth), best first."""
        return np.concatenate(self._top_places)

    @property
    def top_scores(self) -> Scores:
        """The scores of these places, (n_queries, depth)."""
        return np.concatenate(self._top_scores)

    @property
    def scores(self) -> Scores | None:
        """All scores, (n_queries, n_places); None if they are too many to keep."""
        return self._kept


class Audited:
    """Keeps the codes of some queries, spread over all, by which an approximate index is compared with exact search."""

    def __init__(self, method: Method, n_queries: int) -> None:
        """Keep none if a fitted method does not search by an approximate index."""
        self._method = method
        index = _index(method)
        wanted = 0 if index is None or index.kind == "exact" else batch_size_for(method, min(_AUDITED, n_queries))
        self._queries = np.linspace(0, n_queries - 1, wanted).astype(np.int64)
        self._codes: list[npt.NDArray[Any]] = []

    def take(self, first: int, codes: npt.NDArray[Any]) -> None:
        """Keep the wanted rows of `codes`, which are of query `first` and the next ones."""
        rows = self._queries - first
        rows = rows[(rows >= 0) & (rows < len(codes))]
        if len(rows):
            self._codes.append(codes[rows])

    def search(self) -> dict[str, Any] | None:
        """Return by which index a method searches, and the share of exact search's places that it finds."""
        if isinstance(self._method, BinaryMethod) and self._method.known is not None:
            return {"index": "exact", "bytes_per_place": self._method.known.bytes_per_place, **asdict(Audit(1.0, 1.0))}
        index = _index(self._method)
        if index is None or not isinstance(self._method, DescriptorMethod):
            return None
        audit = Audit(1.0, 1.0) if index.kind == "exact" else self._method.audit(np.concatenate(self._codes))
        found = {"index": index.kind, "bytes_per_place": index.bytes_per_place, **asdict(audit)}
        return (
            found if index.kind == "exact" else {**found, "rerank": index.rerank, "build_seconds": index.build_seconds}
        )


class Scoring:
    """Scores the queries of a dataset by a fitted method, encode and match timed."""

    def __init__(self, stopwatch: Stopwatch, method: Method, dataset: Dataset, depth: int, whole: bool = False) -> None:
        """Keep of the answers what `Answers` keeps; nothing is asked yet."""
        self._stopwatch = stopwatch
        self.asked: Scorer = scorer_for(method, dataset.n_places, depth, whole)
        self._method = method
        self._adaptation = Adaptation(method)
        self._queries = dataset.queries.unnamed()
        self._n_places = dataset.n_places
        self.answers = Answers(dataset, depth, whole)
        self.audited = Audited(method, len(dataset.queries))

    def score(self, described: DescriptorCache | None) -> int:
        """Score all queries; returns of how many `described` had kept the descriptors already."""
        size = block_size(self.asked, self._n_places)
        from_cache = None if self._adaptation.is_causal else self._survey(described, size)
        if described is not None:
            kept = self._score_descriptors(described, size)
            return kept if from_cache is None else from_cache  # the survey kept what it encoded
        for block in self._queries.blocks(size):
            self.answers.add(len(block), self._match(self._encode(block)))  # the codes, which may be large, are gone
            progress.report("query", self.answers.done / len(self._queries))
            del block  # or it would be held while the next one is decoded
        return 0

    def begin_traverse(self) -> Asked:
        """Return what answers the queries of a traverse from its first one on."""
        if self._method.adapt == "none":
            return self.asked
        return Adapted(self.asked, Adaptation(self._method) if self._adaptation.is_causal else self._adaptation)

    def look_from(self, views: Sequence[Viewpoint], method: Method) -> None:
        """Ask a method for all scores of each query from these viewpoints."""
        self.asked = Viewed(method, views)

    def notes(self) -> Iterator[Note]:
        """Yield a note if the method was asked for its best places alone."""
        if isinstance(self.asked, Shortlisting):
            best = f"of {self._n_places:,} places the best {self.asked.depth} of each query are kept"
            yield Note("shortlist", f"large map: {best}, and a right place that is none of these is no candidate")

    def _encode(self, block: Images) -> npt.NDArray[Any]:
        with self._stopwatch.lap() as lap:
            codes = require_codes(self.asked.encode(block), len(block))
        self.answers.method_seconds += lap[0]
        return codes

    def _survey(self, described: DescriptorCache | None, size: int) -> int:
        """See the codes of all queries before the first is answered; returns how many descriptors were kept already."""
        total = len(self._queries)
        if described is not None:
            descriptors, from_cache = described.descriptors(self._queries, self._encode, lambda done: None)
            for start in range(0, total, size):
                self._adaptation.survey(descriptors[start : start + size])
            return from_cache
        done = 0
        for block in self._queries.blocks(size):
            self._adaptation.survey(self._encode(block))
            done += len(block)
            progress.report("looking at all queries", done / total)
            del block  # or it would be held while the next one is decoded
        return 0

    def _match(self, codes: npt.NDArray[Any]) -> Scores | Nearest:
        with self._stopwatch.lap() as lap:
            codes = self._adaptation.apply(codes)
            answer = self.asked.match(codes)
        self.audited.take(self.answers.done, codes[:, 0] if isinstance(self.asked, Viewed) else codes)
        self.answers.method_seconds += lap[0]
        return answer

    def _score_descriptors(self, described: DescriptorCache, size: int) -> int:
        total = len(self._queries)
        descriptors, from_cache = described.descriptors(
            self._queries,
            lambda block: np.asarray(self._encode(block)),
            lambda done: progress.report("query", done / total),
        )
        for start in range(0, total, size):
            codes = descriptors[start : start + size]
            self.answers.add(len(codes), self._match(codes))
            progress.report("search", self.answers.done / total)
        return from_cache


def block_size(method: Scorer, n_places: int) -> int:
    """Return how many queries are scored together at most, fewer if codes are large or scored places many."""
    if isinstance(method, Shortlisting):
        return batch_size_for(method, TOGETHER)
    return batch_size_for(method, max(1, min(_BLOCK, _BLOCK_CELLS // n_places)))


def _named(places: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """Return best places, (n_queries, n), with the lowest places that are not among them where there is none (-1)."""
    named = places.copy()
    for query in np.flatnonzero((places < 0).any(axis=1)):
        none = places[query] < 0
        named[query, none] = np.setdiff1d(np.arange(len(none)), places[query])[: np.count_nonzero(none)]
    return named


def _index(method: Method) -> Search | None:
    return method.searched if isinstance(method, DescriptorMethod) else None
