"""Each reason why a measured and a published number differ is given where it holds, and nowhere else."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from stored_runs import ABACUS, CITY, LOOM, NORDLAND, PLANNED, SAD, VPRTEMPO, answers, run

from vprbench.paper.plan import PlannedColumn, Row
from vprbench.paper.table.quantities import QUANTITIES, RATES, RECALL, TRAINING, Quantity
from vprbench.paper.table.reasons import LONGEST, Reason, other_timing
from vprbench.run.record import Run

PAPERS_MACHINE = {**ABACUS, "processor": "Intel(R) Core(TM) i7-9700K CPU @ 3.60GHz"}
OXFORD = PlannedColumn("oxford", "Oxford", (), "Oxford RobotCar")
HOG = Row("hog", "hog")
TRAIN_CPU, TRAIN_GPU = TRAINING
QUERY_CPU, QUERY_GPU = RATES


def as_in_the_paper(**changes: Any) -> Run:
    return run(**{"hits": [1] * 2700, "n_places": 3300, "machine": PAPERS_MACHINE, **changes})


def given(
    quantity: Quantity, stored: Run, row: Row = VPRTEMPO, planned: PlannedColumn = NORDLAND, real: str | None = None
) -> list[Reason]:
    return [*quantity.differences(row, planned, real, stored)]


def codes(*arguments: Any, **named: Any) -> list[str]:
    return [reason.code for reason in given(*arguments, **named)]


def protocol(references: list[str], query: str, **more: Any) -> dict[str, Any]:
    return {"protocol": {"references": references, "query": query, **more}}


OXFORDS = {"hits": [1] * 360, "n_places": 450, **protocol(["sun", "rain"], "dusk")}
OTHER_SIZE = {"hits": [1] * 2761, "n_places": 2761}
RTX = {**LOOM, "accelerator": "NVIDIA GeForce RTX 2080"}


@pytest.mark.parametrize(
    ("quantity", "changes", "named", "found"),
    [
        (RECALL, {}, {}, ["distractors"]),
        (TRAIN_CPU, {}, {}, []),
        (QUERY_CPU, {}, {}, []),
        (QUERY_CPU, {}, {"row": SAD}, ["paper's way"]),
        (RECALL, {}, {"row": SAD}, ["distractors"]),
        (QUERY_CPU, {"machine": ABACUS}, {"row": HOG}, ["hardware"]),
        (TRAIN_CPU, {"machine": ABACUS}, {}, ["hardware"]),
        (QUERY_GPU, {"machine": LOOM}, {"row": HOG}, ["hardware"]),
        (TRAIN_GPU, {"machine": LOOM}, {}, ["hardware"]),
        (TRAIN_GPU, {"machine": RTX}, {}, []),
        (RECALL, protocol(["morning"], "dusk"), {"planned": PLANNED, "real": "Nordland"}, ["rendered"]),
        (TRAIN_CPU, {}, {"planned": PLANNED, "real": "Nordland"}, ["rendered"]),
        (RECALL, protocol(["winter"], "summer"), {}, ["traverses"]),
        (RECALL, protocol(["fall", "spring"], "summer"), {}, ["distractors"]),
        (RECALL, OXFORDS, {"planned": OXFORD}, ["distractors"]),
        (RECALL, OTHER_SIZE, {}, ["counts"]),
        (QUERY_CPU, OTHER_SIZE, {"row": HOG}, ["size"]),
        (TRAIN_CPU, OTHER_SIZE, {}, ["size"]),
        (RECALL, protocol(["spring", "fall"], "summer", tolerance_places=3), {}, ["tolerance"]),
        (RECALL, protocol(["spring", "fall"], "summer", radius_metres=25.0), {}, ["tolerance"]),
        (
            RECALL,
            {"n_places": 2700, **protocol(["spring", "fall"], "summer", protocol="vprsnn")},
            {},
            ["no distractors"],
        ),
        *((quantity, {"machine": LOOM}, {"planned": CITY}, []) for quantity in QUANTITIES),
    ],
)
def test_a_difference_has_its_reasons(
    quantity: Quantity, changes: dict[str, Any], named: dict[str, Any], found: list[str]
) -> None:
    assert codes(quantity, as_in_the_paper(**changes), **named) == found


@pytest.mark.parametrize(
    ("quantity", "changes", "words"),
    [
        (RECALL, protocol(["winter"], "summer"), "winter against summer; the paper's: spring and fall against summer"),
        (RECALL, OTHER_SIZE, "2,761 queries of 2,761 places; the paper's: 2,700 of 3,300"),
        (TRAIN_CPU, {"machine": ABACUS}, "Abacus 9; the paper's: Intel i7-9700K"),
        (TRAIN_GPU, {"machine": LOOM}, "Spindle 80GB; the paper's: Nvidia RTX 2080"),
        (TRAIN_CPU, OTHER_SIZE, "2,761 places; the paper's: 3,300"),
    ],
)
def test_a_reason_names_both_sides(quantity: Quantity, changes: dict[str, Any], words: str) -> None:
    (reason,) = given(quantity, as_in_the_paper(**changes))
    assert reason.text.endswith(f": {words}")


@pytest.mark.parametrize(("within", "words"), [(1, "1 place;"), (3, "3 places;")])
def test_a_tolerance_is_named(within: int, words: str) -> None:
    (reason,) = given(RECALL, as_in_the_paper(**protocol(["spring", "fall"], "summer", tolerance_places=within)))
    assert words in reason.text


def test_every_reason_is_short() -> None:
    machine = {**LOOM, "processor": "A processor of a very long name " * 9, "accelerator": "A very long name " * 9}
    long = protocol(["an autumn of rain", "a winter of snow"], "a day of hail", tolerance_places=3)
    stored = run(machine=machine, outcome=answers([1] * 27_000, 27_592), **long)
    for quantity in QUANTITIES:
        for real in (None, "Nordland"):
            found = given(quantity, stored, replace(SAD, rate_remark="slow " * 60), real=real)
            assert found
            assert all(len(reason.text) <= LONGEST for reason in found)


def timed(**changes: Any) -> Run:
    asked = {"minimum_seconds": 2.0, "minimum_queries": 64, "sample": 256}
    return run(config={"timing": {**asked, **changes}})


SHORT = timed(minimum_seconds=0.01, minimum_queries=1)


@pytest.mark.parametrize(
    ("runs", "told"),
    [
        ({}, {}),
        ({"A": timed(), "B": timed()}, {}),
        ({"A": SHORT, "B": timed(), "C": timed()}, {"A": "B and C: at least 0.01 s and 1 query"}),
        ({"A": timed(), "B": SHORT}, {"B": "A: at least 0.01 s and 1 query"}),
        ({"A": timed(), "B": timed(), "C": timed(), "D": timed(sample=8)}, {"D": "most rows: sample 8"}),
    ],
)
def test_the_row_that_is_timed_otherwise_says_how(runs: dict[str, Run], told: dict[str, str]) -> None:
    found = other_timing(runs)
    assert {reason.code for reason in found.values()} <= {"timing"}
    assert found.keys() == told.keys()
    assert all(found[name].text.endswith(f" {end}") for name, end in told.items())
