"""Whether a run is timed, for how long, when a stored one answers, and on which machine it was made."""

import fcntl
import itertools
import json
import logging
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest
from held_memory import in_a_new_process, peaks_of_runs
from little import Lookup, journey, numbers_in, slow_pictures
from little_runs import QUICK, asked_for, kinds, run_of, table
from stopped_clock import Clock

from vprbench import progress
from vprbench.config import make_request
from vprbench.plugins.entries import find_entries
from vprbench.runs import frame, machine, rows, timing_lock
from vprbench.runs.get_or_run import get_or_run
from vprbench.runs.stopwatch import Protocol

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
        **{"batch_sizes": [1, 32, 128], "maximum_seconds": 100.0, "rates": False},
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


def test_the_machine_is_described_in_values_that_json_can_hold_and_its_canary_notices_no_interrupted_lap():
    described = machine.describe_machine("cpu", 1)
    assert json.loads(json.dumps(described, allow_nan=False)) == described
    assert all(described[name] for name in ("processor", "python", "threads", "cores", "memory_bytes", "load_average"))
    assert machine.time_canary() > 0
    laps = (1.0 if lap % 5 == 0 else 0.008 for lap in itertools.count())  # seconds
    moments = itertools.accumulate(round(lap * 1e9) for lap in laps)
    assert machine.time_canary(lambda: next(moments)) == 0.008


@dataclass
class Learning(Lookup):
    """Reads all references and then computes for 60 ms; needs 5 ms for each image of a query, and 1 ms to match it.

    600 ms of the training may be left to the first image.
    """

    clock: Clock = field(kw_only=True)
    late: float = 0.0

    def fit(self, references, places):
        list(references)
        self.clock.spend(0.06)
        return self

    def encode(self, images):
        self.clock.spend(self.late + 0.005 * len(images))
        self.late = 0.0
        return super().encode(images)

    def match(self, codes):
        self.clock.spend(0.001 * len(codes))
        return super().match(codes)


@pytest.mark.parametrize("excess", [0, 0.6])
def test_times_of_fit_computing_first_query_method_and_harness_are_told_apart(clock, monkeypatch, surroundings, excess):
    monkeypatch.setattr(surroundings, "describe_machine", lambda *_: clock.spend(7) or {})  # takes 7 s
    references, queries = (slow_pictures(8, 0.02, clock.spend) for _ in range(2))
    numbers_in(references)  # what is read before a run does not count
    dataset = replace(journey(8, 8), references=references, queries=queries)
    run = run_of(Learning(table(8, 8), clock=clock, late=excess), dataset)
    shown = frame.list_numbers(run)
    assert (shown["fit_seconds"], shown["fit_compute_seconds"]) == pytest.approx((8 * 0.02 + 0.06, 0.06))
    assert run.timing.first_query_seconds == pytest.approx(0.006 + excess)
    assert rows.format_row(run)["fit s"] == "0.22"
    # the first query is asked once before
    assert run.method_seconds == pytest.approx(0.06 + 8 * 0.006 + 0.006 + excess)
    assert run.harness_seconds == pytest.approx(7)


def test_rates_are_called_invalid_without_their_minima_alone(clock):
    protocol = replace(QUICK, minimum_queries=3000, maximum_seconds=0.005)
    method = Learning(table(12, 4), clock=clock)
    assert "invalid" in kinds(run_of(method, journey(12, 4), protocol))
    assert not {"invalid", "offline"} & {*kinds(run_of(method, journey(12, 4)))}


@pytest.mark.parametrize(
    ("scores", "spoil", "differs"),
    [
        (table(12, 4), lambda scores, codes: np.roll(scores, len(codes) == 1, axis=1), True),  # for a single image
        (  # another last digit in a batch
            np.ones((12, 3), np.float32),
            lambda scores, codes: scores * np.where(np.arange(3) == len(codes) % 2, np.float32(1 + 1e-6), 1),
            False,
        ),
    ],
)
def test_a_note_says_that_a_method_answers_otherwise_when_it_is_timed(scores, spoil, differs):
    class Spoilt(Lookup):
        def match(self, codes):
            return spoil(self.table[codes], codes)

    assert ("answers" in kinds(run_of(Spoilt(scores), journey(*scores.shape)))) is differs


@pytest.mark.parametrize(
    ("waited", "after", "noisy"),
    [(None, 1.0, False), (1000, 1.0, True), (0.0, 1.04, False), (0.0, 1.06, True), (0.0, 0.94, True)],
)
def test_a_run_is_noisy_if_processes_waited_for_a_core_or_a_fixed_computation_drifts_by_more_than_five_percent(
    monkeypatch, surroundings, waited, after, noisy
):
    canaries = itertools.chain([1.0] * 3, itertools.repeat(after))  # until timing begins
    pressures = iter(range(9))
    monkeypatch.setattr(
        surroundings, "read_cpu_wait_seconds", lambda: None if waited is None else waited * next(pressures)
    )
    monkeypatch.setattr(surroundings, "time_canary", lambda: next(canaries))
    assert ("noisy" in kinds(run_of(Lookup(table(12, 4)), journey(12, 4)))) is noisy


def test_a_run_beside_others_says_so_of_its_fit_and_waits_to_be_timed_alone(tmp_path, monkeypatch):
    monkeypatch.setenv(timing_lock.FOLDER, str(tmp_path))
    with (timing_lock.folder() / "computing").open("ab") as of_another_run:

        def end_the_other(stage, _):
            if stage == "waiting to be timed":
                fcntl.flock(of_another_run, fcntl.LOCK_UN)

        for alone in (True, False):
            fcntl.flock(of_another_run, fcntl.LOCK_UN if alone else fcntl.LOCK_SH)
            with progress.send_reports_to(end_the_other):
                run = run_of(Lookup(table(12, 4)), journey(12, 4))
            numbers = frame.list_numbers(run)
            assert (numbers["fitted_alone"], numbers["timed_alone"]) == (alone, True)
            assert ("fitted" in kinds(run)) is not alone


@pytest.mark.extended
def test_a_run_knows_the_peak_of_memory_that_its_method_took_and_a_new_window_forgets_it():
    try:
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
    except OSError:
        pytest.skip("this system keeps no window of peak memory")
    before, large, small = in_a_new_process(peaks_of_runs)
    assert large - before >= 190e6
    assert small <= large - 150e6
