"""Best against paper: a verdict needs the queries and nearly all seeds, none of them the one that was searched."""

import numpy as np
import pytest
from search_stub import Here, Stub, recall

from vprbench.tuning.comparison import compare, compare_with_paper
from vprbench.tuning.objective import Tried
from vprbench.tuning.space import PAPER

RIGHT, WRONG = np.ones(40), np.zeros(40)


def at(*places):
    """Hits on these queries alone."""
    return np.isin(np.arange(40), places).astype(np.float64)


def of(best, paper):
    return compare(len(best[0]), (1, 2, 3, 4, 5), *([Tried(row, row) for row in rows] for rows in (best, paper)))


@pytest.mark.parametrize(
    ("n_right", "verdict"),
    [(4, "better"), (3, "not told apart"), (1, "worse"), (2, "not told apart")],  # no interval holds 0
)
def test_a_verdict_needs_four_of_five_seeds(n_right, verdict):
    best = [RIGHT] * n_right + [WRONG] * (5 - n_right)
    compared = of(best, [1 - row for row in best])
    assert compared.interval.low < (2 * n_right - 5) / 5 <= compared.interval.high
    assert compared.interval.low * compared.interval.high > 0
    assert compared.verdict == verdict


def test_seeds_that_agree_are_no_verdict_where_few_or_neighbouring_queries_made_it():
    compared = of([at(0, 1, 2, 3)] * 5, [at(20, 21, 22)] * 5)  # a traverse without queries 0 to 3 says the opposite
    assert compared.differences == pytest.approx((0.025,) * 5)
    assert compared.interval.low < 0 < compared.interval.high
    assert compared.verdict == "not told apart"
    few = of([np.ones(19)] * 5, [np.zeros(19)] * 5)
    assert (few.interval, few.verdict) == (None, "not told apart")
    together = of([at(*range(20))] * 5, [WRONG] * 5).interval
    spread = of([at(*range(0, 40, 2))] * 5, [WRONG] * 5).interval  # as many hits, in any block half of all
    assert (together.kind, spread.kind) == ("blocks", "independent")
    assert together.high - together.low > 0.5 > 0.35 > spread.high - spread.low


def test_means_deviations_and_differences_are_those_over_the_seeds():
    compared = of([at(*range(n)) for n in (8, 12, 16, 20, 24)], [at(*range(12))] * 5)
    assert compared.best.recall_at_1 == pytest.approx(0.4)
    assert compared.best.recall_at_1_std == pytest.approx((0.1 * 0.1 * 10 / 4) ** 0.5)  # of 0.2, 0.3, 0.4, 0.5 and 0.6
    assert compared.differences == pytest.approx((-0.1, 0.0, 0.1, 0.2, 0.3))
    assert [(test.b, test.c) for test in compared.tests] == [(0, 4), (0, 0), (4, 0), (8, 0), (12, 0)]


def test_both_settings_are_trained_with_the_five_seeds_after_the_searched_one_and_a_failure_ends_it():
    best = {**PAPER, "rate_min": 0.4}
    both = compare_with_paper(Here(), Stub(shifts_by_seed=0.01), best, {"searched": 12, "checked": 10}, seed=7)
    assert {name: each.n_places for name, each in both.items()} == {"searched": 12, "checked": 10}
    for each in both.values():
        assert each.seeds == (8, 9, 10, 11, 12)
        for repeated, settings in ((each.best, best), (each.paper, PAPER)):
            assert repeated.recalls_at_1 == pytest.approx([recall(settings) - 0.01 * seed for seed in each.seeds])
    with pytest.raises(MemoryError, match="no room"):
        compare_with_paper(Here(), Stub(fails_above=0.0), PAPER, {"searched": 12}, seed=0)
