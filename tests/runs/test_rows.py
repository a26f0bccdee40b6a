"""Rows, numbers and intervals of runs, worked by hand.

`a_run` has four queries whose right places stand 1st, 1st, 3rd and 8th of ten, in falling order of confidence:
recall at 1 is 2/4, at 5 3/4, at 10 4/4. Curve A passes (1/4, 1), (1/2, 1), (1/2, 2/3), (1/2, 1/2): both areas 1/2.
Streaming takes 10 + 2.5 ms: 100, 400 and 80 Hz. A batch of eight takes 40 + 10 ms: 200, 800 and 160 Hz.
"""

import csv
import io
import json
import re
from dataclasses import replace

import numpy as np
import pytest
import stored_runs
from checkout import ROOT
from little import a_run, laps, unanswerable_run

from vprbench.metrics.catalogue import METRICS
from vprbench.metrics.intervals import block_length, share_interval
from vprbench.runs import frame
from vprbench.runs.frame import list_numbers
from vprbench.runs.recall_intervals import estimate_recall_interval, order_along_journey
from vprbench.runs.record import Failure
from vprbench.runs.rows import format_row

ONE, TWO = np.array([1, 1, 1, 0]), np.array([2, 1, 1, 1])
TIED = a_run(outcome=replace(a_run().outcome, top_tied=TWO, tied=TWO, tied_correct=np.ones(4, np.int64)))
LOADED = a_run(fit_seconds=None, fit_compute_seconds=None, load_seconds=0.25, network="a" * 64)
NOWHERE = unanswerable_run()
LEFT = a_run(
    outcome=replace(a_run().outcome, above=np.array([0, 0, 2, 10]), tied=ONE, tied_correct=ONE, n_positives=ONE)
)
HITS = np.repeat([1, 0, 1, 1, 0, 0, 1, 0, 1, 1], 20)


def csv_rows(*results):
    return list(csv.DictReader(io.StringIO(frame.format_csv(results))))


def streamed(seconds, matched):
    return a_run(timing=replace(a_run().timing, streaming=laps(seconds, matched)))


def run_of(hits, **changes):
    return stored_runs.run(hits=[*map(int, hits)], n_places=len(hits), **changes)


@pytest.mark.parametrize(
    ("run", "known"),
    [
        (
            a_run(),
            {
                **{"recall_at_1": 0.5, "recall_at_5": 0.75, "recall_at_10": 1.0, "recall_at_25": 1.0},
                **{"recall_at_1_low": 0.15004, "recall_at_1_high": 0.84996},  # Wilson's of 2 of 4
                **{"auc_pr_a": 0.5, "average_precision_a": 0.5, "fit_seconds": 12.34, "fit_compute_seconds": 11.5},
                **{"streaming_encode_hz": 100, "streaming_match_hz": 400, "streaming_total_hz": 80},
                **{"streaming_p90_seconds": None, "streaming_p99_seconds": None},  # five queries are too few
                **{"offline_encode_hz": 200, "offline_match_hz": 800, "offline_total_hz": 160, "offline_batch": 8},
                **{"peak_memory_bytes": 512_000_000, "harness_seconds": 0.125, "method_seconds": 11.75},
                **{"queries": 4, "places": 10},
            },
        ),
        (TIED, {"recall_at_1": 0.375, "recall_at_1_pessimistic": 0.25, "recall_at_1_optimistic": 0.5}),
        (
            a_run(timing=None),
            {
                **{"recall_at_1": 0.5, "fit_seconds": 12.34, "first_query_seconds": None},
                **{"streaming_total_hz": None, "streaming_p90_seconds": None, "offline_batch": None},
            },
        ),
        (LOADED, {"fit_seconds": None, "fit_compute_seconds": None, "load_seconds": 0.25}),
        (streamed([0.001 * (i + 1) for i in range(64)], [0.5] * 64), {"streaming_p90_seconds": 0.563}),
        (
            NOWHERE,
            dict.fromkeys(
                [
                    *(f"recall_at_{name}" for name in ("1", "5", "10", "25", "1_low", "1_high", "1_answerable")),
                    *("recall_at_1_pessimistic", "recall_at_1_optimistic", "auc_pr_a", "average_precision_a"),
                ]
            ),
        ),
        (LEFT, {"recall_at_1": 0.5, "recall_at_1_answerable": 2 / 3}),
    ],
)
def test_numbers_are_those_worked_by_hand_in_json_and_csv(run, known):
    found = json.loads(json.dumps(list_numbers(run), allow_nan=False))
    assert {name: found[name] for name in known} == pytest.approx(known, abs=1e-5)
    (line,) = csv_rows(run)
    assert {name: line[name] for name in found} == {name: "" if v is None else str(v) for name, v in found.items()}


