"""What the benchmark of speed measures: a fit by its stages, rates of queries, and floors of memory."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from contextvars import copy_context
from dataclasses import dataclass
from itertools import count
from typing import Any, Literal, Protocol

import numpy as np
import psutil

from vprbench.api.arrays import Places
from vprbench.api.images import Images
from vprbench.api.method import Method
from vprbench.progress import Listener, listening, report
from vprbench.runs import machine, stopwatch
from vprbench.runs.rates import StageRates, best_batch, offline_rate, streaming_rate
from vprbench.runs.stopwatch import Stopwatch, synchroniser

BEFORE, AFTER = "before training", "after training"

_PAUSE = 0.01  # seconds after which the waiting threads of another library have gone to sleep
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
    """Raw seconds of both stages, one element per call, to the nanosecond."""

    images_per_call: int
    encode: list[float]
    match: list[float]

    @classmethod
    def of(cls, laps: stopwatch.Laps) -> Laps:
        """Take what the stopwatch measured."""
        return cls(laps.images_per_call, rounded(laps.encode_seconds), rounded(laps.match_seconds))

    def rates(self, rate: Callable[[stopwatch.Seconds, int], float] = offline_rate) -> StageRates:
        """Return the rates of seconds at so many images a call, those over all calls if no other is given."""
        encode, match = np.array(self.encode), np.array(self.match)
        return StageRates(*(rate(seconds, self.images_per_call) for seconds in (encode, match, encode + match)))


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
        streaming.rates(lambda seconds, _: streaming_rate(seconds)),
        best.rates(),
        best.images_per_call,
        all(laps.valid for laps in (timing.streaming, *timing.offline)),
        streaming,
        tuple(map(Laps.of, timing.offline)),
    )


def _shown(title: str) -> Listener:
    """Return a listener that passes reports, under a title, to the listener of now."""
    outside = copy_context()
    return lambda stage, done: outside.run(report, f"{title}: {stage}", done)


def floor_laps(touch: Literal["read", "pass"], n_bytes: int, device: str, minimum_seconds: float) -> list[float]:
    """Return the seconds of plain reads of a buffer, or of plain passes that read and write it in place.

    Both run in as many threads as PyTorch may use. What fits into the processor's caches stays there.
    """
    import torch

    buffer = torch.ones(max(1, n_bytes // 4), device=device)
    one_pass: Callable[[], object] = buffer.sum if touch == "read" else lambda: buffer.mul_(1.0)
    for _ in range(3):
        one_pass()
    return laps_of(one_pass, _FEWEST_PASSES, minimum_seconds, device=device, most=_MOST_PASSES)


def laps_of(call: Callable[[], object], fewest: int, minimum_seconds: float, **options: Any) -> list[float]:
    """Return the seconds of one call again and again, with the options of `interleaved`."""
    return interleaved({"call": lambda _: call()}, fewest, minimum_seconds, **options)["call"]


def interleaved(
    calls: Mapping[str, Callable[[int], object]],
    fewest: int,
    minimum_seconds: float,
    *,
    device: str = "cpu",
    most: int | None = None,
    burst: float = 0.0,
) -> dict[str, list[float]]:
    """Return the seconds of calls by their names, a call of each in every turn, whose number, from 1, it is given.

    It ends when there are `fewest` laps of each and all take `minimum_seconds`, or with `most` turns. With `burst`
    each is called for so many seconds in a turn, after a pause.
    """
    watch = Stopwatch(stopwatch.Protocol(), synchronise=synchroniser(device))
    laps: dict[str, list[float]] = {name: [] for name in calls}
    for turn in count(1):
        for name, call in calls.items():
            before = len(laps[name])
            if burst:
                time.sleep(_PAUSE)
            while len(laps[name]) == before or sum(laps[name][before:]) < burst:
                with watch.lap() as lap:
                    call(turn)
                laps[name] += lap
        enough = min(map(len, laps.values())) >= fewest and sum(map(sum, laps.values())) >= minimum_seconds
        if enough or turn == most:
            break
    return {name: rounded(seconds) for name, seconds in laps.items()}


def weight_bytes(method: Method, bytes_per_weight: int) -> int:
    """Return the bytes of all numbers in a fitted method's state, at so many bytes each."""
    return bytes_per_weight * sum(array.size for array in method.state().values())


def median(laps: Iterable[float]) -> float:
    """Return the median of seconds."""
    return float(np.median(list(laps)))


def rounded(seconds: Iterable[float]) -> list[float]:
    """Return seconds to the nanosecond, as plain numbers."""
    return [round(float(lap), 9) for lap in seconds]
