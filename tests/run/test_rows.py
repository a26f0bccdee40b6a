"""The summary and the tables of a run whose numbers are worked by hand.

`a_run` has four queries whose right places stand 1st, 1st, 3rd and 8th of ten, in falling order of confidence:
recall at 1 is 2/4, at 5 3/4, at 10 4/4. Curve A passes (1/4, 1), (1/2, 1), (1/2, 2/3), (1/2, 1/2): both areas 1/2.
Streaming takes 10 + 2.5 ms: 100, 400 and 80 Hz. A batch of eight takes 40 + 10 ms: 200, 800 and 160 Hz.
"""

from __future__ import annotations

import csv
import io
import json
from dataclasses import replace

import numpy as np
import pytest
from little import a_run, laps, unanswerable_run

from vprbench.metrics.ranking import outcome
from vprbench.run import rows
from vprbench.run.record import Failure, Run
from vprbench.run.rows import readable_row
from vprbench.run.summary import StageRates, summarise

FAILURE = Failure("vprtempo", "journey", {"overrides": ["method=vprtempo", "method.epochs=9"]}, "MemoryError: 99 GB")


def tied_run() -> Run:
    """Return the run with the first query's right place tied with a wrong one."""
    two, one = np.array([2, 1, 1, 1]), np.ones(4, np.int64)
    return a_run(outcome=replace(a_run().outcome, top_tied=two, tied=two, tied_correct=one))


def loaded_run() -> Run:
    """Return the run with a stored network in place of a training."""
    return a_run(fit_seconds=None, fit_compute_seconds=None, load_seconds=0.25, network="a" * 64)


def csv_rows(*results: Run | Failure) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(rows.csv(results))))


def markdown_cells(text: str) -> list[list[str]]:
    """Return the cells of a Markdown table, without the line under its head."""
    lines = [line for line in text.splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in (lines[0], *lines[2:])]


# Summary


def test_recalls_are_shares_of_all_queries() -> None:
    assert summarise(a_run()).recalls == {1: 0.5, 5: 0.75, 10: 1.0, 25: 1.0}


def test_the_interval_of_two_of_four_is_wilsons() -> None:
    interval = summarise(a_run()).recall_at_1_interval  # 0.5 -+ 1.96 sqrt(0.25 / 4 + 1.96^2 / 64) / (1 + 1.96^2 / 4)
    assert interval is not None
    assert (interval.low, interval.high) == pytest.approx((0.1500, 0.8500), abs=5e-5)


def test_both_areas_of_the_worked_curve_are_one_half() -> None:
    summary = summarise(a_run())
    assert (summary.auc_pr, summary.average_precision) == pytest.approx((0.5, 0.5))


def test_recall_of_the_answerable_queries_leaves_the_others_out() -> None:
    outcome = replace(
        a_run().outcome,
        above=np.array([0, 0, 2, 10]),
        tied=np.array([1, 1, 1, 0]),
        tied_correct=np.array([1, 1, 1, 0]),
        n_positives=np.array([1, 1, 1, 0]),
    )
    assert summarise(a_run(outcome=outcome)).recall_at_1_answerable == pytest.approx(2 / 3)


def test_a_tie_of_two_counts_half() -> None:
    assert summarise(tied_run()).recalls[1] == pytest.approx(1.5 / 4)


def test_a_tie_is_lost_by_the_pessimist_and_won_by_the_optimist() -> None:
    summary = summarise(tied_run())
    assert (summary.recall_at_1_pessimistic, summary.recall_at_1_optimistic) == (0.25, 0.5)


def test_streaming_rates_are_one_over_the_median_of_each_stage() -> None:
    rates = summarise(a_run()).streaming
    assert (rates.encode, rates.match, rates.total) == pytest.approx((100, 400, 80))


def test_offline_rates_are_those_of_the_fastest_batch() -> None:
    rates = summarise(a_run()).offline
    assert (rates.encode, rates.match, rates.total) == pytest.approx((200, 800, 160))


def test_the_fastest_batch_is_named() -> None:
    assert summarise(a_run()).offline_batch == 8


def test_a_p90_is_the_second_slowest_total_of_64_queries() -> None:
    timing = replace(a_run().timing, streaming=laps([0.001 * (i + 1) for i in range(64)], [0.5] * 64))
    assert summarise(a_run(timing=timing)).streaming_p90_seconds == pytest.approx(0.563)


