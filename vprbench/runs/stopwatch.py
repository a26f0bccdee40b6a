"""The timing protocol: streaming and offline laps of encode and match, measured from outside the method."""

from __future__ import annotations

import gc
import itertools
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
import numpy.typing as npt
from pydantic import ConfigDict, Field, with_config

from vprbench import progress
from vprbench.api.images import Images
from vprbench.api.method import batch_size_for, require_codes
from vprbench.metrics.bounds import INTEGERS, NUMBERS, Array, Count, Flag, Number, Positive
from vprbench.runs.scorers import Answer, Scorer, best_place
from vprbench.runs.timing_protocol import Protocol as Protocol  # callers ask the stopwatch

Clock = Callable[[], int]  # nanoseconds, monotonic
Seconds = npt.NDArray[np.float64]

_SAMPLE_BYTES = 1 << 29  # of decoded images held at once
_STEADY_QUERIES, _STEADY_SPREAD = 10, 0.1
_LONG_PASS, _LONG_CALL = 4.0, 1.0  # seconds, at most, of a slow method
_GAIN = 1.25  # times the rate: machines vary by less
_SHARES = (0.15, 0.5)  # of `total_seconds`, by which warm-up and streaming have to end


def _do_nothing() -> None:
    """Synchronise a device that does nothing behind the caller's back."""


_LAP = Array(NUMBERS, (None,), 0, 1e9, positive_median=True)


@with_config(ConfigDict(extra="forbid"))
@dataclass(frozen=True)
class Laps:
    """Raw times of one scenario, one element per call; `valid` says whether the protocol's minima were met."""

    encode_seconds: Annotated[Seconds, _LAP]  # (n_calls,)
    match_seconds: Annotated[Seconds, _LAP]  # (n_calls,)
    images_per_call: Positive
    valid: Flag

    @property
    def total_seconds(self) -> Seconds:
        """Encode and match together, (n_calls,)."""
        return self.encode_seconds + self.match_seconds

    def per_image(self) -> float:
        """Return the median seconds."""
        return float(np.median(self.total_seconds)) / self.images_per_call

    @property
    def by_stage(self) -> tuple[Seconds, Seconds, Seconds]:
        """Encode, match and both together, (n_calls,) each."""
        return self.encode_seconds, self.match_seconds, self.total_seconds


@with_config(ConfigDict(extra="forbid"))
@dataclass(frozen=True)
class Timing:
    """All that was measured of one method's queries."""

    first_query_seconds: Number  # of the first one after the fit
    warmup_queries: Count
    streaming: Laps
    offline: Annotated[tuple[Laps, ...], Field(min_length=1)]  # one per batch size
    sample: Annotated[npt.NDArray[np.int64], Array(INTEGERS, ("sample",), 0, "last query")]  # queries that were timed
    answers: Annotated[  # the best place of each in the timed run; -1 if not reached
        npt.NDArray[np.int64], Array(INTEGERS, ("sample",), -1, "last place")
    ]


