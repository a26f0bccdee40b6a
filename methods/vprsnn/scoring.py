"""Which place each neuron speaks for, and how well each place fits a query by the spikes of its neurons."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import sparse

from vprbench.api import Places, Scores

Spikes = npt.NDArray[np.integer[Any]]  # (n_queries, n_modules, n_neurons) spikes
Mask = npt.NDArray[np.bool_]  # (n_modules, n_neurons)

_LEAST_PART = 10  # a neuron speaks for a place that drew more than a 10th of its spikes in training
_FEW_PLACES = 50  # one that fired for a 50th of all places or more is divided by the number of those
_BLOCK_CELLS = 1 << 22  # responses taken at once: bounds the memory


@dataclass(frozen=True)
class Responses:
    """What the neurons of one or more modules responded to; a module's labels number its own places from 0."""

    sums: npt.NDArray[np.float32]  # (n_modules, n_neurons, n_labels) spikes in the presentations of a label
    shown: npt.NDArray[np.int64]  # (n_modules, n_labels) those presentations
    places: npt.NDArray[np.int64]  # (n_modules, n_labels) the place of each label; -1: the module has fewer

    @property
    def n_places(self) -> int:
        """The number of places, 0 to n_places - 1."""
        return int(self.places.max()) + 1


def assign_places(learnt: Responses) -> npt.NDArray[np.int64]:
    """Return the place to which each neuron gave most spikes a presentation, (n_modules, n_neurons); -1: it gave none.

    Of equals it is the module's first.
    """
    means = learnt.sums / np.maximum(learnt.shown, 1)[:, None, :]
    best = means.argmax(axis=2)
    fired = means.max(axis=2) > 0
    return np.where(fired, np.take_along_axis(learnt.places, best, axis=1), -1)


def score_standard(responses: Spikes, labels: npt.NDArray[np.int64], silenced: Mask, n_places: int) -> Scores:
    """Return the mean spikes of the neurons of each place, (n_queries, n_places); 0 for a place that has none.

    `labels` (n_modules, n_neurons) are the places that the neurons speak for, -1: none. Spikes of a silenced neuron do
    not count, but the mean is over it too.
    """
    labels = labels.ravel()
    assigned = np.bincount(labels[labels >= 0], minlength=n_places)
    heard = np.flatnonzero((labels >= 0) & ~silenced.ravel())
    speaks = sparse.csr_array((np.ones(len(heard)), (heard, labels[heard])), (len(labels), n_places))
    return _score_by_blocks(lambda spikes: (spikes @ speaks).toarray() / np.maximum(assigned, 1), responses, n_places)


def score_weighted(responses: Spikes, learnt: Responses, silenced: Mask, n_places: int) -> Scores:
    """Return the weighted spikes of the neurons of each place, (n_queries, n_places); 0 for a place that has none.

    A neuron speaks for each place that drew more than 0.1 of its spikes in training, and its spikes are weighed by that
    share. If it fired for 0.02 of all places or more they are divided by the number of those. A place's sum is
    multiplied by the share of its training spikes that came from the neurons that fire now; silenced ones never do.
    Source: Hussaini, Milford and Fischer, RA-L 2022 (QVPR/VPRSNN, weighted assignments).
    """
    drawn = learnt.sums.astype(np.float64)
    totals = drawn.sum(axis=2, keepdims=True)
    fired_for = np.count_nonzero(drawn, axis=2, keepdims=True)
    divisor = totals * np.where(fired_for * _FEW_PLACES >= n_places, fired_for, 1)
    modules, neurons, own = np.nonzero(drawn * _LEAST_PART > totals)
    cells = modules * drawn.shape[1] + neurons, learnt.places[modules, own]
    spikes_for = drawn[modules, neurons, own]
    heard = ~silenced[modules, neurons]

    def spread_neurons(values: npt.NDArray[np.float64]) -> sparse.csr_array:
        return sparse.csr_array((values, cells), (silenced.size, n_places))

    weights = spread_neurons(heard * spikes_for / divisor[modules, neurons, 0])
    training = spread_neurons(heard * spikes_for)
    every = np.bincount(cells[1], spikes_for, n_places)
    every[every == 0] = 1

    def score(spikes: sparse.csr_array) -> npt.NDArray[np.float64]:
        return np.asarray((spikes @ weights).toarray() * (spikes.sign() @ training).toarray() / every)

    return _score_by_blocks(score, responses, n_places)


def _score_by_blocks(
    score: Callable[[sparse.csr_array], npt.NDArray[np.float64]], responses: Spikes, n_places: int
) -> Scores:
    """Score queries some at a time; few neurons fire for a query, so their spikes are a sparse matrix."""
    n_queries, n_modules, n_neurons = responses.shape
    scores = np.empty((n_queries, n_places), np.float32)
    together = max(1, _BLOCK_CELLS // max(n_modules * n_neurons, n_places))
    for first in range(0, n_queries, together):
        block = slice(first, first + together)
        scores[block] = score(sparse.csr_array(responses[block].reshape(-1, n_modules * n_neurons)))
    return scores


def normalise_scores(scores: Scores) -> Scores:
    """Return the scores of each query less its lowest, divided by their sum; where all are equal they stay as they are.

    It leaves the order of a query's places as it is, and makes the scores of queries comparable.
    """
    lowest = scores.min(axis=1, keepdims=True)
    differ = scores.max(axis=1) > lowest[:, 0]
    result = scores.copy()
    result[differ] -= lowest[differ]
    result[differ] /= result[differ].sum(axis=1, keepdims=True)
    return result


def mark_silent_queries(scores: Scores, responses: npt.NDArray[Any]) -> Scores:
    """Return the scores with -inf for every place where `responses` (n_queries, ...), of neurons that count, are all 0.

    A silent query recognises no place; equal scores would make it a guess.
    """
    spoke = responses.any(axis=tuple(range(1, responses.ndim)))
    return np.where(np.expand_dims(spoke, 1), scores, np.float32(-np.inf))


def choose_threshold(scores_of: Callable[[int], Scores], right: Places, candidates: Sequence[int]) -> int:
    """Return the candidate with the highest recall at 1, of equals the first.

    `right` (n_queries,) are the right places. A query whose best place is tied counts as wrong.
    """

    def count_hits(threshold: int) -> int:
        scores, queries = scores_of(threshold).copy(), np.arange(len(right))
        own = scores[queries, right]
        scores[queries, right] = -np.inf
        return int((own > scores.max(axis=1)).sum())

    return max(candidates, key=count_hits)
