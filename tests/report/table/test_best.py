"""A cell is bold only where every test separates its row from every other one."""

from dataclasses import replace

import numpy as np
import pytest
from stored_runs import ABACUS, cell, run, table

from vprbench.report.plan import Row
from vprbench.runs.notes import Note

RECALL, RATE = "recall_at_1", "query_cpu"
NOISY = (Note("noisy", "two carts passed"),)


def bold(quantity, contest, unfinished=""):
    """Return the row that is bold; a row has a run for each seed, an unfinished one lacks one more seed."""
    rows, seeded = [], []
    for name, runs in contest.items():
        rows.append(Row(name, name, seeds=tuple(range(len(runs) + (name == unfinished)))))
        for seed, each in enumerate(runs):
            seeded.append(replace(each, method=name, key=f"{name}-{seed}", config={**each.config, "seed": seed}))
    made = table(seeded, rows=rows)
    best = [row.name for row in rows if cell(made, row.name, quantity).best]
    return " ".join(best)


def misses(*wrong, n_queries=60):
    """Return a run that is right everywhere but at these queries."""
    return run(hits=[int(query not in wrong) for query in range(n_queries)])


def spread(count, n_queries=60):
    """Return a run of misses that are ten queries apart and never come together."""
    return misses(*range(0, 10 * count, 10), n_queries=n_queries)


SAME, ALL_WRONG = misses(), misses(*range(60))


@pytest.mark.parametrize(
    ("contest", "best", "unfinished"),
    [
        ({"a": [SAME]}, "", ""),
        # McNemar: p = 2 / 2^6 = 0.031 and 2 / 2^5 = 0.063
        ({"b": [spread(6)], "a": [SAME]}, "a", ""),
        ({"b": [spread(5, 50)], "a": [misses(n_queries=50)]}, "", ""),
        # of three rows: 0.031 > 0.05 / 2; seven to nothing: 2 / 2^7 = 0.016
        ({"a": [SAME], "b": [spread(6)], "c": [spread(6)]}, "", ""),
        ({"a": [misses(n_queries=70)], "b": [spread(7, 70)], "c": [spread(7, 70)]}, "a", ""),
        # every pair of seeds has to agree
        ({"a": [SAME, SAME], "b": [spread(6), spread(6)]}, "a", ""),
        ({"a": [SAME, SAME], "b": [spread(6), misses(0)]}, "", ""),
        ({"a": [SAME, misses(0)], "b": [spread(6)]}, "", ""),
        # a row with missing seeds cannot win but keeps others from it
        ({"a": [SAME], "b": [spread(6)], "c": [ALL_WRONG]}, "", "a"),
        ({"b": [SAME], "c": [ALL_WRONG]}, "b", "c"),
    ],
)
def test_recall_is_best_where_every_pair_of_runs_is_separated(contest, best, unfinished):
    assert bold(RECALL, contest, unfinished) == best


def test_the_interval_allows_for_as_many_comparisons_as_the_test_does():
    # McNemar: p = 2 / 2^9 = 0.0039 < 0.05 / 9. Of the 60 stretches of four queries, which is how long blocks are here,
    # 42 hold none of the misses, so of all draws of 15 (42 / 60)^15 = 0.5 % show no difference: less than 2.5 % (1.3 %
    # with the allowance for few blocks) and more than 2.5 % / 9.
    pair = {"a": [SAME], "b": [misses(0, 1, 2, 20, 21, 22, 29, 30, 31)]}
    assert bold(RECALL, pair) == "a"
    assert bold(RECALL, {**pair, **{f"beaten {i}": [ALL_WRONG] for i in range(8)}}) == ""


