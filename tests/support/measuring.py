"""Fixtures of measurements; what is compared runs in one test: calls beside the measured one are timed in turn with it.

`BENCH=full` measures at full size, otherwise each call runs once and small, as a test.
"""

import time
from functools import cache
from math import ceil
from statistics import median

import pytest
from full_size import FULL
from routes import Route

import vprbench
from vprbench.runs import machine
from vprbench.storage.cores import count_cores

BURST = 0.1  # seconds of calls one after the other
PAUSE = 0.01  # seconds after which the waiting threads of another library have gone to sleep
LONG = 1.0  # seconds of a call that is repeated less often


@pytest.fixture(scope="session", autouse=True)
def all_cores():
    """Measurements at full size use all cores."""
    if FULL:
        machine.pin_threads(count_cores())


@pytest.fixture(scope="session")
def size():
    """Return what chooses between the sizes of a measurement and of a test."""
    return lambda full, small: full if FULL else small


@pytest.fixture(scope="session")
def route():
    """Return what draws frames in memory: route(places, height, width)."""
    return cache(Route.draw)


@pytest.fixture(scope="session")
def build():
    """Return what makes a method of its name, device and arguments."""
    return lambda name, device="cpu", **arguments: vprbench.method(name, **arguments).build(device=device)


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
