"""What a run calls the time of fitting, of the method and of the harness, and how far it says it is."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any, Self

import numpy as np
import numpy.typing as npt
import pytest
from little import Lookup, journey, slow_pictures
from little_runs import kinds, run_of, table
from stopped_clock import Clock

from vprbench import progress
from vprbench.api.arrays import Places, Scores
from vprbench.api.dataset import Dataset
from vprbench.api.images import Images
from vprbench.run import rows
from vprbench.run.record import Run

pytestmark = pytest.mark.usefixtures("surroundings")


@dataclass
class Learning(Lookup):
    """Reads all references and then computes for 60 ms; needs 5 ms for each image of a query, and 1 ms to match it."""

    clock: Clock = field(kw_only=True)

    def fit(self, references: Images, places: Places) -> Self:
        list(references)
        self.clock.spend(0.06)
        return self

    def encode(self, images: Images) -> npt.NDArray[np.int64]:
        self.clock.spend(0.005 * len(images))
        return super().encode(images)

    def match(self, codes: npt.NDArray[np.int64]) -> Scores:
        self.clock.spend(0.001 * len(codes))
        return super().match(codes)


def slow_journey(clock: Clock) -> Dataset:
    """Return a dataset whose eight references take 160 ms to read, and its eight queries as long."""
    references, queries = (slow_pictures(8, 0.02, clock.spend) for _ in range(2))
    return replace(journey(8, 8), references=references, queries=queries)


@pytest.fixture
def slow_run(clock: Clock, monkeypatch: pytest.MonkeyPatch, surroundings: SimpleNamespace) -> Run:
    """Return a run before which the harness looks at the machine for 7 s."""

    def look(device: str, threads: int) -> dict[str, Any]:
        clock.spend(7)
        return {}

    monkeypatch.setattr(surroundings, "capture", look)
    return run_of(Learning(table(8, 8), clock=clock), slow_journey(clock))


def test_the_time_of_the_fit_of_computing_of_the_method_and_of_the_harness_are_told_apart(slow_run: Run) -> None:
    assert slow_run.fit_seconds == pytest.approx(0.16 + 0.06)  # reading and computing
    assert slow_run.fit_compute_seconds == pytest.approx(0.06)
    assert slow_run.method_seconds == pytest.approx(0.06 + 8 * 0.006 + 0.006)  # the first query is asked once before
    assert slow_run.harness_seconds == pytest.approx(7)


@dataclass
class Late(Learning):
    """Leaves 600 ms of the training, of which the fit has 60, to the first image that it is asked about."""

    learnt: bool = False

    def encode(self, images: Images) -> npt.NDArray[np.int64]:
        if not self.learnt:
            self.clock.spend(0.6)
            self.learnt = True
        return super().encode(images)


@pytest.mark.parametrize(("kind", "excess"), [(Learning, 0), (Late, 0.6)])
def test_work_that_is_left_to_the_first_query_is_seen_and_counts_as_training(
    clock: Clock, kind: type[Learning], excess: float
) -> None:
    run = run_of(kind(table(8, 8), clock=clock), slow_journey(clock))
    shown = rows.numbers(run)
    assert run.timing.first_query_seconds == pytest.approx(0.006 + excess)
    assert (shown["fit_seconds"], shown["fit_compute_seconds"]) == pytest.approx((0.22, 0.06))
    assert (shown["training_seconds"], shown["training_compute_seconds"]) == pytest.approx(
        (0.22 + excess, 0.06 + excess)
    )
    assert rows.readable_row(run)["fit s"] == f"{0.22 + excess:.2g}"
    assert ("late" in kinds(run)) is bool(excess)
    assert run.harness_seconds == pytest.approx(0)


def test_what_was_read_of_a_dataset_before_a_run_does_not_count(clock: Clock) -> None:
    dataset = slow_journey(clock)
    for i in range(8):
        dataset.references[i]
    runs = [run_of(Learning(table(8, 8), clock=clock), dataset) for _ in range(2)]
    assert [run.fit_compute_seconds for run in runs] == pytest.approx([0.06] * 2)


def test_timing_takes_its_order_from_the_seed_of_the_run() -> None:
    orders = []
    for seed in (0, 0, 1):
        method = Lookup(table(12, 4))
        run_of(method, journey(12, 4), seed=seed)
        orders.append(method.asked)
    assert orders[0] == orders[1] != orders[2]


def test_every_stage_is_reported_and_a_share_rises_to_one_with_the_queries() -> None:
    told: list[tuple[str, float]] = []
    with progress.listening(lambda stage, done: told.append((stage, done))):
        run_of(Lookup(table(300, 4)), journey(300, 4))
    assert list(dict.fromkeys(stage for stage, _ in told)) == ["fit", "query", "timing"]
    assert [done for stage, done in told if stage == "query"] == pytest.approx([128 / 300, 256 / 300, 1])
