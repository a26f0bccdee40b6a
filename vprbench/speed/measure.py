"""What the benchmark of speed measures: a fit by its stages, rates of queries, and floors of memory."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from contextvars import copy_context
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import numpy as np
import psutil

from vprbench.api.arrays import Places
from vprbench.api.images import Images
from vprbench.api.method import Method
from vprbench.progress import Listener, listening, report
from vprbench.run import machine, stopwatch
from vprbench.run.rates import StageRates, best_batch, offline_rate, streaming_rate
from vprbench.run.stopwatch import Stopwatch, synchroniser

BEFORE, AFTER = "before training", "after training"

_FEWEST_PASSES, _MOST_PASSES = 20, 1000  # over a buffer, for a floor


class Make(Protocol):
    """Builds a method by its registered name, for a device, with arguments other than those of its yaml."""

    def __call__(self, name: str, device: str, **arguments: Any) -> Method:
        """Return the method, not yet fitted."""


@dataclass(frozen=True)
class Fit:
    """One fit, from images in memory."""

    seconds: float
    stages: dict[str, float]  # seconds from a stage's first report of progress to that of the next
    memory_before_bytes: int  # resident in this process
    peak_memory_bytes: int  # of this process, what was resident before included
    peak_device_memory_bytes: int | None  # since the process began

    @property
    def training_seconds(self) -> float:
        """From the first report of the training's progress to the last."""
        return sum(seconds for stage, seconds in self.stages.items() if stage not in (BEFORE, AFTER))


@dataclass(frozen=True)
class Laps:
    """Raw seconds of both stages, one element per call."""

    images_per_call: int
    encode: list[float]
    match: list[float]

    @classmethod
    def of(cls, laps: stopwatch.Laps) -> Laps:
        """Take what the stopwatch measured, to the nanosecond."""
        return cls(laps.images_per_call, rounded(laps.encode_seconds), rounded(laps.match_seconds))

    def streaming_rates(self) -> StageRates:
        """Return 1 / median of single queries."""
        return self._rates(lambda seconds: streaming_rate(seconds).hz)

    def offline_rates(self) -> StageRates:
        """Return images per second over all calls."""
        return self._rates(lambda seconds: offline_rate(seconds, self.images_per_call))

    def _rates(self, rate: Callable[[stopwatch.Seconds], float]) -> StageRates:
        encode, match = np.array(self.encode), np.array(self.match)
        return StageRates(rate(encode), rate(match), rate(encode + match))


@dataclass(frozen=True)
class Rates:
    """Rates of a fitted method with the laps that they come from."""

    streaming: StageRates  # 1 / median of a single query
    offline: StageRates  # of the fastest batch size
    offline_batch: int
    valid: bool  # the protocol's minima were met
    streaming_laps: Laps
    offline_laps: tuple[Laps, ...]


def timed_fit(title: str, method: Method, references: Images, places: Places, device: str) -> Fit:
    """Fit a method, and say how long each of the stages took that it reports; its progress is shown under `title`."""
    synchronise, show = synchroniser(device), _shown(title)
    marks: dict[str, float] = {}
    last = 0.0

    def note(stage: str, done: float) -> None:
        nonlocal last
        if stage not in marks or done == 1:  # in between a GPU works ahead of what is reported
            synchronise()
        last = time.perf_counter()
        marks.setdefault(stage, last)
        show(stage, done)

    machine.reset_peak_memory()
    before = psutil.Process().memory_info().rss
    with listening(note), Stopwatch(stopwatch.Protocol(), synchronise=synchronise).lap() as lap:
        started = time.perf_counter()
        method.fit(references, places)
    peak = machine.peak_memory_bytes()
    stages = {}
    if marks:
        ends = [*list(marks.values())[1:], last]
        stages = {stage: end - first for (stage, first), end in zip(marks.items(), ends, strict=True)}
        stages = {BEFORE: next(iter(marks.values())) - started, **stages, AFTER: started + lap[0] - last}
    return Fit(lap[0], stages, before, peak, machine.peak_device_memory_bytes(device))


def measured_rates(title: str, method: Method, queries: Images, protocol: stopwatch.Protocol, device: str) -> Rates:
    """Measure the queries of a fitted method, with images in memory; its progress is shown under `title`."""
    with listening(_shown(title)):
        timing = Stopwatch(protocol, synchronise=synchroniser(device)).measure(method, queries)
    streaming = Laps.of(timing.streaming)
    best = Laps.of(best_batch(timing.offline))
    return Rates(
        streaming.streaming_rates(),
        best.offline_rates(),
        best.images_per_call,
        all(laps.valid for laps in (timing.streaming, *timing.offline)),
        streaming,
        tuple(map(Laps.of, timing.offline)),
    )


def _shown(title: str) -> Listener:
    """Return what passes reports, under a title, to whoever listens now."""
    outside = copy_context()
    return lambda stage, done: outside.run(report, f"{title}: {stage}", done)


def floor_laps(touch: Literal["read", "pass"], n_bytes: int, device: str, minimum_seconds: float) -> list[float]:
    """Return the seconds of plain reads of a buffer, or of plain passes that read and write it in place.

    Both run in as many threads as PyTorch may use. What fits into the processor's caches stays there.
    """
    import torch

    buffer = torch.ones(max(1, n_bytes // 4), device=device)
    one_pass: Callable[[], object] = buffer.sum if touch == "read" else lambda: buffer.mul_(1.0)
    watch = Stopwatch(stopwatch.Protocol(), synchronise=synchroniser(device))
    for _ in range(3):
        one_pass()
    laps: list[float] = []
    while len(laps) < _FEWEST_PASSES or (len(laps) < _MOST_PASSES and sum(laps) < minimum_seconds):
        with watch.lap() as lap:
            one_pass()
        laps += lap
    return rounded(laps)


def weight_bytes(method: Method, bytes_per_weight: int) -> int:
    """Return the bytes of all numbers in a fitted method's state, at so many bytes each."""
    return bytes_per_weight * sum(array.size for array in method.state().values())


def median(laps: Iterable[float]) -> float:
    """Return the median of seconds."""
    return float(np.median(list(laps)))


def rounded(seconds: Iterable[float]) -> list[float]:
    """Return seconds to the nanosecond, as plain numbers."""
    return [round(float(lap), 9) for lap in seconds]
