"""The metrics against values derived from the stored VPR-Bench results on Corridor, read from shared/."""

from __future__ import annotations

import csv
import json
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from checkout import SHARED

from vprbench.metrics.accuracy import (
    PRCurve,
    auc,
    auc_roc,
    average_precision,
    extended_precision,
    hits_at,
    pr_curve,
    pr_curve_multi,
    precision_at_full_recall,
    recall_at,
    recall_at_full_precision,
)
from vprbench.metrics.intervals import block_bootstrap, mcnemar_exact, wilson
from vprbench.metrics.ranking import Outcome, outcome

ORACLE = SHARED / "oracles" / "vprbench_corridor.json"
CORRIDOR = SHARED / "data" / "corridor"
TECHNIQUES = (
    "AMOSNet",
    "HybridNet",
    "NetVLAD",
    "denseVLAD",
    "ap-gem-r101",
    "AlexNet_VPR",
    "RegionVLAD",
    "CoHOG",
    "HOG",
    "CALC",
)

pytestmark = pytest.mark.skipif(
    not (ORACLE.is_file() and CORRIDOR.is_dir()),
    reason="the folder shared/ with the Corridor oracle is not beside the checkout",
)
each_technique = pytest.mark.parametrize("technique", TECHNIQUES)


@cache
def stored() -> dict[str, npt.NDArray[Any]]:
    with np.load(CORRIDOR / "vprbench_precomputed.npz") as arrays:
        return dict(arrays)


@cache
def oracle() -> dict[str, dict[str, float]]:
    return json.loads(ORACLE.read_text())["corridor"]


@cache
def positives() -> tuple[npt.NDArray[np.int64], ...]:
    with (CORRIDOR / "ground_truth.csv").open(newline="") as rows:
        return tuple(np.array(row["matching_refs"].split(), np.int64) for row in csv.DictReader(rows))


def similarity(technique: str) -> npt.NDArray[np.float32]:
    return stored()[f"{technique}__similarity"]


@cache
def corridor(technique: str) -> Outcome:
    return outcome(similarity(technique), positives())


def sampled(curve: PRCurve | None, best: npt.NDArray[np.float32], steps: int) -> PRCurve:
    """Read a curve at equal steps from the highest to the lowest score, as VPR_Tutorial and VPRTempo do."""
    assert curve is not None
    thresholds = np.linspace(best.max(), best.min(), steps)
    reached = np.searchsorted(-curve.threshold, -thresholds, side="right") - 1
    points = np.append(0, reached)  # both add the point (0, 1)
    return PRCurve(curve.precision[points], curve.recall[points], curve.threshold[points], curve.kind)


def last_recall_without_error(curve: PRCurve) -> float:
    return float(curve.recall[curve.precision == 1].max())


@each_technique
def test_recall_counts_and_recall_at_n_are_exact(technique: str) -> None:
    expected = oracle()[technique]
    recall = recall_at(corridor(technique), 1)
    assert recall is not None
    assert recall.expected * recall.n_queries == pytest.approx(expected["correct"], abs=1e-12)
    assert recall.n_queries == expected["nq"]
    assert recall.expected == expected["R1"]
    for n in (1, 5, 10, 20):
        recall = recall_at(corridor(technique), n)
        assert recall is not None
        assert recall.expected == recall.pessimistic == recall.optimistic == expected[f"R@{n}"]


@each_technique
def test_the_ranked_best_matches_are_those_stored_by_the_authors(technique: str) -> None:
    match = stored()[f"{technique}__match"]
    right = [int(match[query]) in places for query, places in enumerate(positives())]
    np.testing.assert_array_equal(hits_at(corridor(technique), 1), right)
    assert (corridor(technique).top_tied == 1).all()
    assert sorted(oracle()) == sorted(TECHNIQUES)
    np.testing.assert_allclose(corridor(technique).best_score, stored()[f"{technique}__score"], rtol=1e-6, atol=0)


