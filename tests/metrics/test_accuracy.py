"""The metrics, under wider tolerances too, on cases worked by hand, against slow enumeration and scikit-learn."""

import csv
import json
from dataclasses import replace
from itertools import permutations, product
from math import comb

import numpy as np
import pytest
from checkout import SHARED
from little import a_run, unanswerable_run
from sklearn import metrics as sklearn_metrics

from vprbench.errors import BadInput
from vprbench.metrics import accuracy
from vprbench.metrics.ranking import judge_scores, rank_places
from vprbench.runs import frame, rows
from vprbench.runs.store import Store

INF = np.inf


def places(*rows):
    return [np.array(row, np.int64) for row in rows]


def scored(*rows):
    return np.array(rows, np.float32)


def best_matches(*matches):
    """One query per match: the score of its best place and whether that is right (None: no place is)."""
    right = {True: [0], False: [1], None: []}
    return judge_scores(scored(*([best, -9, -9] for best, _ in matches)), places(*(right[r] for _, r in matches)))


def random_case(seed, n_queries, n_places, levels):
    """Scores of few levels, so that many tie, some no candidates; some queries without a right place."""
    random = np.random.default_rng(seed)
    scores = random.integers(levels, size=(n_queries, n_places)).astype(np.float32)
    scores[random.random(scores.shape) < 0.1] = -INF
    return scores, [np.flatnonzero(random.random(n_places) < 0.3) for _ in range(n_queries)]


# Three right, one wrong and one query without a right place, in falling confidence.
WORKED = best_matches((0.9, True), (0.8, True), (0.7, False), (0.6, True), (0.5, None))


@pytest.mark.parametrize("levels", [1, 2, 4])
def test_hits_are_the_mean_worst_and_best_over_all_orders_of_tied_places(levels):
    scores, positives = random_case(levels, 20, 5, levels)
    found = judge_scores(scores, positives)
    for n in range(1, 7):
        hits = []
        for row, right in zip(scores, positives, strict=True):
            orders = []
            for order in permutations(range(5)):
                ranked = sorted((place for place in order if row[place] > -INF), key=lambda p, r=row: -r[p])
                orders.append(bool(set(ranked[:n]) & set(right.tolist())))
            hits.append((np.mean(orders), min(orders), max(orders)))
        recall = accuracy.compute_recall(found, n)
        for way, wanted in zip(("expected", "pessimistic", "optimistic"), np.array(hits).T, strict=True):
            assert accuracy.count_hits(found, n, way) == pytest.approx(wanted, abs=1e-12)
            assert getattr(recall, way) == pytest.approx(wanted.mean(), abs=1e-12)


@pytest.mark.parametrize(
    ("above", "tied", "correct", "n"),
    [(0, 27592, 1, 20), (10, 40, 7, 11), (11, 40, 7, 11), (5, 6, 2, 11)],
)
def test_hits_of_ties_across_the_boundary_follow_the_binomial_formula(above, tied, correct, n):
    row = np.zeros(30_000, np.float32)
    row[:above] = 2
    row[above : above + tied] = 1
    found = judge_scores(row[None], [np.arange(above, above + correct)])
    slots = n - above
    only_wrong = comb(tied - correct, slots) / comb(tied, slots) if slots > 0 else 1
    assert accuracy.count_hits(found, n)[0] == pytest.approx(1 - only_wrong, abs=1e-13)


def test_recall_is_over_all_or_over_answerable_queries():
    assert accuracy.compute_recall(WORKED, 1) == accuracy.compute_recall(WORKED, 1, "all")
    assert accuracy.compute_recall(WORKED, 1) == accuracy.Recall(3 / 5, 3 / 5, 3 / 5, 5)
    assert accuracy.compute_recall(WORKED, 1, "answerable") == accuracy.Recall(3 / 4, 3 / 4, 3 / 4, 4)
    flagged = [accuracy.Recall(0.5, 0.5, 0.5 + 1 / n, n).hangs_on_ties for n in (200, 199)]
    assert flagged == [False, True]  # half a point between the ways to break ties is not yet flagged