@pytest.mark.parametrize(("length", "n_queries", "shuffled"), [(10, 60, False), (60, 600, False), (60, 600, True)])
def test_a_difference_of_one_stretch_of_the_route_separates_nothing_in_whatever_order_it_is_asked(
    length, n_queries, shuffled
):
    # p < 2 / 2^10, but many draws of blocks miss the stretch
    order = np.random.default_rng(0).permutation(n_queries) if shuffled else np.arange(n_queries)
    asked = {"n_places": n_queries, "positives": tuple(np.array([place]) for place in order)}
    hits = [int(not n_queries // 3 <= place < n_queries // 3 + length) for place in order]
    assert bold(RECALL, {"a": [run(hits=[1] * n_queries, **asked)], "b": [run(hits=hits, **asked)]}) == ""


def test_hits_by_luck_among_equal_scores_separate_nothing_and_rows_without_a_number_are_in_no_contest():
    two = np.full(60, 2)
    lucky = replace(SAME, outcome=replace(SAME.outcome, top_tied=two, tied=two))  # expected R@1 1 / 2
    assert bold(RECALL, {"a": [lucky], "b": [ALL_WRONG]}) == ""
    assert bold(RECALL, {"a": [SAME], "b": [lucky]}) == ""  # with luck the other one is right as often
    half = misses(*range(0, 60, 2))
    unlucky = replace(half, outcome=replace(half.outcome, top_tied=two, tied=np.where(np.arange(60) % 2, two, 1)))
    assert bold(RECALL, {"a": [SAME], "b": [unlucky]}) == "a"  # at best right at every other query
    third = misses(*(query for query in range(60) if query % 3))  # expected R@1 1 / 3, and no luck in it
    assert bold(RECALL, {"a": [lucky], "b": [third]}) == ""
    nothing = np.zeros(60, np.int64)
    undefined = replace(SAME, outcome=replace(SAME.outcome, n_positives=nothing, tied=nothing, above=nothing + 10))
    assert bold(RECALL, {"a": [SAME], "b": [spread(6)], "c": [undefined]}) == "a"
    assert bold(RECALL, {"a": [SAME], "c": [undefined]}) == ""


def timed(match_ms, encode_ms=0.001, **changes):
    seconds = [[encode_ms / 1e3] * len(match_ms), [each / 1e3 for each in match_ms]]
    return run(encode_seconds=seconds[0], match_seconds=seconds[1], **changes)


NEAR = (-0.02, -0.01, 0, 0.01, 0.02)
FAST, SLOW = [10.0, 10.1, 10.2, 10.3, 10.4], [20.0, 20.1, 20.2, 20.3, 20.4]


@pytest.mark.parametrize(
    ("fast", "slow", "best"),
    [
        # Mann-Whitney, exact: p = 2 / C(10, 5) = 0.0079 and 2 / C(8, 4) = 0.029
        ([timed(FAST)], [timed(SLOW, day="2025-12-31")], "fast"),
        ([timed(FAST[:4])], [timed(SLOW[:4])], ""),
        # a quarter faster
        ([timed(FAST)], [timed([10.2 * 1.26 + each for each in NEAR])], "fast"),
        ([timed(FAST)], [timed([10.2 * 1.24 + each for each in NEAR])], ""),
        # encode and match together: 110 ms against 20, and 25 ms against 40
        ([timed(FAST, encode_ms=100.0)], [timed(SLOW)], "slow"),
        ([timed(FAST, encode_ms=15.0)], [timed(SLOW, encode_ms=20.0)], "fast"),
        # a busy machine, another machine, and one pair of seeds that is not faster
        ([timed(FAST)], [timed(SLOW, notes=NOISY)], ""),
        ([timed(FAST)], [timed(SLOW, machine={**ABACUS, "processor": "Loom 3"})], ""),
        ([timed(FAST), timed(SLOW)], [timed(SLOW), timed(SLOW)], ""),
        # timed in another way
        ([timed(FAST)], [timed(SLOW, config={"timing": {"minimum_seconds": 0.01, "minimum_queries": 1}})], ""),
        ([timed(FAST)], [timed(SLOW, machine={**ABACUS, "libraries": {"torch": "2.6.0", "numba": "0.61"}})], ""),
        ([timed(FAST)], [timed(SLOW, machine={**ABACUS, "threads": 2})], ""),
        # a rate with other answers is never best and keeps others from it
        ([timed(FAST), timed(FAST, notes=(Note("answers", "other answers"),))], [timed(SLOW)], ""),
        ([timed(FAST)], [timed(SLOW, notes=(Note("answers", "other answers"),))], "fast"),
    ],
)
def test_a_rate_is_best_where_it_is_a_quarter_faster_than_all_others(fast, slow, best):
    assert bold(RATE, {"slow": slow, "fast": fast}) == best
