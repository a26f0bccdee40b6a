"""The interval of R@1 and the memory in summary and numbers of a run."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from little import a_run

from vprbench.metrics.block_length import block_length
from vprbench.metrics.ranking import Outcome
from vprbench.run import rows
from vprbench.run.record import Run
from vprbench.run.summary import summarise


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


def test_memory_is_that_of_the_run() -> None:
    assert summarise(a_run(peak_memory_bytes=123)).peak_memory_bytes == 123


def test_numbers_hold_the_interval_what_it_is_of_and_the_memory() -> None:
    run = run_with([1] * 30)
    numbers = rows.numbers(run)
    # Wilson's of 30 of 30: 30 / (30 + 1.96^2) to 1
    assert (numbers["recall_at_1_low"], numbers["recall_at_1_high"]) == (pytest.approx(0.88649, abs=1e-5), 1.0)
    assert (numbers["recall_at_1_interval"], numbers["recall_at_1_block"]) == ("independent", 1)
    assert rows.interval_line(run) is None
    assert numbers["peak_memory_bytes"] == run.peak_memory_bytes
    hits = ([1] * 20 + [0] * 20) * 10
    alike = rows.numbers(run_with(hits))
    assert (alike["recall_at_1_interval"], alike["recall_at_1_block"]) == ("blocks", block_length(hits))
    assert f" {block_length(hits)} " in str(rows.interval_line(run_with(hits)))