@pytest.mark.parametrize(
    ("scores", "right", "error", "named"),
    [
        (scored([0, 0], [np.nan, 0]), [[0], [0]], BadInput, "1 of 2 .* NaN .*query 1"),
        (np.array([[0, 0], [1e300, 0]]), [[0], [0]], BadInput, r"1 of 2 .*\+inf .*query 1"),  # beyond float32
        *((np.zeros((2, 3)), [[0], [1, place]], BadInput, f"query 1 .* {place},") for place in (-1, 3)),
        (np.zeros((2, 3)), [[0]] * 3, ValueError, "2 queries .* 3"),
    ],
)
def test_scores_and_places_that_cannot_be_are_refused_by_name(scores, right, error, named):
    for judge in (judge_scores, accuracy.pr_curve_multi):
        with pytest.raises(error, match=named):
            judge(scores, places(*right))


@pytest.mark.parametrize("seed", range(3))
def test_the_single_match_curves_are_the_mean_over_all_choices_among_tied_places(seed):
    scores, positives = random_case(seed, 6, 4, 3)
    best = scores.max(axis=1)
    ties = [np.flatnonzero((row == row.max()) & (row > -INF)) for row in scores]
    choices = list(product(*(tied if len(tied) else [None] for tied in ties)))
    curve = accuracy.compute_pr_curve(judge_scores(scores, positives), "A")
    for precision, recall, threshold in zip(curve.precision[1:], curve.recall[1:], curve.threshold[1:], strict=True):
        kept = [query for query in range(6) if best[query] >= threshold]
        right = [sum(chosen[query] in positives[query].tolist() for query in kept) for chosen in choices]
        assert precision == pytest.approx(np.mean(right) / len(kept), abs=1e-12)
        assert recall == pytest.approx(np.mean(right) / sum(len(row) > 0 for row in positives), abs=1e-12)
    found = judge_scores(*random_case(seed, 60, 5, 6))
    area_a, area_b = (accuracy.auc(accuracy.compute_pr_curve(found, kind)) for kind in ("A", "B"))
    assert area_a == pytest.approx(accuracy.compute_recall(found, 1, "answerable").expected * area_b, abs=1e-12)


def assert_that_of_scikit_learn(curve, right, scores):
    precision, recall, threshold = sklearn_metrics.precision_recall_curve(right, scores)
    np.testing.assert_allclose(curve.precision, precision[::-1], atol=1e-12)
    np.testing.assert_allclose(curve.recall, recall[::-1], atol=1e-12)
    np.testing.assert_array_equal(curve.threshold[1:], threshold[::-1])
    assert accuracy.average_precision(curve) == pytest.approx(
        sklearn_metrics.average_precision_score(right, scores), abs=1e-12
    )
    assert accuracy.auc(curve) == pytest.approx(sklearn_metrics.auc(recall, precision), abs=1e-12)


@pytest.mark.parametrize("decimals", [6, 1])
def test_curve_b_and_its_areas_are_those_of_scikit_learn(decimals):
    random = np.random.default_rng(decimals)
    best, right = random.random(80).round(decimals).astype(np.float32), random.random(80) < 0.6
    found = best_matches(*zip(best.tolist(), right.tolist(), strict=True))
    assert_that_of_scikit_learn(accuracy.compute_pr_curve(found, "B"), right, best)
    assert accuracy.auc_roc(found) == pytest.approx(sklearn_metrics.roc_auc_score(right, best), abs=1e-12)


@pytest.mark.parametrize("levels", [3, 1000])
def test_the_multi_match_curve_is_that_of_scikit_learn_over_all_pairs(levels):
    random = np.random.default_rng(levels)
    scores = random.integers(levels, size=(20, 15)).astype(np.float32)
    right = random.random(scores.shape) < 0.2
    curve = accuracy.pr_curve_multi(scores, [np.flatnonzero(row) for row in right])
    assert_that_of_scikit_learn(curve, right.ravel(), scores.ravel())


