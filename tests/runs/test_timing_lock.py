"""Runs of one host compute side by side, and each is timed alone."""

import subprocess
import sys
import threading
import time
from itertools import pairwise

import pytest

from vprbench.runs import timing_lock
from vprbench.runs.timing_lock import share_host

COMPUTE = """
import time
from vprbench.runs.timing_lock import share_host
with share_host() as lock:
    print(time.time(), flush=True)
    time.sleep({})
"""
TIMED = """
    with lock.hold_alone():
        began = time.time()
        time.sleep(0.2)
        print(began, time.time())
"""


@pytest.fixture(autouse=True)
def _host(tmp_path, monkeypatch):
    """Work on a host where nothing runs."""
    monkeypatch.setenv(timing_lock.FOLDER, str(tmp_path / "locks"))


def start(code, seconds):
    """Start a process that computes for so many seconds."""
    return subprocess.Popen([sys.executable, "-c", code.format(seconds)], stdout=subprocess.PIPE, text=True)


def test_a_run_is_timed_once_the_others_have_computed_and_none_begins_meanwhile():
    with start(COMPUTE, 60) as computes:
        assert computes.stdout.readline()
        with share_host() as lock, share_host(lock) as same:
            assert same is lock
            assert not lock.is_only_run()
            threading.Timer(0.3, computes.kill).start()  # the system frees its lock
            with lock.hold_alone():
                computes.wait(20)
                begins = start(COMPUTE, 0)
                time.sleep(0.5)
                timed = time.time()
            assert float(begins.communicate()[0]) > timed
            assert lock.is_only_run()


def test_runs_that_compute_side_by_side_and_are_then_to_be_timed_are_timed_one_after_the_other():
    runs = [start(COMPUTE + TIMED, 0.3) for _ in range(3)]
    times = sorted([float(moment) for moment in run.communicate()[0].split()[1:]] for run in runs)
    assert all(one[1] <= next[0] for one, next in pairwise(times))
