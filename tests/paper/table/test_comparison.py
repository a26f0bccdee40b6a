"""Each reason why a measured and a published number differ is given where it holds, and nowhere else."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from stored_runs import ABACUS, CITY, LOOM, NETVLAD, NORDLAND, PLANNED, SAD, VPRTEMPO, answers, older, run

from vprbench.paper.plan import QUANTITIES, PlannedColumn, Quantity, Row
from vprbench.paper.table.comparison import other_timing, reasons
from vprbench.run.record import Run

PAPERS_MACHINE = {**ABACUS, "processor": "Intel(R) Core(TM) i7-9700K CPU @ 3.60GHz"}
OXFORD = PlannedColumn("oxford", "Oxford", (), "Oxford RobotCar")


def as_in_the_paper(**changes: Any) -> Run:
    return run(**{"hits": [1] * 2700, "n_places": 3300, "machine": PAPERS_MACHINE, **changes})


def given(
    quantity: Quantity, stored: Run, row: Row = VPRTEMPO, planned: PlannedColumn = NORDLAND, real: str | None = None
) -> list[str]:
    return reasons(row, planned, real, quantity, stored)


def test_the_papers_protocol_leaves_one_open_question_of_recall() -> None:
    assert given("recall_at_1", as_in_the_paper()) == [
        "our map keeps the 600 places that are not queried; the paper does not say whether its map does"
    ]


def test_the_papers_machine_is_no_other_hardware() -> None:
    assert given("query_cpu", as_in_the_paper()) == ["the rate covers matching alone, here and in the paper"]


def test_other_hardware_names_both_machines() -> None:
    cpu, gpu = as_in_the_paper(machine=ABACUS), as_in_the_paper(machine=LOOM)
    assert "other hardware: Abacus 9; the paper's: Intel i7-9700K" in given("query_cpu", cpu)
    assert "other hardware: Abacus 9; the paper's: Intel i7-9700K" in given("train_cpu", cpu)
    assert "other hardware: Spindle 80GB; the paper's: Nvidia RTX 2080" in given("query_gpu", gpu)
    assert "other hardware: Spindle 80GB; the paper's: Nvidia RTX 2080" in given("train_gpu", gpu)
    same = as_in_the_paper(machine={**LOOM, "accelerator": "NVIDIA GeForce RTX 2080"})
    assert not any("hardware" in reason for reason in given("query_gpu", same))


@pytest.mark.parametrize("quantity", QUANTITIES)
def test_rendered_frames_are_said_to_stand_in_first(quantity: Quantity) -> None:
    first, *_ = given(quantity, run(machine=LOOM), planned=PLANNED, real="Nordland")
    assert first == "other data: rendered frames stand in for Nordland"


def test_of_rendered_frames_nothing_is_said_of_their_traverses() -> None:
    stored = as_in_the_paper(protocol={"references": ["morning"], "query": "dusk"})
    assert given("recall_at_1", stored, planned=PLANNED, real="Nordland") == [
        "other data: rendered frames stand in for Nordland"
    ]


def test_other_traverses_are_named_with_those_of_the_paper() -> None:
    stored = as_in_the_paper(protocol={"references": ["winter"], "query": "summer"})
    assert given("recall_at_1", stored) == [
        "other traverses: winter against summer; the paper's: spring and fall against summer"
    ]
    turned = as_in_the_paper(protocol={"references": ["fall", "spring"], "query": "summer"})
    assert not any("traverses" in reason for reason in given("recall_at_1", turned))


def test_the_traverses_of_oxford_are_its_own() -> None:
    stored = run(hits=[1] * 360, n_places=450, protocol={"references": ["sun", "rain"], "query": "dusk"})
    (only,) = given("recall_at_1", stored, planned=OXFORD)
    assert only.startswith("our map keeps the 90 places")


def test_another_size_is_named_for_recall_and_for_times() -> None:
    stored = as_in_the_paper(hits=[1] * 2761, n_places=2761)
    assert "other protocol: 2,761 queries of 2,761 places; the paper's: 2,700 of 3,300" in given("recall_at_1", stored)
    assert "other size: 2,761 places; the paper's: 3,300" in given("query_cpu", stored)
    assert "other size: 2,761 places; the paper's: 3,300" in given("train_cpu", stored)


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("tolerance_places", 1, "within 1 place;"),
        ("tolerance_places", 3, "within 3 places;"),
        ("radius_metres", 25.0, "within 25 m;"),
    ],
)
def test_a_tolerance_is_named(name: str, value: float, words: str) -> None:
    stored = as_in_the_paper()
    with_tolerance = replace(stored, protocol={**stored.protocol, name: value})
    assert any(words in reason for reason in given("recall_at_1", with_tolerance))
    assert not any(words in reason for reason in given("recall_at_1", stored))


def test_the_boundary_of_a_rate_is_that_of_the_paper() -> None:
    assert "the rate covers feature extraction alone, here and in the paper" in given(
        "query_cpu", as_in_the_paper(), NETVLAD
    )


def test_only_the_rate_of_sad_is_said_to_look_like_a_loop() -> None:
    with_loop = {
        (row.name, quantity)
        for row in (SAD, VPRTEMPO)
        for quantity in QUANTITIES
        if any("loop" in reason for reason in given(quantity, as_in_the_paper(machine=LOOM), row))
    }
    assert with_loop == {("SAD", "query_cpu"), ("SAD", "query_gpu")}


def test_training_on_the_papers_machine_and_protocol_needs_no_reason() -> None:
    assert given("train_cpu", as_in_the_paper()) == []


def test_a_rate_of_both_steps_is_not_said_to_be_the_papers() -> None:
    assert given("query_cpu", as_in_the_paper(), Row("hog", "hog")) == []


def timed(**changes: Any) -> Run:
    asked = {"minimum_seconds": 2.0, "minimum_queries": 64, "sample": 256}
    return run(config={"timing": {**asked, **changes}})


def test_rows_that_are_timed_alike_need_no_word() -> None:
    assert other_timing({"SAD": timed(), "VPRTempo": timed()}) == {}
    assert other_timing({}) == {}


def test_the_row_that_is_timed_otherwise_says_how() -> None:
    short = timed(minimum_seconds=0.01, minimum_queries=1)
    assert other_timing({"SAD": short, "VPRSNN": timed(), "VPRTempo": timed()}) == {
        "SAD": "timed under another protocol than VPRSNN and VPRTempo: at least 0.01 s and 1 query"
    }
    assert other_timing({"SAD": timed(), "VPRSNN": short}) == {
        "VPRSNN": "timed under another protocol than SAD: at least 0.01 s and 1 query"
    }
    assert other_timing({"A": timed(), "B": timed(), "C": timed(), "D": timed(sample=8)}) == {
        "D": "timed under another protocol than most rows: sample 8"
    }


def test_an_older_record_does_not_say_how_it_was_timed() -> None:
    assert other_timing({"A": timed(), "B": older(run())}) == {
        "B": "timed under a protocol that its older record does not hold"
    }
    assert other_timing({"A": older(run()), "B": timed()}) == {
        "B": "timed under another protocol than A: at least 2 s and 64 queries"
    }


def test_a_column_that_the_paper_does_not_have_needs_no_reasons() -> None:
    assert [given(quantity, run(), planned=CITY) for quantity in QUANTITIES] == [[]] * 5


def test_every_reason_is_short() -> None:
    machine = {**LOOM, "processor": "A processor of a very long name " * 9, "accelerator": "A very long name " * 9}
    stored = run(
        machine=machine,
        protocol={
            "references": ["an autumn of rain", "a winter of snow"],
            "query": "a day of hail",
            "tolerance_places": 3,
        },
        outcome=answers([1] * 27_000, 27_592),
    )
    for quantity in QUANTITIES:
        for real in (None, "Nordland"):
            found = given(quantity, stored, SAD, real=real)
            assert found
            assert all(len(reason) <= 120 for reason in found)