def test_csv_tells_a_failed_run_from_one_with_numbers():
    config = {"overrides": ["method=vprtempo", "method.epochs=9"]}
    ran, loaded, failed = csv_rows(a_run(), LOADED, Failure("vprtempo", "journey", config, "MemoryError: 99 GB"))
    assert (ran["network"], loaded["network"]) == ("", "a" * 64)
    assert [ran[name] for name in ("method", "dataset", "error")] == ["little window=5", "journey", ""]
    assert [failed[name] for name in ("method", "error")] == ["vprtempo epochs=9", "MemoryError: 99 GB"]
    assert {failed[name] for name in list_numbers(a_run())} == {""}
    counts = ("queries", "offline_batch", "peak_memory_bytes")
    assert [ran[name] for name in counts] == ["4", "8", "512000000"]  # whole beside nothing
    assert {*frame.tabulate_runs([a_run()])} == {*frame.COLUMNS}
    metrics, _, table = (ROOT / "docs/numbers.md").read_text(encoding="utf-8").partition("## The frame")
    assert {name for name in METRICS if not name.startswith("recall_at")} <= {*re.findall(r"`(\w+)`", metrics)}
    told = [name for row in re.findall(r"^\| (`.*?) \|", table, re.MULTILINE) for name in re.findall(r"`(\w+)`", row)]
    assert sorted(told) == sorted([*frame.COLUMNS, "recall_at_1_within_K_places"])


RATES = ("streaming Hz enc/match/total", "offline Hz enc/match/total")


def test_a_row_shows():
    for run, cells in (
        (
            a_run(),
            {
                **{"method": "little window=5", "R@1 % [95 %]": "50.0 [15.0, 85.0]", "R@5 %": "75.0"},
                **{"R@10 %": "100.0", "R@25 %": "100.0", "AUC-PR (A)": "0.500", "fit s": "12.3", "peak MB": "512"},
                **dict(zip(RATES, ("100 / 400 / 80", "200 / 800 / 160 (batch 8)"), strict=True)),
            },
        ),
        (a_run(timing=None), dict.fromkeys(RATES, "not timed")),
        (LOADED, {"fit s": "loaded"}),
        (replace(LOADED, network=None), {"fit s": "kept"}),
        (TIED, {"R@1 % [95 %]": "37.5 [9.2, 78.1] ties!"}),
        (streamed([0.0001], [1.0]), {RATES[0]: "10,000 / 1 / 1"}),
    ):
        row = format_row(run)
        assert {head: row[head] for head in cells} == cells
        assert [*row] == [*format_row(a_run())]


def test_the_interval_says_what_it_is_of_shuffled_queries_that_of_those_in_order_and_seeds_that_of_their_mean():
    for n_queries in (1, 4, 30):
        few = list_numbers(run_of([1] * n_queries))
        assert few["recall_at_1_interval"] == "independent"
        assert few["recall_at_1_low"] == pytest.approx(n_queries / (n_queries + 1.959964**2), abs=1e-6)
    alike = list_numbers(run_of(HITS))
    assert (alike["recall_at_1_interval"], alike["recall_at_1_block"]) == ("blocks", block_length(HITS))
    assert estimate_recall_interval([NOWHERE]) is None
    order = np.random.default_rng(0).permutation(200)
    mixed = run_of(HITS[order], positives=tuple(np.array([place]) for place in order))
    assert estimate_recall_interval([mixed]) == estimate_recall_interval([run_of(HITS)]) == share_interval(HITS)
    seeds = [run_of(HITS, seed=0), run_of(HITS[::-1], seed=1)]
    assert estimate_recall_interval(seeds) == share_interval((HITS + HITS[::-1]) / 2)


def test_queries_stand_in_the_order_of_the_journey():
    for places, along, order in (
        ([[4], [0, 9], [4, 1], [4]], None, [1, 2, 0, 3]),  # by their first right place, equals in their own order
        ([[], [5], [], [], [2]], None, [0, 4, 1, 2, 3]),  # without one behind the query before
        ([[0], [1], [2]], np.array([7, 3, 5, *range(10, 17)]), [1, 2, 0]),  # not in the order of the map
    ):
        right = tuple(np.array(each, np.int64) for each in places)
        shown = stored_runs.run(hits=[1] * len(places), positives=right, place_numbers=along)
        assert order_along_journey(shown).tolist() == order
