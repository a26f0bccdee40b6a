"""The machine under a run: how it is described, its fixed computation, and its memory."""

from __future__ import annotations

import itertools
import json
from pathlib import Path

import pytest
from held_memory import fall_in_a_new_window, in_a_new_process, peaks_of_runs, rise_in_a_window
from little import a_run

from vprbench.run import machine
from vprbench.run.machine import Machine

pytestmark = pytest.mark.usefixtures("surroundings")


def _windows_of_memory_exist() -> bool:
    try:
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
    except OSError:
        return False
    return True


in_a_window = pytest.mark.skipif(not _windows_of_memory_exist(), reason="this system keeps no window of peak memory")


def test_the_machine_is_described_in_values_that_json_can_hold() -> None:
    described = machine.capture("cpu", 1)
    assert json.loads(json.dumps(described, allow_nan=False)) == described
    assert all(described[name] for name in ("processor", "python", "threads", "cores", "memory_bytes", "load_average"))
    assert machine.canary_seconds() > 0
    assert machine.peak_device_memory_bytes("cpu") is None


def test_the_canary_takes_no_notice_of_an_interrupted_lap() -> None:
    laps = (1.0 if lap % 5 == 0 else 0.008 for lap in itertools.count())  # seconds
    moments = itertools.accumulate(round(lap * 1e9) for lap in laps)
    assert machine.canary_seconds(lambda: next(moments)) == 0.008


@in_a_window
def test_peak_memory_rises_by_200_megabytes_that_were_held_for_a_moment() -> None:
    assert 190e6 <= in_a_new_process(rise_in_a_window) <= 260e6


@in_a_window
def test_a_new_window_forgets_an_earlier_peak() -> None:
    assert in_a_new_process(fall_in_a_new_window) >= 150e6


@in_a_window
def test_a_run_knows_the_memory_that_its_method_took() -> None:
    before, large, small = in_a_new_process(peaks_of_runs)
    assert large - before >= 190e6
    assert small <= large - 150e6


# Which machine


def test_a_machine_is_the_same_on_another_day_and_names_what_its_times_depend_on() -> None:
    environment = a_run().environment
    here = Machine.of(environment)
    assert here == Machine.of({**environment, "time_utc": "2026-02-01T12:00:00Z", "load_average": [9.0, 9.0, 9.0]})
    assert here.line == "Abacus 9, 1 of 2 cores, torch 2.6.0"
    assert Machine.of({**environment, "accelerator": "Sieve X"}).line == "Abacus 9, 1 of 2 cores, Sieve X, torch 2.6.0"


@pytest.mark.parametrize(
    ("part", "value", "same_hardware"),
    [
        ("processor", "Abacus 10", False),
        ("cores", 4, False),
        ("accelerator", "Sieve X", False),
        ("threads", 2, True),
        ("libraries", {"torch": "2.7.0"}, True),
    ],
)
def test_another_part_is_another_machine(part: str, value: object, same_hardware: bool) -> None:
    here, there = Machine.of(a_run().environment), Machine.of({**a_run().environment, part: value})
    assert here != there
    assert (here.hardware == there.hardware) is same_hardware
