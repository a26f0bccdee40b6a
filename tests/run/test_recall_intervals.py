"""Intervals of stored runs: over the seeds, in the order of the journey."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from little import unanswerable_run
from stored_runs import run

from vprbench.metrics.intervals import share_interval
from vprbench.run.recall_intervals import along_the_journey, recall_interval
from vprbench.run.record import Run

HITS = np.repeat([1, 0, 1, 1, 0, 0, 1, 0, 1, 1], 20)


def shown(*places: list[int]) -> Run:
    return run(hits=[1] * len(places), positives=tuple(np.array(each, np.int64) for each in places))


def test_queries_stand_in_the_order_of_their_first_right_place_and_equals_in_their_own() -> None:
    assert along_the_journey(shown([4], [0, 9], [4, 1], [4])).tolist() == [1, 2, 0, 3]


def test_a_query_without_a_right_place_stays_behind_the_one_before_it() -> None:
    assert along_the_journey(shown([], [5], [], [], [2])).tolist() == [0, 4, 1, 2, 3]


def test_places_are_counted_along_the_journey_where_the_map_is_in_another_order() -> None:
    numbered = replace(shown([0], [1], [2]), place_numbers=np.array([7, 3, 5, *range(10, 17)]))
    assert along_the_journey(numbered).tolist() == [1, 2, 0]


def test_shuffled_queries_have_the_interval_of_those_in_order() -> None:
    order = np.random.default_rng(0).permutation(200)
    places = tuple(np.array([place]) for place in order)
    mixed = run(hits=HITS[order].tolist(), n_places=200, positives=places)
    assert recall_interval([mixed]) == recall_interval([run(hits=HITS.tolist(), n_places=200)]) == share_interval(HITS)


def test_several_seeds_have_the_interval_of_their_mean_hits() -> None:
    seeds = [run(seed=0, hits=HITS.tolist(), n_places=200), run(seed=1, hits=HITS[::-1].tolist(), n_places=200)]
    assert recall_interval(seeds) == share_interval((HITS + HITS[::-1]) / 2)


def test_without_a_right_place_there_is_no_interval() -> None:
    assert recall_interval([unanswerable_run()]) is None


@pytest.mark.parametrize("n_queries", [1, 4, 19])
def test_few_queries_have_wilsons_interval(n_queries: int) -> None:
    found = recall_interval([run(hits=[1] * n_queries)])
    assert found is not None
    assert found.kind == "independent"
    assert found.low == pytest.approx(n_queries / (n_queries + 1.959964**2), abs=1e-6)