class Stopwatch:
    """Owns the clock: no method measures itself."""

    def __init__(
        self,
        protocol: Protocol,
        clock: Clock = time.perf_counter_ns,
        synchronise: Callable[[], None] = _do_nothing,
        seed: int = 0,
    ) -> None:
        """Measure by `clock`, with `synchronise` at every boundary; `seed` draws the order of the queries."""
        self._protocol = protocol
        self._clock = clock
        self._synchronise = synchronise
        self._generator = np.random.default_rng(seed)
        self._end = float("inf")  # of the present measurement, by the clock

    @contextmanager
    def lap(self) -> Iterator[list[float]]:
        """Time the block, in seconds appended to the list it yields, the device idle at both ends."""
        seconds: list[float] = []
        self._synchronise()
        start = self._clock()
        yield seconds
        self._synchronise()
        seconds.append((self._clock() - start) / 1e9)

    def first_query(self, scorer: Scorer, images: Images) -> float:
        """Return the seconds of the first of `images`, decoded beforehand; raises BadInput if it is given no codes."""
        first = images[:1].in_memory()
        try:
            return sum(self._call(scorer, first)[:2])
        except Exception:
            require_codes(scorer.encode(first), 1)  # checked outside of timed calls
            raise

    def measure(self, scorer: Scorer, images: Images, first_query_seconds: float = 0.0) -> Timing:
        """Measure a fitted method on a sample of `images`, decoded beforehand; batches of large codes are smaller.

        A pass takes 4 s at most, unless the minimum of queries takes more: the sample of a slow method is smaller.
        `first_query_seconds` are the seconds of its first query, asked before.
        """
        chosen = _choose_sample(images, self._protocol.sample)
        sample, count = images[chosen].in_memory(), len(chosen)
        singles = [sample[np.array([i])] for i in range(count)]
        with _pause_garbage_collection():
            progress.report("timing", 0.0)
            began = self._clock()
            self._end_after(began, _SHARES[0])
            warmup = self._warm_up(scorer, singles, first_query_seconds)
            usual = float(np.median(warmup[-_STEADY_QUERIES:])) if warmup else 0.0
            if usual and (few := max(self._protocol.minimum_queries, int(_LONG_PASS / usual))) < count:
                some = np.linspace(0, count - 1, few).astype(np.int64)
                chosen, sample, singles = chosen[some], sample[some], [singles[i] for i in some]
            self._end_after(began, _SHARES[1])
            streaming, answers = self._stream(scorer, singles)
            progress.report("timing", 0.2)
            offline = self._offline(scorer, sample, streaming, began)
        return Timing(first_query_seconds, len(warmup), streaming, offline, chosen, answers)

    def _call(self, scorer: Scorer, images: Images) -> tuple[float, float, Answer]:
        """Return the seconds of encode and match, and the scores or the best places."""
        self._synchronise()
        start = self._clock()
        codes = scorer.encode(images)
        self._synchronise()
        encoded = self._clock()
        scores = scorer.match(codes)
        self._synchronise()
        matched = self._clock()
        return (encoded - start) / 1e9, (matched - encoded) / 1e9, scores

    def _warm_up(self, scorer: Scorer, singles: Sequence[Images], usual: float) -> list[float]:
        """Return the seconds of the calls; `usual` is the expected time of one."""
        laps: list[float] = []
        started = self._clock()
        while len(laps) < self._protocol.warmup_queries and not self._late(started, usual):
            encode, match, _ = self._call(scorer, singles[len(laps) % len(singles)])
            laps.append(usual := encode + match)
            last = laps[-_STEADY_QUERIES:]
            if len(last) == _STEADY_QUERIES and max(last) - min(last) <= _STEADY_SPREAD * max(last):
                break
        return laps

    def _stream(self, scorer: Scorer, singles: Sequence[Images]) -> tuple[Laps, npt.NDArray[np.int64]]:
        """Return the laps of single queries, shuffled in each pass, and the best place of each."""
        passes = (self._generator.permutation(len(singles)).tolist() for _ in itertools.count())
        return self._time(scorer, singles, passes, len(singles))

    def _time(
        self, scorer: Scorer, calls: Sequence[Images], passes: Iterable[Sequence[int]], queries_a_pass: int
    ) -> tuple[Laps, npt.NDArray[np.int64]]:
        """Return the laps of `calls`, in the order of the numbers in `passes`, and the best place of each one's first.

        Laps end after a pass by which all minima are met, and when they take too long.
        """
        laps: list[tuple[float, float]] = []
        size, answers = len(calls[0]), np.full(len(calls), -1)
        finished, late, started = False, False, self._clock()
        for numbers in passes:
            if (finished := self._finished(len(laps) * size, queries_a_pass, started)) or late:
                break
            for number in numbers:
                encode, match, answer = self._call(scorer, calls[number])
                laps.append((encode, match))
                answers[number] = best_place(answer)
                if late := self._late(started, encode + match):
                    break
        encodes, matches = (np.array(seconds) for seconds in zip(*laps, strict=True))
        return Laps(encodes, matches, size, finished), answers

    def _offline(self, scorer: Scorer, sample: Images, streaming: Laps, began: int) -> tuple[Laps, ...]:
        """Return the laps of each batch size whose calls fit into the time left; at least the streaming ones, of one.

        Batches whose call is long are left out once larger ones no longer gain.
        """
        sizes = sorted({batch_size_for(scorer, min(size, len(sample))) for size in self._protocol.batch_sizes})
        offline, last, gains = list[Laps](), streaming, True
        for done, size in enumerate(sizes):
            progress.report("timing", 0.3 + 0.7 * done / len(sizes))
            self._end_after(began, _SHARES[1] + (1 - _SHARES[1]) * (done + 1) / len(sizes))
            call = last.per_image() * size  # at most
            if size == 1:
                offline.append(streaming)
            elif not self._over(2 * call) and (gains or call <= _LONG_CALL):  # one is not timed
                before, last = last, self._batch(scorer, sample, size)
                gains = before.per_image() >= _GAIN * last.per_image()
                offline.append(last)
        return tuple(offline) or (replace(streaming, valid=False),)

    def _batch(self, scorer: Scorer, sample: Images, size: int) -> Laps:
        """Return the laps of whole batches of a size; the first call is not timed."""
        batches = [sample[start : start + size] for start in range(0, len(sample) - size + 1, size)]
        self._call(scorer, batches[0])
        one_by_one = ([number] for number in itertools.cycle(range(len(batches))))
        return self._time(scorer, batches, one_by_one, len(sample))[0]

    def _finished(self, queries: int, per_pass: int, started: int) -> bool:
        protocol = self._protocol
        long_enough = (self._clock() - started) / 1e9 >= protocol.minimum_seconds
        return long_enough and queries >= max(protocol.minimum_queries, protocol.minimum_passes * per_pass)

    def _end_after(self, began: int, share: float) -> None:
        """Let the next measurement end before a share of `total_seconds` is over, but for a single call."""
        total = self._protocol.total_seconds
        self._end = float("inf") if total is None else began + share * total * 1e9

    def _late(self, started: int, coming: float) -> bool:
        """Tell whether no call that takes `coming` seconds may follow."""
        return (self._clock() - started) / 1e9 > self._protocol.maximum_seconds or self._over(coming)

    def _over(self, coming: float) -> bool:
        return self._clock() + coming * 1e9 > self._end


