"""The answers of one run: every query scored block by block, in bounded memory."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from typing import Any

import numpy as np
import numpy.typing as npt

from vprbench import progress
from vprbench.api.arrays import Scores
from vprbench.api.binary import BinaryMethod
from vprbench.api.dataset import Dataset
from vprbench.api.descriptor import DescriptorMethod
from vprbench.api.images import Images
from vprbench.api.method import Method, require_codes
from vprbench.api.nearest import Nearest
from vprbench.api.search import Audit
from vprbench.errors import BadInput
from vprbench.metrics.ranking import Outcome, concatenate, judge_scores, outcome_of_best, rank_places, require_scores
from vprbench.runs.descriptors import DescriptorCache
from vprbench.runs.scorers import Answer, QueryScorer, choose_block_size, encode_sample
from vprbench.runs.stopwatch import Stopwatch

_LARGEST_MATRIX = 10_000_000  # scores kept whole up to this number


class QueryScoring:
    """Scores the queries of a dataset in blocks, in bounded memory."""

    def __init__(
        self, stopwatch: Stopwatch, scorer: QueryScorer, dataset: Dataset, depth: int, whole: bool = False
    ) -> None:
        """Keep the best `depth` places of each query, and all scores if they are few or if `whole`."""
        self._stopwatch, self._scorer, self._depth = stopwatch, scorer, depth
        self._queries, self._positives, self._n_places = dataset.queries.unnamed(), dataset.positives, dataset.n_places
        self._size = choose_block_size(scorer, dataset.n_places)
        self._done = 0
        self._outcomes: list[Outcome] = []
        self._places: list[npt.NDArray[np.int32]] = []
        self._scores: list[Scores] = []
        shape = len(dataset.queries), dataset.n_places
        kept = scorer.n_best is None and (whole or shape[0] * shape[1] <= _LARGEST_MATRIX)
        self.scores = np.empty(shape, np.float32) if kept else None  # the system gives memory as it is filled
        self.method_seconds = 0.0

    @property
    def outcome(self) -> Outcome:
        """The outcome of all queries."""
        return concatenate(self._outcomes)

    @property
    def top_places(self) -> npt.NDArray[np.int32]:
        """The best places of each query, (n_queries, depth), best first."""
        return np.concatenate(self._places)

    @property
    def top_scores(self) -> Scores:
        """The scores of these places, (n_queries, depth)."""
        return np.concatenate(self._scores)

    def score(self, described: DescriptorCache | None) -> None:
        """Score all queries, from descriptors that are kept or encoded now; raises BadInput for impossible scores."""
        kept, n_queries = None, len(self._queries)
        if described is not None:
            kept, _ = described.descriptors(
                self._queries,
                lambda block: np.asarray(self._encode_block(block)),
                lambda done: progress.report("query", done / n_queries),
            )
        if not self._scorer.adaptation.is_causal:
            surveyed = 0
            for codes in self._iterate_codes(kept):
                self._scorer.adaptation.survey(codes)
                surveyed += len(codes)
                progress.report("looking at all queries", surveyed / n_queries)
        for codes in self._iterate_codes(kept):
            with self._stopwatch.lap() as lap:
                answer = self._scorer.match(codes)
            self.method_seconds += lap[0]
            self._keep_answer(len(codes), answer)
            progress.report("query" if kept is None else "search", self._done / n_queries)

    def _iterate_codes(self, kept: Any) -> Iterator[npt.NDArray[Any]]:
        """Yield the codes of all queries in blocks, from those that are kept or encoded now."""
        if kept is not None:
            yield from (kept[start : start + self._size] for start in range(0, len(self._queries), self._size))
            return
        for block in self._queries.blocks(self._size):
            yield self._encode_block(block)
            del block  # or it would be held while the next one is decoded

    def _encode_block(self, block: Images) -> npt.NDArray[Any]:
        with self._stopwatch.lap() as lap:
            codes = require_codes(self._scorer.encode(block), len(block))
        self.method_seconds += lap[0]
        return codes

    def _keep_answer(self, n_queries: int, answer: Answer) -> None:
        """Keep the outcome, the best places and, of a small map, the scores of the next queries."""
        right = self._positives[self._done : self._done + n_queries]
        if isinstance(answer, Nearest):
            scores, places = require_scores(answer.similarity, self._done), _fill_missing(answer.places)
            self._outcomes.append(outcome_of_best(scores, answer.places, right, self._n_places))
        else:
            wanted, shape = (n_queries, self._n_places), np.shape(answer)
            if shape != wanted:
                raise BadInput(f"the method gave scores of shape {shape}; wanted {wanted}, one for each place")
            all_scores = require_scores(answer, self._done)
            self._outcomes.append(judge_scores(all_scores, right))
            places, scores = rank_places(all_scores, self._depth)
            if self.scores is not None:
                self.scores[self._done : self._done + n_queries] = all_scores
        self._places.append(places)
        self._scores.append(scores)
        self._done += n_queries


def describe_search(method: Method, queries: Images) -> dict[str, Any] | None:
    """Return by which index a method searches, and the share of exact search's places that it finds for a sample."""
    exact = asdict(Audit(1.0, 1.0))
    if isinstance(method, BinaryMethod) and method.bytes_per_place is not None:
        return {"index": "exact", "bytes_per_place": method.bytes_per_place, **exact}
    if not isinstance(method, DescriptorMethod) or method.searched is None:
        return None
    index = method.searched
    found = {"index": index.kind, "bytes_per_place": index.bytes_per_place}
    if index.kind == "exact":
        return {**found, **exact}
    audit = asdict(method.audit(encode_sample(method, queries)))
    return {**found, **audit, "rerank": index.rerank, "build_seconds": index.build_seconds}


def _fill_missing(places: npt.NDArray[np.int64]) -> npt.NDArray[np.int32]:
    """Return best places, (n_queries, n), with the lowest places that are not among them where there is none (-1)."""
    named = places.astype(np.int32)
    for query in np.flatnonzero((places < 0).any(axis=1)):
        none = places[query] < 0
        named[query, none] = np.setdiff1d(np.arange(len(none)), places[query])[: np.count_nonzero(none)]
    return named