NINES = scored([9, 0, 0], [8, 8, 0], [7, 0, 0])


@pytest.mark.parametrize(
    ("found", "expected"),
    [
        (WORKED, [11 / 16, 1 / 2 + 17 / 96, 11 / 12, 2 / 4, 3 / 5, 5 / 6, 5 / 6, 3 / 4]),
        (best_matches((0.9, None), (0.8, True)), [1 / 2, 1 / 4, 1 / 2, 0, 1 / 2, 0, 0, 2 / 3]),
        (best_matches((0.5, True), (0.5, False)), [1 / 4, 3 / 8, 1 / 2, 0, 1 / 2, 1 / 4, 1 / 2, 1 / 2]),
        # what ties with an error does not count as free of error
        (
            best_matches((0.9, True), (0.8, True), (0.8, False), (0.7, True)),
            [29 / 48, 61 / 96, 29 / 36, 1 / 4, 3 / 4, 2 / 3, 1 / 2, 3 / 4],
        ),
        # nor does an answer whose best place ties with a wrong one
        (judge_scores(NINES, places([0], [0], [0])), [53 / 72, 107 / 144, 53 / 60, 1 / 3, 5 / 6, 7 / 10, 1 / 2, 5 / 6]),
        (judge_scores(NINES, places([0], [0, 1], [0])), [1, 1, 1, 1, 1, 1, None, 1]),
        (best_matches((0.9, True), (0.8, False)), [1 / 2, 1 / 2, 1, 1 / 2, 1 / 2, 1, 1, 2 / 3]),
        (judge_scores(scored([1, 0], [-INF, -INF]), places([0], [0])), [1 / 2, 1 / 2, 1, 1 / 2, 1, 1, None, 2 / 3]),
        (best_matches((0.9, False), (0.8, False)), [0, 0, None, 0, 0, 0, None, 0]),
        (best_matches((0.9, None), (0.8, None)), [None] * 8),
        (judge_scores(np.zeros((0, 3), np.float32), []), [None] * 8),
    ],
)
def test_the_single_numbers_of_worked_cases(found, expected):
    """These are AP and area of curve A, AP of curve B, R@100P, P@100R, EP, AUC-ROC and F1."""
    a, b = accuracy.compute_pr_curve(found, "A"), accuracy.compute_pr_curve(found, "B")
    areas = ((accuracy.average_precision, a), (accuracy.auc, a), (accuracy.average_precision, b))
    numbers = [None if curve is None else area(curve) for area, curve in areas]
    names = ("recall_at_full_precision", "precision_at_full_recall", "extended_precision", "auc_roc", "f1_max")
    numbers += [getattr(accuracy, name)(found) for name in names]
    assert numbers == pytest.approx(expected, abs=1e-12)
    assert (accuracy.compute_recall(found, 1) is None) == (expected[3] is None)


def test_pairs_of_worked_cases():
    assert accuracy.pr_curve_multi(np.zeros((2, 3), np.float32), places([], [])) is None
    curve = accuracy.pr_curve_multi(scored([2, -INF], [1, -INF]), places([0, 1], [1]))
    np.testing.assert_array_equal(curve.recall, [0, 1 / 3, 1 / 3])  # a right pair that is no candidate
    np.testing.assert_array_equal(curve.precision, [1, 1, 1 / 2])


CORRIDOR = SHARED / "data" / "corridor"
STORED = [
    *("AMOSNet", "HybridNet", "NetVLAD", "denseVLAD", "ap-gem-r101"),
    *("AlexNet_VPR", "RegionVLAD", "CoHOG", "HOG", "CALC"),
]


