"""Fixtures of measurements; what is compared runs in one test: calls beside the measured one are timed in turn with it.

`BENCH=full` measures at full size, otherwise each call runs once and small, as a test.
"""

import time
from dataclasses import dataclass
from functools import cache
from math import ceil
from statistics import median

import cv2
import numpy as np
import pytest
from full_size import FULL

import vprbench
from vprbench.api import Images
from vprbench.runs import machine
from vprbench.storage.cores import count_cores

PIXELS_PER_CELL = 4  # of the coarse grid that a frame is blown up from
NOISE = 12  # grey levels to either side by which a copy of a frame differs
QUERIES = 1_000_000  # a traverse number that no reference has


@dataclass(frozen=True)
class Route:
    """Frames (n_places, height, width) of uint8, one a place; a further traverse shows each with noise of its own."""

    frames: np.ndarray
    seed: int

    @classmethod
    def draw(cls, n_places, height=32, width=64, seed=0):
        """Draw the frames of a route."""
        generator = np.random.default_rng(seed)
        frames = np.empty((n_places, height, width), np.uint8)
        for frame in frames:
            coarse = generator.uniform(0, 255, (-(-height // PIXELS_PER_CELL), -(-width // PIXELS_PER_CELL)))
            blown_up = cv2.resize(coarse.astype(np.float32), (width, height), interpolation=cv2.INTER_CUBIC)
            np.clip(blown_up, 0, 255, out=frame, casting="unsafe")
        return cls(frames, seed)

    def references(self, n_places, traverses=1):
        """Return `traverses` traverses of the first places, and the place that each image shows."""
        shown = [self.frames[:n_places], *(self._noisy(np.arange(n_places), n) for n in range(1, traverses))]
        return Images.from_arrays([*np.concatenate(shown)]), np.tile(np.arange(n_places), traverses)

    def queries(self, n_places, count):
        """Return `count` noisy frames, evenly spread over the first places."""
        return Images.from_arrays([*self._noisy(np.linspace(0, n_places - 1, count).astype(np.int64), QUERIES)])

    def _noisy(self, places, traverse):
        generator = np.random.default_rng([self.seed, traverse])
        chosen = self.frames[places]
        noise = generator.integers(-NOISE, NOISE + 1, chosen.shape, np.int16)
        return np.clip(chosen + noise, 0, 255).astype(np.uint8)


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
