"""Runs of one host compute side by side, and each is timed alone; each has a GPU of its own."""

import fcntl
import subprocess
import sys
import time
from contextlib import contextmanager

import psutil
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
    with psutil.Popen([sys.executable, "-c", HOLDER.format(does)], stdout=subprocess.PIPE) as process:
        assert process.stdout.readline()
        yield process
        process.kill()


def test_a_run_is_timed_once_the_others_have_computed_and_none_begins_meanwhile(monkeypatch):
    with another("computing") as computes, timing_lock.computing():
        disturbed = timing_lock.undisturbed()
        assert not disturbed()
        monkeypatch.setattr(timing_lock, "PATIENCE_SECONDS", 0.2)
        with timing_lock.alone() as alone:
            assert not alone
        monkeypatch.setattr(timing_lock, "PATIENCE_SECONDS", 60.0)
        computes.kill()  # the system frees its lock
        with timing_lock.alone() as alone:
            assert alone
            late = (
                "import time\nfrom vprbench.runs import timing_lock as lock\nwith lock.computing(): print(time.time())"
            )
            begins = subprocess.Popen([sys.executable, "-c", late], stdout=subprocess.PIPE, text=True)
            time.sleep(0.5)
            timed = time.time()
        assert float(begins.communicate()[0]) > timed
        assert not disturbed()
    assert timing_lock.undisturbed()()


def test_a_run_that_waits_to_be_timed_goes_before_a_run_that_would_begin_to_compute(monkeypatch):
    waits = "from vprbench.runs import timing_lock as lock\nwith lock.alone() as alone: print(alone)"
    with another("computing"):
        waiting = subprocess.Popen([sys.executable, "-c", waits], stdout=subprocess.PIPE, text=True)
        with (timing_lock.folder() / "waiting").open("ab") as file:
            while not is_locked(file):
                time.sleep(0.05)
        monkeypatch.setattr(timing_lock, "PATIENCE_SECONDS", 0.2)
        began = time.monotonic()
        with timing_lock.computing():
            assert time.monotonic() - began >= 0.2
    assert waiting.communicate()[0] == "True\n"


def is_locked(file):
    """Tell whether another process holds a file alone."""
    try:
        fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    fcntl.flock(file, fcntl.LOCK_UN)
    return False
