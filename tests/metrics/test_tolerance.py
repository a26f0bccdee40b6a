"""Recall at 1 under wider tolerances: of one query, of whole matrices, and of a run whose dataset asks for them."""

from dataclasses import replace

import numpy as np
from little import a_run, unanswerable_run

from vprbench.metrics.accuracy import hits_within
from vprbench.metrics.ranking import ranked_places
from vprbench.runs import frame, rows
from vprbench.runs.store import Store

GAPS = np.array([0, 1, 2, 5, 6])  # 3 and 4 are not in the map
LOST = -np.inf


def test_the_best_places_of_a_query_are_right_from_the_tolerance_on_that_reaches_them():
    for best, scored, right, tolerances, numbers, wanted in (
        ([4, 2], [0.9, 0.8], [2], [0, 1, 2, 3], None, [0, 0, 1, 1]),
        ([3], [0.5], [2], [1, 2, 3], GAPS, [0, 0, 1]),
        ([4], [0.5], [3], [1], GAPS, [1]),
        ([7], [0.5], [0, 9, 30], [1, 2], None, [0, 1]),  # the nearest counts
        ([9], [0.5], [0], [1, 8, 9], None, [0, 0, 1]),  # the route is no circle
        ([3, 7, 20, 4], [0.5, 0.5, 0.5, 0.4], [4], [0, 1, 3], None, [0, 1 / 3, 2 / 3]),  # ties
        ([1, 0], [0.5, 0.4], [], [0, 100], None, [0, 0]),
        ([1, 0], [LOST, LOST], [1], [0, 100], None, [0, 0]),
    ):
        given = np.array([best], np.int32), np.array([scored], np.float32), (np.array(right, np.int64),)
        np.testing.assert_allclose(hits_within(*given, tolerances, numbers)[:, 0], wanted)


def test_hits_agree_with_whole_score_matrices_under_widened_ground_truth():
    random = np.random.default_rng(0)
    n_queries, n_places = 100, 12
    matrix = random.integers(0, 6, (n_queries, n_places)).astype(np.float32)  # many tie
    matrix[random.random(matrix.shape) < 0.1] = -np.inf
    matrix[0] = -np.inf
    positives = tuple(np.sort(random.choice(n_places, count, False)) for count in random.integers(0, 4, n_queries))
    for tolerance in (0, 1, 2, 5, 20):
        expected = []
        for row, places in zip(matrix, positives, strict=True):
            widened = {near for place in places for near in range(place - tolerance, place + tolerance + 1)}
            best = [place for place in range(n_places) if row[place] == row.max() > -np.inf]
            expected.append(sum(place in widened for place in best) / len(best) if best else 0.0)
        found = hits_within(*ranked_places(matrix, n_places), positives, [tolerance])
        np.testing.assert_allclose(found[0], expected)


def test_of_more_tied_places_than_are_ranked_the_first_stand_in_their_order():
    places, scores = ranked_places(np.array([[0, 3, 0, 3, 3, 0, 5, 3]], np.float32), 4)
    assert (places.tolist(), scores.tolist()) == ([[6, 1, 3, 4]], [[5, 3, 3, 3]])


# The tolerances that a dataset asks for beside its own. Of `a_run` the best places are 0, 1, 9 and 7, the right ones
# 0, 1 or 5, 2 and 3: they lie 0, 0, 7 and 4 places away.


def sweep(*also, own=0, **changes):
    return a_run(protocol={"query": "dusk", "tolerance_places": own, "also_tolerance_places": [*also]}, **changes)


def test_a_summary_holds_recall_at_1_within_the_tolerances_that_were_asked_for():
    assert frame.recall_at_1_within(sweep(1, 4, 7)) == {1: 0.5, 4: 0.75, 7: 1.0}
    assert rows.describe_wider_recall(sweep(1, 4, 7)) == "R@1 within 1, 4, 7 places: 50.0 / 75.0 / 100.0 %"
    assert frame.list_numbers(sweep(1, 4))["recall_at_1_within_4_places"] == 0.75
    assert set(frame.recall_at_1_within(sweep(1, 2, 3, own=2))) == {3}
    assert (frame.recall_at_1_within(a_run()), rows.describe_wider_recall(a_run())) == ({}, None)
    assert not [name for name in frame.list_numbers(a_run()) if "within" in name]
    lost = replace(unanswerable_run(), protocol=sweep(1, 2).protocol)  # undefined and not zero
    assert frame.recall_at_1_within(lost) == {1: None, 2: None}
    assert rows.describe_wider_recall(lost) == "R@1 within 1, 2 places: - / - %"


def test_tolerances_count_from_the_right_place_and_not_from_the_end_of_the_datasets_own():
    # Under a tolerance of 1 the right places of the last two queries are 1 to 3 and 2 to 4, so the best of the last one
    # lies 3 places beyond those and 4 from the middle.
    positives = (np.array([0, 1]), np.array([0, 1, 2]), np.array([1, 2, 3]), np.array([2, 3, 4]))
    assert frame.recall_at_1_within(sweep(3, 4, own=1, positives=positives)) == {3: 0.5, 4: 0.75}


def test_the_numbers_of_places_are_stored_and_count_and_a_wider_ground_truth_with_gaps_has_no_wider_ones(tmp_path):
    store = Store(tmp_path)
    store.prepare()
    store.save(replace(sweep(4), place_numbers=np.arange(10) * 3))
    (read,) = store.runs()
    assert read.place_numbers.tolist() == [0, 3, 6, 9, 12, 15, 18, 21, 24, 27]
    assert frame.recall_at_1_within(read) == {4: 0.5}  # along the map the third query is within 4
    assert frame.recall_at_1_within(sweep(2, own=1, place_numbers=np.arange(10))) == {}
