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

from vprbench.metrics import accuracy
from vprbench.metrics.ranking import Outcome, outcome

ORACLE = SHARED / "oracles" / "vprbench_corridor.json"
CORRIDOR = SHARED / "data" / "corridor"
TECHNIQUES = (
    *("AMOSNet", "HybridNet", "NetVLAD", "denseVLAD", "ap-gem-r101"),
    *("AlexNet_VPR", "RegionVLAD", "CoHOG", "HOG", "CALC"),
)

pytestmark = pytest.mark.real_frames
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


def sampled(curve: accuracy.PRCurve | None, best: npt.NDArray[np.float32], steps: int) -> accuracy.PRCurve:
    """Read a curve at equal steps from the highest to the lowest score, as VPR_Tutorial and VPRTempo do."""
    assert curve is not None
    thresholds = np.linspace(best.max(), best.min(), steps)
    reached = np.searchsorted(-curve.threshold, -thresholds, side="right") - 1
    points = np.append(0, reached)  # both add the point (0, 1)
    return accuracy.PRCurve(curve.precision[points], curve.recall[points], curve.threshold[points], curve.kind)


@each_technique
def test_recall_and_best_matches_are_those_of_the_authors_and_swapped_axes_give_others(technique: str) -> None:
    expected, found = oracle()[technique], corridor(technique)
    for n in (1, 5, 10, 20):
        recall = accuracy.recall_at(found, n)
        assert recall.expected == recall.pessimistic == recall.optimistic == expected[f"R@{n}"]
        assert recall.n_queries == expected["nq"]
    match = stored()[f"{technique}__match"]
    np.testing.assert_array_equal(
        accuracy.hits_at(found, 1), [int(match[query]) in right for query, right in enumerate(positives())]
    )
    assert (found.top_tied == 1).all()
    np.testing.assert_allclose(found.best_score, stored()[f"{technique}__score"], rtol=1e-6, atol=0)
    of_reference = [
        np.array([query for query, right in enumerate(positives()) if reference in right], np.int64)
        for reference in range(similarity(technique).shape[1])
    ]
    swapped = accuracy.recall_at(outcome(similarity(technique).T, of_reference), 1)
    assert expected["R@1"] != swapped.expected == expected["wrong_axis_R1"]


@each_technique
def test_areas_and_single_numbers_agree_to_nine_digits(technique: str) -> None:
    expected, found = oracle()[technique], corridor(technique)
    curve_a, curve_b = accuracy.pr_curve(found, "A"), accuracy.pr_curve(found, "B")
    assert accuracy.auc(curve_b) == pytest.approx(expected["aucpr_sklearn"], abs=1e-9)
    assert accuracy.average_precision(curve_b) == pytest.approx(expected["ap"], abs=1e-9)
    assert accuracy.auc(curve_a) == pytest.approx(expected["auc_A_exact"], abs=1e-9)
    precision = accuracy.precision_at_full_recall(found)
    assert curve_b.precision[-1] == precision == pytest.approx(expected["p_at_full_recall_idx0"], abs=1e-12)
    assert accuracy.auc_roc(found) == pytest.approx(expected["aucroc"], abs=1e-9)
    assert accuracy.extended_precision(found) == pytest.approx(expected["ep"], abs=1e-9)
    assert accuracy.recall_at_full_precision(found) == expected["R100P_exact_all"]


@each_technique
def test_curves_read_at_linear_thresholds_are_those_of_the_field(technique: str) -> None:
    expected, found, scores = oracle()[technique], corridor(technique), similarity(technique)
    for kind, family in (("A", "tut"), ("B", "tempo")):
        for steps in (100, 1000):
            linear = sampled(accuracy.pr_curve(found, kind), found.best_score, steps)
            assert accuracy.auc(linear) == pytest.approx(expected[f"{family}_single_auc_n{steps}"], abs=1e-12)
            assert linear.recall[-1] == pytest.approx(expected[f"{family}_single_Rmax"], abs=1e-12)
    single = sampled(accuracy.pr_curve(found, "A"), found.best_score, 100)
    multi = sampled(accuracy.pr_curve_multi(scores, positives()), scores, 100)
    assert accuracy.auc(multi) == pytest.approx(expected["tut_multi_auc_n100"], abs=1e-4)
    for curve, name in ((single, "R100P_single_tut_n100"), (multi, "R100P_multi_tut_n100")):
        assert curve.recall[curve.precision == 1].max() == pytest.approx(expected[name], abs=1e-12)
