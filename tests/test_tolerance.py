from __future__ import annotations

import numpy as np
import pytest

from vprbench.interface import BadInput
from vprbench.metrics import recall_at
from vprbench.ranking import best_places, outcome
from vprbench.tolerance import hits_within


def top(*places: int) -> np.ndarray:
    return np.array([places], np.int32)


def scores(*values: float) -> np.ndarray:
    return np.array([values], np.float32)


def right(*places: int) -> tuple[np.ndarray, ...]:
    return (np.array(places, np.int64),)


def ranked(matrix: np.ndarray, depth: int) -> tuple[np.ndarray, np.ndarray]:
    """The best places of each query, best first, and their scores, as a run stores them."""
    best = best_places(matrix, depth)
    order = np.argsort(-np.take_along_axis(matrix, best, 1), axis=1, kind="stable")
    best = np.take_along_axis(best, order, 1)
    return best.astype(np.int32), np.take_along_axis(matrix, best, 1)


def coarse_matrix(seed: int, n_queries: int, n_places: int) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
    """Scores of which many tie, and zero to three right places a query."""
    random = np.random.default_rng(seed)
    matrix = random.integers(0, 6, (n_queries, n_places)).astype(np.float32)
    matrix[random.random(matrix.shape) < 0.1] = -np.inf
    matrix[0] = -np.inf
    positives = tuple(np.sort(random.choice(n_places, count, False)) for count in random.integers(0, 4, n_queries))
    return matrix, positives


def test_a_best_place_is_right_from_the_tolerance_on_that_reaches_it() -> None:
    hits = hits_within(top(4, 2), scores(0.9, 0.8), right(2), [0, 1, 2, 3])
    assert hits.tolist() == [[0], [0], [1], [1]]


def test_the_nearest_of_several_right_places_counts() -> None:
    assert hits_within(top(7), scores(0.5), right(0, 9, 30), [1, 2]).tolist() == [[0], [1]]


def test_places_that_tie_for_the_best_count_by_the_share_of_right_ones() -> None:
    hits = hits_within(top(3, 7, 20, 4), scores(0.5, 0.5, 0.5, 0.4), right(4), [0, 1, 3])
    np.testing.assert_allclose(hits, [[0], [1 / 3], [2 / 3]])


def test_of_more_ties_than_are_stored_only_the_stored_ones_count() -> None:
    matrix = np.zeros((1, 10), np.float32)
    hits = hits_within(*ranked(matrix, 4), right(0), [0, 1])  # stored: places 0 to 3
    assert hits.tolist() == [[1 / 4], [2 / 4]]


def test_the_traverse_is_no_circle() -> None:
    assert hits_within(top(9), scores(0.5), right(0), [1, 8, 9]).tolist() == [[0], [0], [1]]


@pytest.mark.parametrize(("best", "positives"), [(scores(0.5, 0.4), right()), (scores(-np.inf, -np.inf), right(1))])
def test_a_query_without_a_right_place_or_a_candidate_is_a_miss(
    best: np.ndarray, positives: tuple[np.ndarray, ...]
) -> None:
    assert hits_within(top(1, 0), best, positives, [0, 100]).tolist() == [[0], [0]]


@pytest.mark.parametrize("seed", range(5))
def test_hits_agree_with_whole_score_matrices_under_widened_ground_truth(seed: int) -> None:
    n_queries, n_places = 30, 12
    matrix, positives = coarse_matrix(seed, n_queries, n_places)
    for tolerance in (0, 1, 2, 5, 20):
        expected = []
        for row, places in zip(matrix, positives, strict=True):
            widened = {near for place in places for near in range(place - tolerance, place + tolerance + 1)}
            best = [place for place in range(n_places) if row[place] == row.max() > -np.inf]
            expected.append(sum(place in widened for place in best) / len(best) if best else 0.0)
        hits = hits_within(*ranked(matrix, n_places), positives, [tolerance])
        np.testing.assert_allclose(hits[0], expected)


def test_without_tolerance_the_mean_is_recall_at_1() -> None:
    matrix, positives = coarse_matrix(7, 200, 12)
    hits = hits_within(*ranked(matrix, 12), positives, [0])
    recall = recall_at(outcome(matrix, positives), 1)
    assert recall is not None
    assert hits.mean() == pytest.approx(recall.expected)


def test_a_tolerance_below_0_is_refused() -> None:
    with pytest.raises(BadInput, match="tolerance of -1 places is not defined"):
        hits_within(top(1), scores(0.5), right(1), [0, -1])


def test_parts_of_different_runs_are_refused() -> None:
    with pytest.raises(ValueError, match="same queries and depth"):
        hits_within(top(1), scores(0.5), (*right(1), *right(2)), [0])
    with pytest.raises(ValueError, match="same queries and depth"):
        hits_within(top(1, 2), scores(0.5), right(1), [0])
