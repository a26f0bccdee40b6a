"""The metrics against values derived from the stored VPR-Bench results on Corridor, read from shared/."""

import csv
import json
from functools import cache

import numpy as np
import pytest
from checkout import SHARED

from vprbench.metrics import accuracy
from vprbench.metrics.ranking import outcome

ORACLE = SHARED / "oracles" / "vprbench_corridor.json"
CORRIDOR = SHARED / "data" / "corridor"
TECHNIQUES = (
    *("AMOSNet", "HybridNet", "NetVLAD", "denseVLAD", "ap-gem-r101"),
    *("AlexNet_VPR", "RegionVLAD", "CoHOG", "HOG", "CALC"),
)

pytestmark = pytest.mark.real_frames


@cache
def stored():
    with np.load(CORRIDOR / "vprbench_precomputed.npz") as arrays:
        return dict(arrays)


@cache
def oracle():
    return json.loads(ORACLE.read_text())["corridor"]


@cache
def positives():
    with (CORRIDOR / "ground_truth.csv").open(newline="") as rows:
        return tuple(np.array(row["matching_refs"].split(), np.int64) for row in csv.DictReader(rows))


def similarity(technique):
    return stored()[f"{technique}__similarity"]


@cache
def corridor(technique):
    return outcome(similarity(technique), positives())


@pytest.mark.parametrize("technique", TECHNIQUES)
def test_numbers_of_stored_scores_are_those_of_the_authors_and_swapped_axes_give_others(technique):
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

    curve_a, curve_b = accuracy.pr_curve(found, "A"), accuracy.pr_curve(found, "B")
    assert accuracy.auc(curve_b) == pytest.approx(expected["aucpr_sklearn"], abs=1e-9)
    assert accuracy.average_precision(curve_b) == pytest.approx(expected["ap"], abs=1e-9)
    assert accuracy.auc(curve_a) == pytest.approx(expected["auc_A_exact"], abs=1e-9)
    precision = accuracy.precision_at_full_recall(found)
    assert curve_b.precision[-1] == precision == pytest.approx(expected["p_at_full_recall_idx0"], abs=1e-12)
    assert accuracy.auc_roc(found) == pytest.approx(expected["aucroc"], abs=1e-9)
    assert accuracy.extended_precision(found) == pytest.approx(expected["ep"], abs=1e-9)
    assert accuracy.recall_at_full_precision(found) == expected["R100P_exact_all"]