def test_five_queries_carry_no_percentile() -> None:
    summary = summarise(a_run())
    assert (summary.streaming_p90_seconds, summary.streaming_p99_seconds) == (None, None)


@pytest.mark.parametrize(
    "name",
    [
        "recall_at_1_interval",
        "recall_at_1_answerable",
        "recall_at_1_pessimistic",
        "recall_at_1_optimistic",
        "auc_pr",
        "average_precision",
    ],
)
def test_without_a_right_place_a_measure_is_undefined_and_not_zero(name: str) -> None:
    assert getattr(summarise(unanswerable_run()), name) is None


def test_without_a_right_place_every_recall_is_undefined_and_not_zero() -> None:
    assert set(summarise(unanswerable_run()).recalls.values()) == {None}


# A row for people


@pytest.mark.parametrize(
    ("head", "cell"),
    [
        ("method", "little window=5"),
        ("R@1 % [95 %]", "50.0 [15.0, 85.0]"),
        ("R@5 %", "75.0"),
        ("R@10 %", "100.0"),
        ("R@25 %", "100.0"),
        ("AUC-PR (A)", "0.500"),
        ("fit s", "12.3"),
        ("streaming Hz enc/match/total", "100 / 400 / 80"),
        ("offline Hz enc/match/total", "200 / 800 / 160 (batch 8)"),
        ("peak MB", "512"),
    ],
)
def test_a_row_shows(head: str, cell: str) -> None:
    assert readable_row(a_run())[head] == cell


def test_a_row_of_a_loaded_network_says_so_where_the_time_of_its_fit_would_stand() -> None:
    assert readable_row(loaded_run())["fit s"] == "loaded"


def test_a_row_of_descriptors_from_an_earlier_run_says_so_where_the_time_of_its_fit_would_stand() -> None:
    assert readable_row(replace(loaded_run(), network=None))["fit s"] == "kept"


def test_a_row_says_when_its_recall_hangs_on_ties() -> None:
    assert readable_row(tied_run())["R@1 % [95 %]"].endswith("ties!")


def test_a_row_without_a_right_place_says_that_recall_is_undefined() -> None:
    assert readable_row(unanswerable_run())["R@1 % [95 %]"].startswith("undefined")


@pytest.mark.parametrize("head", ["R@5 %", "R@10 %", "R@25 %", "AUC-PR (A)"])
def test_a_row_without_a_right_place_has_dashes(head: str) -> None:
    assert readable_row(unanswerable_run())[head] == "-"


@pytest.mark.parametrize(
    ("seconds", "text"), [(0.0001, "10,000"), (0.001, "1,000"), (0.1, "10"), (0.5, "2"), (4, "0.25"), (3, "0.33")]
)
def test_a_rate_shows_as_many_digits_as_a_reader_needs(seconds: float, text: str) -> None:
    timing = replace(a_run().timing, streaming=laps([seconds], [1.0]))
    assert readable_row(a_run(timing=timing))["streaming Hz enc/match/total"].split(" / ")[0] == text


@pytest.mark.parametrize(
    ("overrides", "text"),
    [
        ([], "little"),
        (["method=little", "seed=3", "timing.sample=9"], "little"),
        (["method=little", "method.window=5", "method.grey=true"], "little window=5 grey=true"),
    ],
)
def test_a_label_holds_the_arguments_of_the_method_that_were_asked_for(overrides: list[str], text: str) -> None:
    assert rows.label(a_run(config={**a_run().config, "overrides": overrides})) == text


def test_a_plain_row_stands_under_its_head() -> None:
    assert rows.plain_row({"a": "long", "head": "b"}) == "a     head\nlong  b   "


# Markdown


def test_markdown_shows_each_run_in_a_line() -> None:
    cells = markdown_cells(rows.markdown([readable_row(a_run()), readable_row(unanswerable_run())]))
    assert [line[:2] for line in cells] == [
        ["method", "R@1 % [95 %]"],
        ["little window=5", "50.0 [15.0, 85.0]"],
        ["little window=5", "undefined (no query has a right place)"],
    ]


def test_markdown_keeps_the_digits_it_is_given() -> None:
    assert markdown_cells(rows.markdown([{"x": "1.50"}, {"x": "10,000"}]))[1:] == [["1.50"], ["10,000"]]


