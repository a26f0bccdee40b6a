"""The time of a resumed training: what interrupted runs had spent counts, once, and the ledger tells it."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from contextvars import Context
from pathlib import Path

import pytest
from partial_worker import FOUR, WHAT, Interrupted, interrupt, interrupted, spend
from stopped_clock import Clock

from vprbench.api import checkpoints


@pytest.fixture
def clock() -> Clock:
    return Clock()


# Honest seconds


def test_the_time_of_several_interrupted_runs_counts_once_until_the_last_part_of_each(
    tmp_path: Path, clock: Clock
) -> None:
    assert spend(tmp_path, clock, ("first", 5), ("second", 7), then=3) == 0
    assert spend(tmp_path, clock, ("third", 4), then=100) == 12
    assert spend(tmp_path, clock) == 16


def test_a_part_that_is_put_again_keeps_the_time_of_what_it_replaces(tmp_path: Path, clock: Clock) -> None:
    spend(tmp_path, clock, ("progress", 5), ("progress", 7))
    assert spend(tmp_path, clock, ("progress", 3), ("progress", 2)) == 12
    assert spend(tmp_path, clock) == 17


def test_the_time_of_a_part_that_was_damaged_does_not_count(tmp_path: Path, clock: Clock) -> None:
    spend(tmp_path, clock, ("first", 5), ("second", 7))
    (damaged,) = tmp_path.glob("*/first.safetensors")
    damaged.write_bytes(damaged.read_bytes()[:-8] + bytes(8))  # seen only when it is read
    with checkpoints.training(WHAT, tmp_path) as kept:
        assert kept.get("first") is None
        assert kept.get("second") is not None
        assert kept.seconds == 7


def test_a_part_that_another_run_finishes_meanwhile_counts_where_it_is_taken(tmp_path: Path, clock: Clock) -> None:
    with checkpoints.training(WHAT, tmp_path, clock.seconds) as kept:
        Context().run(spend, tmp_path, clock, ("first", 5), ("second", 7))
        assert kept.seconds == 0
        assert kept.get("first") is not None
        assert kept.seconds == 5


def test_the_time_of_several_threads_is_the_time_on_the_wall(tmp_path: Path, clock: Clock) -> None:
    with interrupted(), checkpoints.training(WHAT, tmp_path, clock.seconds) as kept:
        clock.spend(8)
        with ThreadPoolExecutor(4) as pool:
            list(pool.map(lambda number: kept.put(f"part-{number}", FOUR), range(4)))
        raise Interrupted
    assert spend(tmp_path, clock) == 8


# The ledger


def test_a_ledger_tells_what_was_taken_over(tmp_path: Path, clock: Clock) -> None:
    spend(tmp_path, clock, ("first", 5), ("second", 7))
    with checkpoints.ledger() as resumed:
        with checkpoints.training(WHAT, tmp_path) as kept:
            assert resumed.seconds == 0  # nothing was asked for yet
            assert kept.get("second") is not None
            assert resumed.seconds == 7
            assert kept.get("first") is not None
        with checkpoints.training({"another": 1}, tmp_path) as kept:
            assert kept.get("first") is None
        assert resumed.seconds == 12
    assert resumed.seconds == 12


def test_a_ledger_inside_another_is_the_same_and_its_own_parts_are_no_time_of_others(
    tmp_path: Path, clock: Clock
) -> None:
    with checkpoints.ledger() as outer:
        for what in (WHAT, {"another": 1}):
            with checkpoints.ledger() as inner, checkpoints.training(what, tmp_path, clock.seconds) as kept:
                clock.spend(5)
                kept.put("part", FOUR)
                assert kept.get("part") is not None
                assert kept.seconds == 0
            assert inner is outer
        assert outer.seconds == 0
        assert len([*tmp_path.glob("*/part.safetensors")]) == 2
    assert list(tmp_path.iterdir()) == []


def test_a_run_that_is_interrupted_in_its_second_training_keeps_the_first(tmp_path: Path, clock: Clock) -> None:
    with interrupted(), checkpoints.ledger():
        with checkpoints.training(WHAT, tmp_path, clock.seconds) as kept:
            clock.spend(5)
            kept.put("part", FOUR)
        with checkpoints.training({"another": 1}, tmp_path):
            raise Interrupted
    with checkpoints.ledger() as resumed, checkpoints.training(WHAT, tmp_path) as kept:
        assert kept.get("part") is not None
    assert resumed.seconds == 5
    with checkpoints.training(WHAT, tmp_path) as kept:  # the ledger of the interrupted run is closed
        kept.put("part", FOUR)
    assert list(tmp_path.iterdir()) == []


def test_a_training_whose_error_was_caught_stays_where_its_ledger_ends(tmp_path: Path) -> None:
    with checkpoints.ledger():
        home = interrupt(tmp_path, part=FOUR)
    assert list(tmp_path.iterdir()) == [home]


def test_a_training_that_is_opened_twice_in_a_ledger_goes_on_with_its_own(tmp_path: Path, clock: Clock) -> None:
    with interrupted(), checkpoints.ledger() as resumed:
        with checkpoints.training(WHAT, tmp_path, clock.seconds) as kept:
            clock.spend(5)
            kept.put("first", FOUR)
        clock.spend(100)  # outside of any training
        with checkpoints.training(WHAT, tmp_path, clock.seconds) as kept:
            assert kept.get("first") is not None
            clock.spend(7)
            kept.put("second", FOUR)
        assert resumed.seconds == 0
        raise Interrupted
    assert spend(tmp_path, clock) == 12