@pytest.mark.real_frames
@pytest.mark.parametrize("technique", STORED)
def test_numbers_of_scores_that_vpr_bench_stored_are_those_of_the_authors_and_swapped_axes_give_others(technique):
    expected = json.loads((SHARED / "oracles" / "vprbench_corridor.json").read_text())["corridor"][technique]
    with np.load(CORRIDOR / "vprbench_precomputed.npz") as arrays:
        scores, match, best = (arrays[f"{technique}__{name}"] for name in ("similarity", "match", "score"))
    with (CORRIDOR / "ground_truth.csv").open(newline="") as rows:
        positives = places(*(row["matching_refs"].split() for row in csv.DictReader(rows)))
    found = judge_scores(scores, positives)
    for n in (1, 5, 10, 20):
        recall = accuracy.compute_recall(found, n)
        assert recall.expected == recall.pessimistic == recall.optimistic == expected[f"R@{n}"]
        assert recall.n_queries == expected["nq"]
    right = [int(place) in row for place, row in zip(match, positives, strict=True)]
    np.testing.assert_array_equal(accuracy.count_hits(found, 1), right)
    assert (found.top_tied == 1).all()
    np.testing.assert_allclose(found.best_score, best, rtol=1e-6, atol=0)
    of_references = [[query for query, row in enumerate(positives) if place in row] for place in range(scores.shape[1])]
    swapped = accuracy.compute_recall(judge_scores(scores.T, places(*of_references)), 1)
    assert expected["R@1"] != swapped.expected == expected["wrong_axis_R1"]

    curve_a, curve_b = accuracy.compute_pr_curve(found, "A"), accuracy.compute_pr_curve(found, "B")
    assert accuracy.auc(curve_b) == pytest.approx(expected["aucpr_sklearn"], abs=1e-9)
    assert accuracy.average_precision(curve_b) == pytest.approx(expected["ap"], abs=1e-9)
    assert accuracy.auc(curve_a) == pytest.approx(expected["auc_A_exact"], abs=1e-9)
    precision = accuracy.precision_at_full_recall(found)
    assert curve_b.precision[-1] == precision == pytest.approx(expected["p_at_full_recall_idx0"], abs=1e-12)
    assert accuracy.auc_roc(found) == pytest.approx(expected["aucroc"], abs=1e-9)
    assert accuracy.extended_precision(found) == pytest.approx(expected["ep"], abs=1e-9)
    assert accuracy.recall_at_full_precision(found) == expected["R100P_exact_all"]


GAPS = np.array([0, 1, 2, 5, 6])  # 3 and 4 are not in the map


def test_the_best_places_of_a_query_are_right_from_the_tolerance_on_that_reaches_them():
    for best, scored, right, tolerances, numbers, wanted in (
        ([4, 2], [0.9, 0.8], [2], [0, 1, 2, 3], None, [0, 0, 1, 1]),
        ([3], [0.5], [2], [1, 2, 3], GAPS, [0, 0, 1]),
        ([4], [0.5], [3], [1], GAPS, [1]),
        ([7], [0.5], [0, 9, 30], [1, 2], None, [0, 1]),  # the nearest counts
        ([9], [0.5], [0], [1, 8, 9], None, [0, 0, 1]),  # the route is no circle
        ([3, 7, 20, 4], [0.5, 0.5, 0.5, 0.4], [4], [0, 1, 3], None, [0, 1 / 3, 2 / 3]),  # ties
        ([1, 0], [0.5, 0.4], [], [0, 100], None, [0, 0]),
        ([1, 0], [-INF, -INF], [1], [0, 100], None, [0, 0]),
    ):
        given = np.array([best], np.int32), np.array([scored], np.float32), (np.array(right, np.int64),)
        np.testing.assert_allclose(accuracy.count_hits_within(*given, tolerances, numbers)[:, 0], wanted)


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
        found = accuracy.count_hits_within(*rank_places(matrix, n_places), positives, [tolerance])
        np.testing.assert_allclose(found[0], expected)


def test_of_more_tied_places_than_are_ranked_the_first_stand_in_their_order():
    places, scores = rank_places(np.array([[0, 3, 0, 3, 3, 0, 5, 3]], np.float32), 4)
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