@each_technique
def test_areas_and_single_numbers_agree_to_nine_digits(technique: str) -> None:
    expected = oracle()[technique]
    curve_a, curve_b = pr_curve(corridor(technique), "A"), pr_curve(corridor(technique), "B")
    assert curve_a is not None
    assert curve_b is not None
    assert auc(curve_b) == pytest.approx(expected["aucpr_sklearn"], abs=1e-9)
    assert average_precision(curve_b) == pytest.approx(expected["ap"], abs=1e-9)
    assert auc(curve_a) == pytest.approx(expected["auc_A_exact"], abs=1e-9)
    found = precision_at_full_recall(corridor(technique))
    assert curve_b.precision[-1] == found == pytest.approx(expected["p_at_full_recall_idx0"], abs=1e-12)
    assert auc_roc(corridor(technique)) == pytest.approx(expected["aucroc"], abs=1e-9)
    assert extended_precision(corridor(technique)) == pytest.approx(expected["ep"], abs=1e-9)
    assert recall_at_full_precision(corridor(technique)) == expected["R100P_exact_all"]


@each_technique
@pytest.mark.parametrize(("kind", "family"), [("A", "tut"), ("B", "tempo")])
def test_the_single_match_curves_read_at_linear_thresholds_are_those_of_the_field(
    technique: str, kind: Any, family: str
) -> None:
    expected = oracle()[technique]
    curve = pr_curve(corridor(technique), kind)
    for steps in (100, 1000):
        linear = sampled(curve, corridor(technique).best_score, steps)
        assert auc(linear) == pytest.approx(expected[f"{family}_single_auc_n{steps}"], abs=1e-12)
        assert linear.recall[-1] == pytest.approx(expected[f"{family}_single_Rmax"], abs=1e-12)


@each_technique
def test_recall_without_error_read_at_linear_thresholds_is_that_of_the_tutorial(technique: str) -> None:
    expected = oracle()[technique]
    best, scores = corridor(technique).best_score, similarity(technique)
    single = sampled(pr_curve(corridor(technique), "A"), best, 100)
    multi = sampled(pr_curve_multi(scores, positives()), scores, 100)
    assert last_recall_without_error(single) == pytest.approx(expected["R100P_single_tut_n100"], abs=1e-12)
    assert last_recall_without_error(multi) == pytest.approx(expected["R100P_multi_tut_n100"], abs=1e-12)


@each_technique
def test_the_multi_match_curve_read_at_linear_thresholds_is_that_of_the_tutorial(technique: str) -> None:
    scores = similarity(technique)
    linear = sampled(pr_curve_multi(scores, positives()), scores, 100)
    assert auc(linear) == pytest.approx(oracle()[technique]["tut_multi_auc_n100"], abs=1e-4)


@each_technique
def test_swapped_axes_give_the_wrong_recall_that_the_right_order_does_not(technique: str) -> None:
    references_of = np.zeros((len(positives()), similarity(technique).shape[1]), np.bool_)
    for query, places in enumerate(positives()):
        references_of[query, places] = True
    swapped = outcome(similarity(technique).T, [np.flatnonzero(column) for column in references_of.T])
    wrong, right = recall_at(swapped, 1), recall_at(corridor(technique), 1)
    assert wrong is not None
    assert right is not None
    assert wrong.expected == oracle()[technique]["wrong_axis_R1"]
    assert right.expected != wrong.expected


@pytest.mark.parametrize(
    ("first", "second", "b", "c", "p_value"),
    [
        ("HOG", "CoHOG", 16, 32, 0.0293),
        ("NetVLAD", "denseVLAD", 17, 20, 0.743),
        ("AMOSNet", "HybridNet", 3, 9, 0.146),
    ],
)
def test_paired_tests_give_the_stated_counts_and_p_values(
    first: str, second: str, b: int, c: int, p_value: float
) -> None:
    found = mcnemar_exact(hits_at(corridor(first), 1), hits_at(corridor(second), 1))
    assert (found.b, found.c) == (b, c)
    assert found.p_value == pytest.approx(p_value, abs=5e-4 if p_value > 0.1 else 5e-5)


def test_the_intervals_of_netvlad_are_those_stated() -> None:
    hits = hits_at(corridor("NetVLAD"), 1)
    independent = wilson(hits.sum(), len(hits))
    single, blocks = block_bootstrap(hits, block=1), block_bootstrap(hits, block=10)
    assert independent is not None
    assert single is not None
    assert blocks is not None
    assert (independent.low, independent.high) == pytest.approx((0.584, 0.756), abs=5e-4)
    assert (single.low, single.high) == pytest.approx((0.586, 0.757), abs=0.02)
    assert (blocks.low, blocks.high) == pytest.approx((0.549, 0.802), abs=0.02)
