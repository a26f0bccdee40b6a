"""The metrics on cases worked by hand, against slow enumeration of ties and against scikit-learn."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from itertools import permutations, product
from math import comb
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from sklearn.metrics import auc as sklearn_auc
from sklearn.metrics import average_precision_score, precision_recall_curve, roc_auc_score

from vprbench.errors import BadInput
from vprbench.metrics import ranking
from vprbench.metrics.accuracy import (
    PRCurve,
    Recall,
    auc,
    auc_roc,
    average_precision,
    extended_precision,
    f1_max,
    hits_at,
    pr_curve,
    pr_curve_multi,
    precision_at_full_recall,
    recall_at,
    recall_at_full_precision,
)
from vprbench.metrics.ranking import Outcome, concatenate, outcome

Matrix = npt.NDArray[np.float32]
Rows = list[npt.NDArray[np.int64]]
INF = np.inf


def places(*rows: list[int]) -> Rows:
    return [np.array(row, np.int64) for row in rows]


def scored(*rows: list[float]) -> Matrix:
    return np.array(rows, np.float32)


def best_matches(*matches: tuple[float, bool | None]) -> Outcome:
    """One query per match: the score of its best place and whether that is right (None: no place is)."""
    right = {True: [0], False: [1], None: []}
    return outcome(scored(*([best, -9, -9] for best, _ in matches)), places(*(right[r] for _, r in matches)))


def curve_of(found: PRCurve | None) -> PRCurve:
    assert found is not None
    return found


def recall_of(found: Recall | None) -> Recall:
    assert found is not None
    return found


def random_case(seed: int, n_queries: int, n_places: int, levels: int) -> tuple[Matrix, Rows]:
    """Scores of few levels, so that many tie, some no candidates; some queries without a right place."""
    random = np.random.default_rng(seed)
    scores = random.integers(levels, size=(n_queries, n_places)).astype(np.float32)
    scores[random.random(scores.shape) < 0.1] = -INF
    return scores, [np.flatnonzero(random.random(n_places) < 0.3) for _ in range(n_queries)]


# Three right, one wrong and one query without a right place, in falling confidence.
WORKED = best_matches((0.9, True), (0.8, True), (0.7, False), (0.6, True), (0.5, None))


def test_recall_over_all_and_over_answerable_queries_differ_by_the_unanswerable_ones() -> None:
    assert recall_at(WORKED, 1, "all") == Recall(3 / 5, 3 / 5, 3 / 5, 5)
    assert recall_at(WORKED, 1, "answerable") == Recall(3 / 4, 3 / 4, 3 / 4, 4)


@pytest.mark.parametrize(
    ("scores", "right", "ignored", "n", "hits"),
    [
        ([[3, 2, 1]] * 4, [[0], [1], [2], [1, 2]], None, 2, [1, 1, 0, 1]),
        ([[3, 2, 1], [1, 1, 1]], [[2], [1]], None, 100, [1, 1]),  # as many as there are places
        ([[1, -INF, -INF]], [[1]], None, 3, [0]),  # a right place that is no candidate
        ([[1, 1, 0], [1, 1, 0]], [[0], [0, 0]], None, 1, [0.5, 0.5]),  # named twice, it counts once
        ([[3, 2, 1]], [[1]], [[0, 1]], 1, [1]),  # the soft band is left out
        ([[np.finfo(np.float32).max, np.finfo(np.float32).min]], [[0]], None, 1, [1]),
    ],
)
def test_hits_of_worked_cases(
    scores: list[list[float]], right: list[list[int]], ignored: list[list[int]] | None, n: int, hits: list[float]
) -> None:
    given = scored(*scores)
    found = outcome(given, places(*right), None if ignored is None else places(*ignored))
    assert hits_at(found, n).tolist() == hits
    assert given.tolist() == scored(*scores).tolist()  # untouched
    assert recall_of(recall_at(found, n)).expected == pytest.approx(np.mean(hits))


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("levels", [1, 2, 4])
def test_hits_are_the_mean_worst_and_best_over_all_orders_of_tied_places(seed: int, levels: int) -> None:
    scores, positives = random_case(seed, 6, 5, levels)
    found = outcome(scores, positives)
    for n in range(1, 7):
        for query, row in enumerate(scores):
            hits = []
            for order in permutations(range(5)):
                ranked = sorted((place for place in order if row[place] > -INF), key=lambda p, r=row: -r[p])
                hits.append(bool(set(ranked[:n]) & set(positives[query].tolist())))
            assert hits_at(found, n)[query] == pytest.approx(np.mean(hits), abs=1e-12)
            assert hits_at(found, n, "pessimistic")[query] == min(hits)
            assert hits_at(found, n, "optimistic")[query] == max(hits)


@pytest.mark.parametrize(
    ("above", "tied", "correct", "n"),
    [
        (0, 40, 7, 11),
        (10, 40, 7, 11),
        (11, 40, 7, 11),
        (2, 500, 240, 20),
        (0, 9, 9, 1),
        (5, 6, 2, 11),
    ],
)
def test_hits_of_ties_across_the_boundary_follow_the_binomial_formula(
    above: int, tied: int, correct: int, n: int
) -> None:
    row = np.zeros(600, np.float32)
    row[:above] = 2
    row[above : above + tied] = 1
    found = outcome(row[None], [np.arange(above, above + correct)])
    slots = n - above
    only_wrong = comb(tied - correct, slots) / comb(tied, slots) if slots > 0 else 1
    assert hits_at(found, n)[0] == pytest.approx(1 - only_wrong, abs=1e-13)


def test_a_constant_output_is_right_once_in_as_many_places_as_there_are() -> None:
    found = outcome(np.zeros((3, 27592), np.float32), places([0], [500], [27591]))
    recall = recall_of(recall_at(found, 1))
    assert recall.expected == pytest.approx(1 / 27592, rel=1e-9)
    assert (recall.pessimistic, recall.optimistic) == (0, 1)
    assert recall_of(recall_at(found, 20)).expected == pytest.approx(20 / 27592, rel=1e-9)


def test_half_a_point_between_the_ways_to_break_ties_is_not_yet_flagged_and_more_is() -> None:
    def with_one_tie(n_queries: int) -> Recall:
        scores = np.tile(scored([1, 0]), (n_queries, 1))
        scores[0] = 1
        return recall_of(recall_at(outcome(scores, [np.array([0])] * n_queries), 1))

    assert not with_one_tie(200).hangs_on_ties
    assert with_one_tie(199).hangs_on_ties


def test_places_of_the_soft_band_count_as_if_they_did_not_exist() -> None:
    scores, positives = random_case(3, 40, 9, 4)
    band = [np.union1d(right, [2, 5]) for right in positives]
    for query, right in enumerate(positives):
        left = np.setdiff1d(np.arange(9), np.setdiff1d([2, 5], right))
        whole = outcome(scores[[query]], [right], [band[query]])
        smaller = outcome(scores[[query]][:, left], [np.searchsorted(left, right)])
        for n in (1, 2, 3):
            assert hits_at(whole, n)[0] == pytest.approx(hits_at(smaller, n)[0], abs=1e-12)
        assert whole.best_score == smaller.best_score
        assert (whole.top_tied, whole.top_tied_correct) == (smaller.top_tied, smaller.top_tied_correct)


def test_a_query_without_candidates_retrieves_nothing_but_stays_in_the_denominator() -> None:
    found = outcome(scored([1, 0], [-INF, -INF]), places([0], [0]))
    curve = curve_of(pr_curve(found, "A"))
    np.testing.assert_array_equal(found.top_tied, [1, 0])
    assert (curve.precision[-1], curve.recall[-1]) == (1, 0.5)
    assert recall_at(found, 2) == Recall(0.5, 0.5, 0.5, 2)
    assert recall_at_full_precision(found) == 0.5


UNREAL = ("complex64", "object", "U4", "S4", "datetime64[s]")


@pytest.mark.parametrize(
    ("scores", "right", "error", "named"),
    [
        *(([[0, 0], [value, 0]], [[0], [0]], BadInput, name) for value, name in ((np.nan, "NaN"), (INF, r"\+inf"))),
        (np.array([[0, 0], [1e300, 0]]), [[0], [0]], BadInput, r"\+inf"),  # beyond float32
        *((np.array([[1, 0], [0, 1]]).astype(kind), [[0], [1]], BadInput, "0 ") for kind in UNREAL),
        *(([[0, 0]] * 2, [[0], [1, place]], BadInput, f"query 1 .* {place},") for place in (-1, 3)),
        ([[0, 0]] * 2, [[0]] * 3, ValueError, "2 queries .* 3"),
        *((np.zeros(shape, np.float32), [[0]], ValueError, "scores") for shape in ((3,), (3, 0), (1, 3, 3))),
    ],
)
def test_scores_and_places_that_cannot_be_are_refused_by_name(
    scores: Any, right: list[list[int]], error: type[Exception], named: str
) -> None:
    given = np.array(scores, np.float32) if isinstance(scores, list) else scores
    for judge in (outcome, pr_curve_multi):
        with pytest.raises(error, match=named) as refused:
            judge(given, places(*right))
    if error is BadInput and "0 " in named:
        assert str(given.dtype) in str(refused.value)
    if named in ("NaN", r"\+inf"):
        assert "query 1" in str(refused.value)


@pytest.mark.parametrize(
    "refused",
    [
        lambda: concatenate([outcome(np.zeros((1, n), np.float32), places([0])) for n in (2, 3)]),
        lambda: pr_curve(WORKED, "C"),
        lambda: recall_at(WORKED, 1, "some"),
        lambda: hits_at(WORKED, 1, "lucky"),
        lambda: hits_at(WORKED, 0),
    ],
)
def test_unknown_names_a_rank_of_0_and_other_maps_are_refused(refused: Callable[[], object]) -> None:
    with pytest.raises((ValueError, BadInput)):
        refused()


@pytest.mark.parametrize("kind", ["bool", "uint8", "int64", "float16", "float64"])
def test_real_scores_of_any_type_are_ranked(kind: str) -> None:
    assert list(hits_at(outcome(np.array([[1, 0], [1, 0]]).astype(kind), places([0], [1])), 1)) == [1, 0]


def assert_same(first: Outcome, second: Outcome) -> None:
    assert first.n_places == second.n_places
    for name in vars(first):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name), err_msg=name)
        assert np.asarray(getattr(first, name)).dtype == np.asarray(getattr(second, name)).dtype


def test_blocks_of_queries_give_what_the_whole_gives(monkeypatch: pytest.MonkeyPatch) -> None:
    scores, positives = random_case(7, 50, 11, 5)
    band = [np.union1d(right, [4]) for right in positives]
    whole = outcome(scores, positives, band)
    parts = [outcome(scores[s : s + 7], positives[s : s + 7], band[s : s + 7]) for s in range(0, 50, 7)]
    assert_same(concatenate(parts), whole)
    monkeypatch.setattr(ranking, "_BLOCK_CELLS", 30)
    assert_same(outcome(scores, positives, band), whole)


def test_the_single_match_curves_of_the_worked_case() -> None:
    precision = [1, 1, 1, 2 / 3, 3 / 4, 3 / 5]
    recalls = {"A": [0, 1 / 4, 2 / 4, 2 / 4, 3 / 4, 3 / 4], "B": [0, 1 / 3, 2 / 3, 2 / 3, 1, 1]}
    for kind, recall in recalls.items():
        curve = curve_of(pr_curve(WORKED, kind))
        np.testing.assert_allclose(curve.precision, precision, atol=1e-15)
        np.testing.assert_allclose(curve.recall, recall, atol=1e-15)
        np.testing.assert_array_equal(curve.threshold, np.float32([INF, 0.9, 0.8, 0.7, 0.6, 0.5]))
        assert curve.kind == kind


@pytest.mark.parametrize("seed", range(5))
def test_the_single_match_curves_are_the_mean_over_all_choices_among_tied_places(seed: int) -> None:
    scores, positives = random_case(seed, 6, 4, 3)
    found = outcome(scores, positives)
    best = scores.max(axis=1)
    ties = [np.flatnonzero((row == row.max()) & (row > -INF)) for row in scores]
    choices = list(product(*(tied if len(tied) else [None] for tied in ties)))
    curve = curve_of(pr_curve(found, "A"))
    for precision, recall, threshold in zip(curve.precision[1:], curve.recall[1:], curve.threshold[1:], strict=True):
        right = [
            sum(
                score >= threshold and place in right_places.tolist()
                for score, place, right_places in zip(best, chosen, positives, strict=True)
            )
            for chosen in choices
        ]
        assert precision == pytest.approx(np.mean(right) / np.sum(best >= threshold), abs=1e-12)
        assert recall == pytest.approx(np.mean(right) / sum(len(row) > 0 for row in positives), abs=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_area_a_is_recall_at_1_times_area_b_also_with_ties_and_unanswerable_queries(seed: int) -> None:
    found = outcome(*random_case(seed, 60, 5, 6))
    area_a, area_b = (auc(curve_of(pr_curve(found, kind))) for kind in ("A", "B"))
    recall = recall_of(recall_at(found, 1, "answerable"))
    assert recall.expected < recall_of(recall_at(found, 5, "answerable")).expected
    assert area_a == pytest.approx(recall.expected * area_b, abs=1e-12)


@pytest.mark.parametrize(("seed", "decimals"), [(0, 6), (1, 1), (2, 1)])
def test_curve_b_and_its_areas_are_those_of_scikit_learn(seed: int, decimals: int) -> None:
    random = np.random.default_rng(seed)
    best, right = random.random(80).round(decimals).astype(np.float32), random.random(80) < 0.6
    found = best_matches(*zip(best.tolist(), right.tolist(), strict=True))
    curve = curve_of(pr_curve(found, "B"))
    precision, recall, threshold = precision_recall_curve(right, best)
    np.testing.assert_allclose(curve.precision, precision[::-1], atol=1e-12)
    np.testing.assert_allclose(curve.recall, recall[::-1], atol=1e-12)
    np.testing.assert_array_equal(curve.threshold[1:], threshold[::-1])
    assert average_precision(curve) == pytest.approx(average_precision_score(right, best), abs=1e-12)
    assert auc(curve) == pytest.approx(sklearn_auc(recall, precision), abs=1e-12)
    assert auc_roc(found) == pytest.approx(roc_auc_score(right, best), abs=1e-12)


@pytest.mark.parametrize("levels", [3, 1000])
def test_the_multi_match_curve_is_that_of_scikit_learn_over_all_pairs(levels: int) -> None:
    random = np.random.default_rng(levels)
    scores = random.integers(levels, size=(20, 15)).astype(np.float32)
    right = random.random(scores.shape) < 0.2
    soft = ~right & (random.random(scores.shape) < 0.3)
    curve = curve_of(
        pr_curve_multi(scores, [np.flatnonzero(row) for row in right], [np.flatnonzero(row) for row in soft | right])
    )
    precision, recall, threshold = precision_recall_curve(right[~soft], scores[~soft])
    np.testing.assert_allclose(curve.precision, precision[::-1], atol=1e-12)
    np.testing.assert_allclose(curve.recall, recall[::-1], atol=1e-12)
    np.testing.assert_array_equal(curve.threshold[1:], threshold[::-1])
    assert average_precision(curve) == pytest.approx(average_precision_score(right[~soft], scores[~soft]), abs=1e-12)


def test_all_equal_scores_give_one_threshold_and_the_share_of_right_pairs() -> None:
    scores, right = np.ones((3, 4), np.float32), places([0], [1, 2], [3])
    single, multi = curve_of(pr_curve(outcome(scores, right), "A")), curve_of(pr_curve_multi(scores, right))
    for curve in (single, multi):
        np.testing.assert_allclose(curve.precision, [1, 1 / 3], atol=1e-15)
    np.testing.assert_allclose(single.recall, [0, 1 / 3], atol=1e-15)
    np.testing.assert_array_equal(multi.recall, [0, 1])


def numbers_of(found: Outcome) -> list[Any]:
    """Return AP and area of curve A, AP of curve B, R@100P, P@100R, EP, AUC-ROC and F1."""
    curves = pr_curve(found, "A"), pr_curve(found, "B")
    return [
        None if curves[0] is None else average_precision(curves[0]),
        None if curves[0] is None else auc(curves[0]),
        None if curves[1] is None else average_precision(curves[1]),
        recall_at_full_precision(found),
        *(metric(found) for metric in (precision_at_full_recall, extended_precision, auc_roc, f1_max)),
    ]


NINES = scored([9, 0, 0], [8, 8, 0], [7, 0, 0])


@pytest.mark.parametrize(
    ("found", "expected"),
    [
        (WORKED, [11 / 16, 1 / 2 + 17 / 96, 11 / 12, 2 / 4, 3 / 5, 5 / 6, 5 / 6, 3 / 4]),
        (best_matches((0.9, None), (0.8, True)), [1 / 2, 1 / 4, 1 / 2, 0, 1 / 2, 0, 0, 2 / 3]),
        (best_matches((0.9, False), (0.8, True)), [1 / 4, 1 / 8, 1 / 2, 0, 1 / 2, 0, 0, 1 / 2]),
        (best_matches((0.5, True), (0.5, False)), [1 / 4, 3 / 8, 1 / 2, 0, 1 / 2, 1 / 4, 1 / 2, 1 / 2]),
        # what ties with an error does not count as free of error
        (
            best_matches((0.9, True), (0.8, True), (0.8, False), (0.7, True)),
            [29 / 48, 61 / 96, 29 / 36, 1 / 4, 3 / 4, 2 / 3, 1 / 2, 3 / 4],
        ),
        # nor does an answer whose best place ties with a wrong one
        (outcome(NINES, places([0], [0], [0])), [53 / 72, 107 / 144, 53 / 60, 1 / 3, 5 / 6, 7 / 10, 1 / 2, 5 / 6]),
        (outcome(NINES, places([0], [0, 1], [0])), [1, 1, 1, 1, 1, 1, None, 1]),
        (best_matches((0.9, True), (0.8, False)), [1 / 2, 1 / 2, 1, 1 / 2, 1 / 2, 1, 1, 2 / 3]),
        (best_matches((0.9, True), (0.8, True)), [1, 1, 1, 1, 1, 1, None, 1]),
        (best_matches((0.9, False), (0.8, False)), [0, 0, None, 0, 0, 0, None, 0]),
        (best_matches((0.9, None), (0.8, None)), [None] * 8),
        (outcome(np.zeros((0, 3), np.float32), []), [None] * 8),
    ],
)
def test_the_single_numbers_of_worked_cases(found: Outcome, expected: list[float | None]) -> None:
    assert numbers_of(found) == pytest.approx(expected, abs=1e-12)
    assert (recall_at(found, 1) is None) == (expected[3] is None)


def test_pairs_of_worked_cases() -> None:
    assert pr_curve_multi(np.zeros((2, 3), np.float32), places([], [])) is None
    curve = curve_of(pr_curve_multi(scored([2, -INF], [1, -INF]), places([0, 1], [1])))
    np.testing.assert_array_equal(curve.recall, [0, 1 / 3, 1 / 3])  # a right pair that is no candidate
    np.testing.assert_array_equal(curve.precision, [1, 1, 1 / 2])


def test_importing_the_metrics_loads_neither_scipy_nor_scikit_learn_nor_torch() -> None:
    code = "import sys, vprbench.metrics.accuracy, vprbench.metrics.intervals; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not {"scipy", "sklearn", "torch"} & set(done.stdout.split())
