"""A row is best only where every test separates it from every other one."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from stored_runs import ABACUS, run

from vprbench.paper.table.best import Contestant, best_rate, best_recall, best_training, disturbed, machine
from vprbench.run.note import Note
from vprbench.run.record import Run

NOISY = (Note("noisy", "two carts passed"),)


def row(name: str, *runs: Run, finished: bool = True) -> Contestant:
    return Contestant(name, runs, finished)


def misses(*wrong: int, n_queries: int = 60) -> Run:
    """Return a run that is right everywhere but at these queries."""
    return run(hits=[int(query not in wrong) for query in range(n_queries)])


def spread(count: int) -> Run:
    """Return a run of ten queries for each miss; the misses are ten apart and never come together."""
    return misses(*range(0, 10 * count, 10), n_queries=10 * count)


SAME, ALL_WRONG = misses(), misses(*range(60))


@pytest.mark.parametrize(
    ("rows", "best"),
    [
        # McNemar: p = 2 / 2^6 = 0.031 and 2 / 2^5 = 0.063
        ([row("b", spread(6)), row("a", SAME)], "a"),
        ([row("b", spread(5)), row("a", misses(n_queries=50))], None),
        # of three rows: 0.031 > 0.05 / 2; seven to nothing: 2 / 2^7 = 0.016
        ([row("a", SAME), row("b", spread(6)), row("c", spread(6))], None),
        ([row("a", misses(n_queries=70)), row("b", spread(7)), row("c", spread(7))], "a"),
        # every pair of seeds has to agree
        ([row("a", SAME, SAME), row("b", spread(6), spread(6))], "a"),
        ([row("a", SAME, SAME), row("b", spread(6), misses(0))], None),
        ([row("a", SAME, misses(0)), row("b", spread(6))], None),
        # two rows of one value
        ([row("a", SAME), row("b", SAME), row("c", spread(8))], None),
        # a row with missing seeds cannot win but keeps others from it
        ([row("a", SAME, finished=False), row("b", ALL_WRONG)], None),
        ([row("a", SAME, finished=False), row("b", spread(6)), row("c", ALL_WRONG)], None),
        ([row("b", SAME), row("c", ALL_WRONG, finished=False)], "b"),
    ],
)
def test_recall_is_best_where_every_pair_of_runs_is_separated(rows: list[Contestant], best: str | None) -> None:
    assert best_recall(rows) == best


def test_the_interval_allows_for_as_many_comparisons_as_the_test_does() -> None:
    # McNemar: p = 2 / 2^9 = 0.0039 < 0.05 / 9. Of the 60 stretches of four queries, which is how long blocks are here,
    # 42 hold none of the misses, so of all draws of 15 (42 / 60)^15 = 0.5 % show no difference: less than 2.5 % (1.3 %
    # with the allowance for few blocks) and more than 2.5 % / 9.
    first, second = misses(), misses(0, 1, 2, 20, 21, 22, 29, 30, 31)
    beaten = [row(str(i), misses(*range(60))) for i in range(8)]
    assert best_recall([row("a", first), row("b", second)]) == "a"
    assert best_recall([row("a", first), row("b", second), *beaten]) is None


@pytest.mark.parametrize(("length", "n_queries"), [(10, 60), (60, 600)])
def test_a_difference_of_one_stretch_of_the_route_separates_nothing(length: int, n_queries: int) -> None:
    # p < 2 / 2^10, but many draws of blocks miss the stretch
    stretch = misses(*range(n_queries // 3, n_queries // 3 + length), n_queries=n_queries)
    assert best_recall([row("a", misses(n_queries=n_queries)), row("b", stretch)]) is None


def test_queries_out_of_order_are_put_into_that_of_their_places_first() -> None:
    # the queries whose misses make one stretch of the route are asked all over the run
    order = np.random.default_rng(0).permutation(600)
    places = tuple(np.array([place]) for place in order)
    stretch = run(hits=[int(not 200 <= place < 260) for place in order], n_places=600, positives=places)
    assert best_recall([row("a", run(hits=[1] * 600, n_places=600, positives=places)), row("b", stretch)]) is None


def test_one_row_alone_is_never_best() -> None:
    fast = run()
    assert [contest([row("a", fast)]) for contest in (best_recall, best_rate, best_training)] == [None] * 3
    assert [contest([]) for contest in (best_recall, best_rate, best_training)] == [None] * 3


def test_hits_by_luck_among_equal_scores_separate_nothing() -> None:
    tied = misses()
    two = np.full(60, 2)
    lucky = replace(tied, outcome=replace(tied.outcome, top_tied=two, tied=two))  # expected R@1 1 / 2
    assert best_recall([row("a", lucky), row("b", misses(*range(60)))]) is None
    assert best_recall([row("a", tied), row("b", lucky)]) is None  # with luck the other one is right as often
    half = misses(*range(0, 60, 2))
    unlucky = replace(half, outcome=replace(half.outcome, top_tied=two, tied=np.where(np.arange(60) % 2, two, 1)))
    assert best_recall([row("a", tied), row("b", unlucky)]) == "a"  # at best right at every other query
    third = misses(*(query for query in range(60) if query % 3))  # expected R@1 1 / 3, and no luck in it
    assert best_recall([row("a", lucky), row("b", third)]) is None


def test_rows_without_a_defined_recall_are_in_no_contest() -> None:
    right = misses()
    nothing = np.zeros(60, np.int64)
    undefined = replace(right, outcome=replace(right.outcome, n_positives=nothing, tied=nothing, above=nothing + 10))
    assert best_recall([row("a", right), row("b", spread(6)), row("c", undefined)]) == "a"
    assert best_recall([row("a", right), row("c", undefined)]) is None


def timed(match_ms: list[float], encode_ms: float = 0.001, **changes: Any) -> Run:
    return run(
        encode_seconds=[encode_ms / 1e3] * len(match_ms), match_seconds=[each / 1e3 for each in match_ms], **changes
    )


FAST, SLOW = [10.0, 10.1, 10.2, 10.3, 10.4], [20.0, 20.1, 20.2, 20.3, 20.4]


FAST_ROW, SLOW_ROW = row("fast", timed(FAST)), row("slow", timed(SLOW))


@pytest.mark.parametrize(
    ("rows", "best"),
    [
        # Mann-Whitney, exact: p = 2 / C(10, 5) = 0.0079 and 2 / C(8, 4) = 0.029
        ([SLOW_ROW, FAST_ROW], "fast"),
        ([row("slow", timed(SLOW[:4])), row("fast", timed(FAST[:4]))], None),
        # a quarter faster
        ([FAST_ROW, row("slow", timed([10.2 * 1.26 + 0.01 * i for i in range(-2, 3)]))], "fast"),
        ([FAST_ROW, row("slow", timed([10.2 * 1.24 + 0.01 * i for i in range(-2, 3)]))], None),
        # encode and match together: 110 ms against 20, and 25 ms against 40
        ([row("fast match", timed(FAST, encode_ms=100.0)), SLOW_ROW], "slow"),
        ([row("fast match", timed(FAST, encode_ms=15.0)), row("slow", timed(SLOW, encode_ms=20.0))], "fast match"),
        # a busy machine, another machine, and one pair of seeds that is not faster
        ([FAST_ROW, row("slow", timed(SLOW, notes=NOISY))], None),
        ([FAST_ROW, row("slow", timed(SLOW, machine={**ABACUS, "processor": "Loom 3"}))], None),
        ([row("fast", timed(FAST), timed(SLOW)), row("slow", timed(SLOW), timed(SLOW))], None),
    ],
)
def test_a_rate_is_best_where_it_is_a_quarter_faster_than_all_others(rows: list[Contestant], best: str | None) -> None:
    assert best_rate(rows) == best


@pytest.mark.parametrize("note", [Note("caching", "seen before"), Note("audit", "other answers")])
def test_a_rate_that_an_audit_found_wanting_is_never_best_and_keeps_others_from_it(note: Note) -> None:
    untrue = timed(FAST, notes=(note,))
    assert best_rate([row("untrue", untrue), row("slow", timed(SLOW))]) is None
    assert best_rate([row("untrue", timed(FAST), untrue), row("slow", timed(SLOW))]) is None
    assert best_rate([row("fast", timed(FAST)), row("untrue", timed(SLOW, notes=(note,)))]) == "fast"


@pytest.mark.parametrize(
    "changes",
    [
        {"config": {"timing": {"minimum_seconds": 0.01, "minimum_queries": 1}}},
        {"machine": {**ABACUS, "libraries": {"torch": "2.6.0", "numba": "0.61"}}},
        {"machine": {**ABACUS, "threads": 2}},
    ],
)
def test_no_time_is_best_where_rows_were_timed_in_another_way(changes: dict[str, Any]) -> None:
    assert best_rate([row("fast", timed(FAST)), row("slow", timed(SLOW, **changes))]) is None
    assert best_training([row("fast", *trained(60)), row("slow", *trained(90, **changes))]) is None


def trained(*seconds: float, **changes: Any) -> list[Run]:
    """Return a run for each time of training; reading the images takes so long that the fast ones are the slow ones."""
    return [
        run(seed=seed, fit_compute_seconds=each, fit_seconds=9000 - each, **changes)
        for seed, each in enumerate(seconds)
    ]


@pytest.mark.parametrize(
    ("fast", "slow", "best"),
    [
        (trained(60), trained(75), "fast"),
        (trained(60), trained(74), None),
        (trained(50, 60), trained(75, 90), "fast"),
        (trained(50, 61), trained(75, 90), None),
        (trained(60), trained(90, notes=NOISY), None),
        (trained(60), [run(fit_seconds=None, fit_compute_seconds=None)], None),
    ],
)
def test_training_is_fastest_where_every_seed_is_a_quarter_faster(
    fast: list[Run], slow: list[Run], best: str | None
) -> None:
    assert best_training([row("slow", *slow), row("fast", *fast)]) == best


def test_work_left_to_the_first_query_is_part_of_the_training() -> None:
    (fast,) = trained(60)
    late = replace(fast, timing=replace(fast.timing, first_query_seconds=20.0))
    assert best_training([row("slow", *trained(75)), row("fast", late)]) is None


def test_a_run_is_disturbed_by_noise_and_by_too_few_laps_alone() -> None:
    kinds = {"noisy": True, "invalid": True, "caching": False, "dataset": False}
    assert {kind: disturbed(run(notes=(Note(kind, "noisy: carts"),))) for kind in kinds} == kinds


def test_a_machine_is_the_same_on_another_day() -> None:
    assert machine(run(day="2025-01-01")) == machine(run(day="2025-12-31")) == "Abacus 9, 1 of 2 cores, torch 2.6.0"
