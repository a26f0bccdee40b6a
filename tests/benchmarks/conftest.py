"""Benchmarks of speed: `make bench` measures them at full size and writes results/bench.md, tests run each once, small.

What is compared runs in one test: the calls beside the measured one are timed in turn with it.
"""

import time
from functools import cache
from math import ceil
from statistics import median

import pytest
import torch
from full_size import FULL

import vprbench
from vprbench.gpu.check import Route
from vprbench.runs import machine

BURST = 0.1  # seconds of calls one after the other
PAUSE = 0.01  # seconds after which the waiting threads of another library have gone to sleep
LONG = 1.0  # seconds of a call that is repeated less often


def pytest_collection_modifyitems(items):
    for item in items:
        if item.path.parent.name == "benchmarks":
            item.add_marker(pytest.mark.extended)


@pytest.fixture(scope="session", autouse=True)
def _all_cores():
    if FULL:
        machine.pin_threads(len(machine.cores()))


@pytest.fixture(scope="session")
def size():
    """Return what chooses between the sizes of a benchmark and of a test."""
    return lambda full, small: full if FULL else small


@pytest.fixture(scope="session")
def route():
    """Return what draws frames in memory: route(places, height, width)."""
    return cache(Route.drawn)


@pytest.fixture(scope="session")
def build():
    """Return what makes a method of its name and arguments."""
    return lambda name, **arguments: vprbench.method(name, **arguments).build()


@pytest.fixture(scope="session")
def reads():
    """Return what reads, or reads and writes, so many bytes with all threads: what no method can be faster than."""

    def floor(n_bytes, write=False):
        buffer = torch.ones(max(1, n_bytes // 4))
        touch = (lambda: buffer.mul_(1.0)) if write else buffer.sum
        return {f"{'pass over' if write else 'read of'} {n_bytes / 1e6:,.3g} MB": touch}

    return floor


def seconds_of(call, times):
    started = time.perf_counter()
    for _ in range(times):
        call()
    return (time.perf_counter() - started) / times


@pytest.fixture
def measure(benchmark, request):
    """Return what times a call, with the number of images it takes, beside other calls, a burst of each in turn."""

    def measured(what, call, images=1, beside=None, **columns):
        calls = {"": call, **(beside or {})}
        once = {name: seconds_of(each, 1) for name, each in calls.items()}  # which compiles and fills caches
        if FULL:
            once |= {name: seconds_of(calls[name], 1) for name, seconds in once.items() if seconds < LONG}
        times = {name: ceil(BURST / seconds) if FULL else 1 for name, seconds in once.items()}
        laps = {name: [] for name in calls if name}

        def others():
            for name, seconds in laps.items():
                time.sleep(PAUSE)
                seconds.append(seconds_of(calls[name], times[name]))
            time.sleep(PAUSE)

        rounds = (2 if max(once.values()) > LONG else 10) if FULL else 1
        benchmark.group = request.module.__doc__
        benchmark.pedantic(seconds_of, (call, times[""]), setup=others, rounds=rounds)
        benchmark.extra_info |= {"what": what, "images": images, "calls": times[""], **columns}
        benchmark.extra_info["beside"] = {name: median(seconds) for name, seconds in laps.items()}

    return measured