def _choose_sample(images: Images, wanted: int) -> npt.NDArray[np.int64]:
    """Return `wanted` images spread over all, fewer if these would fill more than the bytes that may be held."""
    count = min(len(images), wanted)
    while True:
        chosen = np.linspace(0, len(images) - 1, count).astype(np.int64)
        n_bytes = images[chosen].decoded_bytes()
        if n_bytes <= _SAMPLE_BYTES or count == 1:
            return chosen
        count = max(1, min(count - 1, count * _SAMPLE_BYTES // n_bytes))


def make_synchroniser(device: str) -> Callable[[], None]:
    """Return a function that waits until `device` is idle."""
    if not device.startswith("cuda"):
        return _do_nothing
    import torch

    return lambda: torch.cuda.synchronize(device)


@contextmanager
def _pause_garbage_collection() -> Iterator[None]:
    """Keep the garbage collector out of the timed window."""
    gc.collect()
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()


def streaming_rate(seconds: Seconds) -> float:
    """Return 1 / median of single-query times."""
    return 1 / float(np.median(seconds))


def offline_rate(seconds: Seconds, images_per_call: int) -> float:
    """Return images per second over all calls."""
    return images_per_call * len(seconds) / float(seconds.sum())


@dataclass(frozen=True)
class StageRates:
    """Images per second of each stage, and of both together."""

    encode: float
    match: float
    total: float

    @classmethod
    def streaming(cls, laps: Laps) -> StageRates:
        """Return 1 / median of single queries."""
        return cls(*(streaming_rate(seconds) for seconds in laps.by_stage))

    @classmethod
    def offline(cls, laps: Laps) -> StageRates:
        """Return images per second over all calls."""
        return cls(*(offline_rate(seconds, laps.images_per_call) for seconds in laps.by_stage))


def best_batch(offline: Sequence[Laps]) -> Laps:
    """Return the laps of the batch size with the highest total rate."""
    return max(offline, key=lambda laps: offline_rate(laps.total_seconds, laps.images_per_call))


def percentile_bound(seconds: Seconds, share: float, confidence: float = 0.99) -> float | None:
    """Return the upper bound of a percentile at `confidence`, from order statistics; None if there are too few laps.

    At most h laps may lie above it, h the largest number with P(Binomial(n, 1 - share) <= h) <= 1 - confidence; at
    least one has to, so that a p90 needs 64 laps and a p99 662. Source: MLPerf LoadGen, sample counts.
    """
    from scipy.stats import binom  # slow to import, and not needed to complain about an option

    allowed = int(binom.ppf(1 - confidence, len(seconds), 1 - share)) - 1 if len(seconds) else -1
    if allowed >= -1 and binom.cdf(allowed + 1, len(seconds), 1 - share) <= 1 - confidence:
        allowed += 1
    if allowed < 1:
        return None
    return float(np.sort(seconds)[::-1][allowed])