def test_a_bar_stays_in_its_cell() -> None:
    assert rows.markdown([{"error": "int | None"}]).splitlines()[-1] == r"| int \| None |"


# Protocol and machine


def test_a_protocol_is_one_line_of_words() -> None:
    line = "journey: 4 queries, 10 places (reference spring+fall, query summer, tolerance_places 0)"
    assert rows.protocol_line(a_run()) == line


def test_a_machine_is_one_line_of_words() -> None:
    assert rows.machine_line(a_run()) == "Abacus 9, 1 of 2 cores, torch 2.6.0, 2025-01-31"


def test_an_accelerator_is_part_of_the_machine() -> None:
    run = a_run(environment={**a_run().environment, "accelerator": "Sieve X"})
    assert "1 of 2 cores, Sieve X, torch" in rows.machine_line(run)


# CSV and JSON


@pytest.mark.parametrize(
    ("column", "value"),
    [
        ("recall_at_1", 0.5),
        ("recall_at_5", 0.75),
        ("recall_at_10", 1.0),
        ("auc_pr_a", 0.5),
        ("average_precision_a", 0.5),
        ("fit_seconds", 12.34),
        ("fit_compute_seconds", 11.5),
        ("streaming_encode_hz", 100),
        ("streaming_match_hz", 400),
        ("streaming_total_hz", 80),
        ("offline_encode_hz", 200),
        ("offline_match_hz", 800),
        ("offline_total_hz", 160),
        ("offline_batch", 8),
        ("peak_memory_bytes", 512_000_000),
        ("harness_seconds", 0.125),
        ("method_seconds", 11.75),
        ("queries", 4),
        ("places", 10),
    ],
)
def test_csv_holds_the_unrounded_number_of(column: str, value: float) -> None:
    assert float(csv_rows(a_run())[0][column]) == pytest.approx(value, rel=1e-12)


def test_csv_names_method_and_dataset() -> None:
    assert [csv_rows(a_run())[0][name] for name in ("method", "dataset", "error")] == ["little window=5", "journey", ""]


def test_csv_holds_the_error_of_a_failed_run() -> None:
    assert csv_rows(a_run(), FAILURE)[1]["error"] == "MemoryError: 99 GB"


def test_csv_holds_no_number_of_a_failed_run() -> None:
    line = csv_rows(a_run(), FAILURE)[1]
    assert {line[name] for name in rows.numbers(a_run())} == {""}


def test_csv_holds_no_time_of_the_fit_that_a_loaded_network_did_not_need() -> None:
    line = csv_rows(a_run(), loaded_run())[1]
    assert [line[name] for name in ("fit_seconds", "fit_compute_seconds", "load_seconds")] == ["", "", "0.25"]


def test_csv_names_the_network_that_was_loaded() -> None:
    assert [line["network"] for line in csv_rows(a_run(), loaded_run())] == ["", "a" * 64]


def test_the_numbers_of_a_loaded_network_are_null_where_nothing_was_measured() -> None:
    assert [rows.numbers(loaded_run())[name] for name in ("fit_seconds", "fit_compute_seconds")] == [None, None]


def test_csv_holds_nothing_where_a_measure_is_undefined() -> None:
    assert csv_rows(unanswerable_run())[0]["recall_at_1"] == ""


@pytest.mark.parametrize(
    ("column", "text"), [("queries", "4"), ("offline_batch", "8"), ("peak_memory_bytes", "512000000")]
)
def test_counts_stay_whole_beside_a_failed_run(column: str, text: str) -> None:
    assert csv_rows(a_run(), FAILURE)[0][column] == text


def test_an_undefined_measure_is_null_in_json() -> None:
    assert json.loads(json.dumps(rows.numbers(unanswerable_run()), allow_nan=False))["recall_at_1"] is None


def test_stage_rates_are_plain_numbers() -> None:
    rates = summarise(a_run()).streaming
    assert {type(rate) for rate in (rates.encode, rates.match, rates.total)} == {float}
    assert isinstance(rates, StageRates)


def test_the_interval_holds_the_recall_where_every_query_ties() -> None:
    scores, right = np.ones((40, 2), np.float32), (np.array([0]),) * 40
    shown = rows.numbers(a_run(outcome=outcome(scores, right), positives=right))
    low, recall, high = (shown[f"recall_at_1{end}"] for end in ("_low", "", "_high"))
    assert low is not None
    assert high is not None
    assert recall == 0.5
    assert low <= recall <= high
