"""The interval of R@1 that knows of consecutive queries, and the memory, in summary and numbers of a run."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
import pytest
from little import a_run, unanswerable_run

from vprbench import tables
from vprbench.ranking import Outcome
from vprbench.records import Run
from vprbench.summary import summarise


def run_with(hits: Sequence[int]) -> Run:
    """Return a run whose query i finds its right place first where hits[i] is 1, and second where it is 0."""
    right = np.array(hits)
    ones = np.ones(len(right), np.int64)
    outcome = Outcome(
        best_score=np.full(len(right), 0.5, np.float32),
        top_tied=ones,
        top_tied_correct=right,
        above=1 - right,
        tied=ones,
        tied_correct=ones,
        n_positives=ones,
        n_places=50,
    )
    return a_run(outcome=outcome, positives=tuple(np.array([0]) for _ in hits))


def block_interval(run: Run) -> tuple[float, float]:
    summary = summarise(run)
    assert summary.recall_at_1_block_low is not None
    assert summary.recall_at_1_block_high is not None
    return summary.recall_at_1_block_low, summary.recall_at_1_block_high


def test_blocks_of_ten_neighbours_are_drawn() -> None:
    hits = [1] * 10 + [0] * 10
    sums = [sum((hits + hits)[start : start + 10]) for start in range(20)]
    means = [(first + second) / 20 for first, second in product(sums, sums)]  # of the 400 equally likely samples
    assert block_interval(run_with(hits)) == pytest.approx(np.quantile(means, [0.025, 0.975]), abs=0.05)


def test_neighbours_that_are_alike_widen_the_interval_and_a_random_order_hardly_does() -> None:
    alike = run_with(([1] * 20 + [0] * 20) * 10)
    mixed = run_with(np.random.default_rng(0).permutation([1] * 200 + [0] * 200).tolist())
    wide, narrow = (high - low for low, high in map(block_interval, (alike, mixed)))
    independent = 2 * 1.96 * (0.25 / 400) ** 0.5
    assert wide > 2 * independent
    assert narrow == pytest.approx(independent, rel=0.4)


def test_where_every_query_is_right_the_interval_is_a_point() -> None:
    assert block_interval(run_with([1] * 30)) == (1.0, 1.0)


@pytest.mark.parametrize("run", [run_with([1, 0] * 9 + [1]), unanswerable_run()], ids=["19 queries", "unanswerable"])
def test_there_is_no_such_interval_for(run: Run) -> None:
    summary = summarise(run)
    assert (summary.recall_at_1_block_low, summary.recall_at_1_block_high) == (None, None)


def test_memory_is_that_of_the_run() -> None:
    assert summarise(a_run(peak_memory_bytes=123)).peak_memory_bytes == 123


def test_numbers_hold_the_interval_and_the_memory() -> None:
    run = run_with([1] * 30)
    numbers = tables.numbers(run)
    assert (numbers["recall_at_1_block_low"], numbers["recall_at_1_block_high"]) == (1.0, 1.0)
    assert numbers["peak_memory_bytes"] == run.peak_memory_bytes
