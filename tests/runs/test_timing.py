"""Whether a run is timed, for how long, when a stored one answers, and on which machine it was made."""

import itertools
import json
import logging
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from held_memory import fall_in_a_new_window, in_a_new_process, peaks_of_runs, rise_in_a_window
from little import Lookup, a_run, journey
from little_runs import QUICK, asked_for, kinds, table

from vprbench.config import make_request
from vprbench.plugins.entries import find_entries
from vprbench.runs import machine
from vprbench.runs.get_or_run import get_or_run
from vprbench.runs.machine import Machine
from vprbench.runs.stopwatch import Protocol, Stopwatch
from vprbench.runs.store import Store

pytestmark = pytest.mark.usefixtures("surroundings")

UNTIMED = replace(QUICK, rates=False)
MORE = replace(QUICK, minimum_queries=6)


def asked(store, protocol, force=False):
    return get_or_run(asked_for(Lookup(table(12, 4)), journey(12, 4), protocol, force=force), store)


def test_a_run_is_made_again_where_it_was_timed_by_less_than_asked_for_and_not_where_by_more(store, caplog):
    caplog.set_level(logging.INFO)
    answers = [asked(store, protocol) for protocol in (UNTIMED, UNTIMED, QUICK, UNTIMED, MORE, QUICK)]
    told = [record.getMessage() for record in caplog.records if "running again" in record.getMessage()]
    assert ["minimum_queries" in line for line in told] == [False, True]
    assert [answer.from_store for answer in answers] == [False, True, False, True, False, True]
    assert [answer.run.timing is None for answer in answers] == [True, True, False, False, False, False]
    assert len({answer.folder for answer in answers}) == 1
    assert [run.timed_by for run in store.runs()] == [MORE]


def test_a_protocol_that_measures_less_falls_short_by_name_and_the_named_ones_answer_one_another_in_their_order():
    for name, value in {
        **{"minimum_seconds": 0.5, "minimum_queries": 63, "sample": 255},
        **{"batch_sizes": [1, 32, 128], "total_seconds": 100.0, "rates": False},
    }.items():
        less = replace(Protocol(), **{name: value})
        assert (less.shortfalls(Protocol()), Protocol().shortfalls(less)) == ([name], [])
    assert not QUICK.shortfalls(QUICK)
    assert not QUICK.shortfalls(UNTIMED)
    order = ["none", "quick", "standard", "publish"]
    assert [*find_entries("timing")] == sorted(order)
    named = {name: make_request([f"timing={name}"]).timing for name in order}
    for number, name in enumerate(order):
        assert [bool(named[name].shortfalls(named[other])) for other in order] == [i > number for i in range(4)]
    assert named["standard"] == Protocol() == make_request().timing
    changed = make_request(["timing=quick", "timing.minimum_seconds=1"]).timing
    assert changed == replace(named["quick"], minimum_seconds=1)


def interrupt(*_):
    raise KeyboardInterrupt


def test_a_run_that_is_ended_while_it_is_timed_leaves_its_answers_and_what_was_timed_before(store, monkeypatch):
    whole = asked(Store(store.root.parent / "other"), QUICK).run
    with monkeypatch.context() as patch:
        patch.setattr(Stopwatch, "measure", interrupt)
        with pytest.raises(KeyboardInterrupt):
            asked(store, QUICK)
    (kept,) = store.runs()
    assert (kept.timing, kept.config["timing"], kinds(kept)) == (None, None, kinds(whole))
    np.testing.assert_array_equal(kept.outcome.above, whole.outcome.above)
    np.testing.assert_array_equal(kept.top_places, whole.top_places)
    assert asked(store, UNTIMED).from_store
    assert not asked(store, QUICK).from_store
    monkeypatch.setattr(Stopwatch, "measure", interrupt)
    for force in (False, True):
        with pytest.raises(KeyboardInterrupt):
            asked(store, MORE, force)
        assert [run.timed_by for run in store.runs()] == [QUICK]


def test_the_machine_is_described_in_values_that_json_can_hold_and_its_canary_notices_no_interrupted_lap():
    described = machine.describe_machine("cpu", 1)
    assert json.loads(json.dumps(described, allow_nan=False)) == described
    assert all(described[name] for name in ("processor", "python", "threads", "cores", "memory_bytes", "load_average"))
    assert machine.time_canary() > 0
    laps = (1.0 if lap % 5 == 0 else 0.008 for lap in itertools.count())  # seconds
    moments = itertools.accumulate(round(lap * 1e9) for lap in laps)
    assert machine.time_canary(lambda: next(moments)) == 0.008


@pytest.mark.extended
def test_a_run_knows_the_peak_of_memory_that_its_method_took_and_a_new_window_forgets_it():
    try:
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
    except OSError:
        pytest.skip("this system keeps no window of peak memory")
    assert 190e6 <= in_a_new_process(rise_in_a_window) <= 260e6
    assert in_a_new_process(fall_in_a_new_window) >= 150e6
    before, large, small = in_a_new_process(peaks_of_runs)
    assert large - before >= 190e6
    assert small <= large - 150e6


def test_another_part_is_another_machine_and_another_day_is_not():
    here = Machine.of(a_run().environment)
    assert here.line == "Abacus 9, 1 of 2 cores, torch 2.6.0"
    for same_hardware, others in {
        False: {"processor": "Abacus 10", "cores": 4, "accelerator": "Sieve"},
        True: {"threads": 2, "libraries": {"torch": "2.7.0"}},
        None: {"time_utc": "2026-02-01T12:00:00Z", "load_average": [9.0] * 3},
    }.items():
        for part, value in others.items():
            there = Machine.of({**a_run().environment, part: value})
            assert (here == there) is (same_hardware is None)
            assert (here.hardware == there.hardware) is (same_hardware is not False)
            assert ("Sieve" in there.line) is (value == "Sieve")
