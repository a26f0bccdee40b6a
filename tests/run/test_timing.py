"""Whether a run is timed, for how long, and when a stored one answers."""

from __future__ import annotations

import logging
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from little import Lookup, journey
from little_runs import QUICK, asked_for, kinds, table

from vprbench.run.compose import composed
from vprbench.run.find_or_make import Made, made
from vprbench.run.identity import Request
from vprbench.run.record import Run
from vprbench.run.settings import Settings, timings
from vprbench.run.stopwatch import Protocol, Stopwatch
from vprbench.run.store import Store

UNTIMED = replace(QUICK, rates=False)
MORE = replace(QUICK, minimum_queries=6)
TABLE = table(12, 4)

PROTOCOLS = st.builds(
    Protocol,
    minimum_seconds=st.integers(0, 2),
    minimum_queries=st.integers(1, 2),
    sample=st.integers(1, 2),
    maximum_seconds=st.integers(2, 3),
    batch_sizes=st.lists(st.integers(1, 3), min_size=1, max_size=3),
    total_seconds=st.none() | st.integers(1, 2),
    rates=st.booleans(),
)


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return Store(tmp_path / "results")


@pytest.fixture(autouse=True)
def _quick(surroundings: Any) -> None:
    """Look at no machine."""


def request_of(protocol: Protocol) -> Request:
    return asked_for(Lookup(TABLE), journey(*TABLE.shape), protocol)


def asked(store: Store, protocol: Protocol, force: bool = False) -> Made:
    return made(request_of(protocol), Settings(frames=False, force=force), store, {})


def the_only(store: Store) -> Run:
    (run,) = store.runs()
    return run


# When a stored run answers


def test_a_run_is_made_again_where_it_was_timed_by_less_than_asked_for_and_not_where_by_more(
    store: Store, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)
    answers, told = [], []
    for protocol in (UNTIMED, UNTIMED, QUICK, UNTIMED, MORE, QUICK):
        caplog.clear()
        answers.append(asked(store, protocol))
        told.append([record.getMessage() for record in caplog.records if "running again" in record.getMessage()])
    assert [answer.from_store for answer in answers] == [False, True, False, True, False, True]
    assert [answer.run.timing is None for answer in answers] == [True, True, False, False, False, False]
    assert [len(lines) for lines in told] == [0, 0, 1, 0, 1, 0]
    assert "minimum_queries" in told[4][0]
    assert len({answer.folder for answer in answers}) == 1
    assert the_only(store).timed_by == MORE


@given(PROTOCOLS, PROTOCOLS, PROTOCOLS)
def test_what_answers_what_is_a_preorder_and_untimed_is_answered_by_everything(
    one: Protocol, other: Protocol, third: Protocol
) -> None:
    assert not one.shortfalls(one)
    assert not one.shortfalls(replace(other, rates=False))
    if not one.shortfalls(other) and not other.shortfalls(third):
        assert not one.shortfalls(third)


@pytest.mark.parametrize(
    "lesser",
    [
        {"minimum_seconds": 1.0},
        {"minimum_queries": 63},
        {"sample": 255},
        {"batch_sizes": [1, 32, 128]},
        {"total_seconds": 100.0},
        {"rates": False},
    ],
)
def test_a_protocol_that_measures_less_falls_short_by_name(lesser: dict[str, Any]) -> None:
    standard = Protocol()
    assert replace(standard, **lesser).shortfalls(standard) == [*lesser]
    assert standard.shortfalls(replace(standard, **lesser)) == []


def test_the_named_protocols_answer_one_another_in_their_order_and_standard_is_the_default() -> None:
    assert timings() == ["none", "publish", "quick", "standard"]
    named = {name: Protocol(**composed([f"timing={name}"])["timing"]) for name in timings()}
    order = ["none", "quick", "standard", "publish"]
    for number, name in enumerate(order):
        assert [bool(named[name].shortfalls(named[other])) for other in order] == [i > number for i in range(4)]
    assert named["standard"] == Protocol() == Protocol(**composed([])["timing"])
    assert composed(["timing=quick", "timing.minimum_seconds=1"])["timing"] == {
        **asdict(named["quick"]),
        "minimum_seconds": 1,
    }


# The answers are kept before they are timed


def interrupt(*_: object) -> None:
    raise KeyboardInterrupt


def test_a_run_that_is_ended_while_it_is_timed_leaves_its_answers(
    store: Store, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)
    whole = asked(Store(store.root.parent / "other"), QUICK).run
    caplog.clear()
    with monkeypatch.context() as patch:
        patch.setattr(Stopwatch, "measure", interrupt)
        with pytest.raises(KeyboardInterrupt):
            asked(store, QUICK)
    kept = the_only(store)
    assert (kept.timing, kept.config["timing"], kinds(kept)) == (None, None, kinds(whole))
    np.testing.assert_array_equal(kept.outcome.above, whole.outcome.above)
    np.testing.assert_array_equal(kept.top_places, whole.top_places)
    assert sum("R@1" in record.getMessage() for record in caplog.records) == 1
    assert asked(store, UNTIMED).from_store
    assert not asked(store, QUICK).from_store
    assert the_only(store).timing is not None


@pytest.mark.parametrize("force", [False, True])
def test_a_run_that_was_timed_is_not_lost_where_the_next_is_ended_while_it_is_timed(
    store: Store, monkeypatch: pytest.MonkeyPatch, force: bool
) -> None:
    asked(store, QUICK)
    monkeypatch.setattr(Stopwatch, "measure", interrupt)
    with pytest.raises(KeyboardInterrupt):
        asked(store, MORE, force)
    assert the_only(store).timed_by == QUICK
