"""Runs of one host compute side by side, and each is timed alone."""

import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from itertools import pairwise

import pytest

from vprbench.runs import timing_lock

HOLDER = (
    "from vprbench.runs import timing_lock as lock\nwith lock.{}(): print(flush=True), __import__('time').sleep(60)"
)


@pytest.fixture(autouse=True)
def _host(tmp_path, monkeypatch):
    """Work on a host where nothing runs."""
    monkeypatch.setenv(timing_lock.FOLDER, str(tmp_path / "locks"))


@contextmanager
def another(does):
    """Let another process compute, or be alone."""
    with subprocess.Popen([sys.executable, "-c", HOLDER.format(does)], stdout=subprocess.PIPE) as process:
        assert process.stdout.readline()
        yield process
        process.kill()


def test_a_run_is_timed_once_the_others_have_computed_and_none_begins_meanwhile():
    with another("computing") as computes, timing_lock.computing():
        assert not timing_lock.is_only_run()
        threading.Timer(0.3, computes.kill).start()  # the system frees its lock
        with timing_lock.alone():
            computes.wait(20)
            late = (
                "import time\nfrom vprbench.runs import timing_lock as lock\nwith lock.computing(): print(time.time())"
            )
            begins = subprocess.Popen([sys.executable, "-c", late], stdout=subprocess.PIPE, text=True)
            time.sleep(0.5)
            timed = time.time()
        assert float(begins.communicate()[0]) > timed
        assert timing_lock.is_only_run()


def test_runs_that_compute_side_by_side_and_are_then_to_be_timed_are_timed_one_after_the_other():
    code = """
import time
from vprbench.runs import timing_lock as lock
with lock.computing():
    print(flush=True)
    time.sleep(0.3)
    with lock.alone():
        begun = time.time()
        time.sleep(0.2)
        print(begun, time.time())
"""
    runs = [subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) for _ in range(3)]
    times = sorted([float(moment) for moment in run.communicate()[0].split()] for run in runs)
    assert all(one[1] <= next[0] for one, next in pairwise(times))
