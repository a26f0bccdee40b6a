"""The timing protocol: streaming and offline laps of encode and match, measured from outside the method."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import numpy.typing as npt
from pydantic import ConfigDict, Field, with_config

from vprbench import progress
from vprbench.api.images import Images
from vprbench.api.method import limit_batch_size, require_codes
from vprbench.metrics.bounds import Count, Flag, Number, Positive
from vprbench.runs.scorers import Answer, QueryScorer, find_best_place
from vprbench.runs.timing_protocol import Protocol as Protocol  # callers ask the stopwatch

Clock = Callable[[], int]  # nanoseconds, monotonic
Seconds = npt.NDArray[np.float64]

_SAMPLE_BYTES = 1 << 29  # of decoded images held at once
_STEADY_QUERIES, _STEADY_SPREAD = 10, 0.1
_LONG_PASS = 4.0  # seconds of a pass over the sample; that of a slower method is smaller
_LONG_BATCH = 2.0  # seconds of a batch; larger ones are left out


@with_config(ConfigDict(extra="forbid", arbitrary_types_allowed=True))
@dataclass(frozen=True)
class Laps:
    """Raw times of one scenario, one element per call; `valid` says whether the protocol's minima were met."""

    encode_seconds: Seconds  # (n_calls,)
    match_seconds: Seconds  # (n_calls,)
    images_per_call: Positive
    valid: Flag

    @property
    def total_seconds(self) -> Seconds:
        """Encode and match together, (n_calls,)."""
        return self.encode_seconds + self.match_seconds

    @property
    def by_stage(self) -> tuple[Seconds, Seconds, Seconds]:
        """Encode, match and both together, (n_calls,) each."""
        return self.encode_seconds, self.match_seconds, self.total_seconds


@with_config(ConfigDict(extra="forbid", arbitrary_types_allowed=True))
@dataclass(frozen=True)
class Timing:
    """All that was measured of one method's queries."""

    first_query_seconds: Number  # of the first one after the fit
    warmup_queries: Count
    streaming: Laps
    offline: Annotated[tuple[Laps, ...], Field(min_length=1)]  # one per batch size
    sample: npt.NDArray[np.int64]  # (n_timed,), queries that were timed
    answers: npt.NDArray[np.int64]  # (n_timed,), the best place of each in the timed run; -1 if not reached


class Stopwatch:
    """Owns the clock: no method measures itself."""

    def __init__(
        self,
        protocol: Protocol,
        clock: Clock = time.perf_counter_ns,
        synchronise: Callable[[], None] = lambda: None,
        seed: int = 0,
    ) -> None:
        """Measure by `clock`, with `synchronise` at every boundary; `seed` draws the order of the queries."""
        self._protocol = protocol
        self._clock = clock
        self._synchronise = synchronise
        self._generator = np.random.default_rng(seed)

    @contextmanager
    def lap(self) -> Iterator[list[float]]:
        """Time the block, in seconds appended to the list it yields, the device idle at both ends."""
        seconds: list[float] = []
        self._synchronise()
        start = self._clock()
        yield seconds
        self._synchronise()
        seconds.append((self._clock() - start) / 1e9)

    def first_query(self, scorer: QueryScorer, images: Images) -> float:
        """Return the seconds of the first of `images`, decoded beforehand; raises BadInput if it is given no codes."""
        first = images[:1].in_memory()
        with self.lap() as lap:
            scorer.match(require_codes(scorer.encode(first), 1))
        return lap[0]

    def measure(self, scorer: QueryScorer, images: Images, first_query_seconds: float = 0.0) -> Timing:
        """Measure a fitted method on a sample of `images`, decoded beforehand; batches of large codes are smaller.

        A pass takes 4 s at most, unless the minimum of queries takes more: the sample of a slow method is smaller.
        `first_query_seconds` are the seconds of its first query, which was measured before.
        """
        chosen = _spread_numbers(len(images), self._protocol.sample)
        chosen = chosen[
            _spread_numbers(len(chosen), len(chosen) * _SAMPLE_BYTES // max(1, images[chosen].decoded_bytes()))
        ]
        sample = images[chosen].in_memory()
        with _pause_garbage_collection():
            progress.report("timing", 0.0)
            warmup = self._warm_up(scorer, sample)
            usual = float(np.median(warmup[-_STEADY_QUERIES:])) if warmup else 0.0
            if usual:
                some = _spread_numbers(len(sample), max(self._protocol.minimum_queries, int(_LONG_PASS / usual)))
                chosen, sample = chosen[some], sample[some]
            singles = [sample[i : i + 1] for i in range(len(sample))]
            streaming, answers = self._time_calls(scorer, singles)
            offline = self._time_batches(scorer, sample, streaming)
        return Timing(first_query_seconds, len(warmup), streaming, offline, chosen, answers)

    def _read_clock(self) -> float:
        """Return the clock in seconds."""
        return self._clock() / 1e9

    def _time_call(self, scorer: QueryScorer, images: Images) -> tuple[float, float, Answer]:
        """Return the seconds of encode and match, and the scores or the best places."""
        self._synchronise()
        start = self._clock()
        codes = scorer.encode(images)
        self._synchronise()
        encoded = self._clock()
        answer = scorer.match(codes)
        self._synchronise()
        return (encoded - start) / 1e9, (self._clock() - encoded) / 1e9, answer

    def _warm_up(self, scorer: QueryScorer, sample: Images) -> list[float]:
        """Return the seconds of the calls, which end once the last ones are alike, or after `maximum_seconds`."""
        laps: list[float] = []
        while len(laps) < self._protocol.warmup_queries and sum(laps) <= self._protocol.maximum_seconds:
            number = len(laps) % len(sample)
            encode, match, _ = self._time_call(scorer, sample[number : number + 1])
            laps.append(encode + match)
            last = laps[-_STEADY_QUERIES:]
            if len(last) == _STEADY_QUERIES and max(last) - min(last) <= _STEADY_SPREAD * max(last):
                break
        return laps

    def _time_batches(self, scorer: QueryScorer, sample: Images, streaming: Laps) -> tuple[Laps, ...]:
        """Return the laps of each batch size; the streaming ones for a size of one, and where no size is left.

        A size is left out whose call would be long at the rate of the size before. The first call of a size is not
        timed.
        """
        wanted = {min(size, len(sample)) for size in self._protocol.batch_sizes}
        sizes = sorted({limit_batch_size(size, scorer.code_bytes) for size in wanted})
        offline: list[Laps] = []
        last = streaming
        for done, size in enumerate(sizes):
            progress.report("timing", 0.2 + 0.8 * done / len(sizes))
            call = float(np.median(last.total_seconds)) / last.images_per_call * size
            if size == 1:
                offline.append(streaming)
            elif call <= min(_LONG_BATCH, self._protocol.maximum_seconds):
                batches = [sample[start : start + size] for start in range(0, len(sample) - size + 1, size)]
                self._time_call(scorer, batches[0])
                last, _ = self._time_calls(scorer, batches)
                offline.append(last)
        return tuple(offline) or (streaming,)

    def _time_calls(self, scorer: QueryScorer, calls: Sequence[Images]) -> tuple[Laps, npt.NDArray[np.int64]]:
        """Return the laps of `calls`, shuffled in each pass, and the best place of each one's first query.

        Laps end after a pass by which all minima are met, and after `maximum_seconds`.
        """
        protocol, size = self._protocol, len(calls[0])
        minimum = max(protocol.minimum_queries, protocol.minimum_passes * len(calls) * size)
        laps, answers = list[tuple[float, float]](), np.full(len(calls), -1)
        is_enough, is_late, started = False, False, self._read_clock()
        while not (is_enough or is_late):
            for number in self._generator.permutation(len(calls)).tolist():
                encode, match, answer = self._time_call(scorer, calls[number])
                laps.append((encode, match))
                answers[number] = find_best_place(answer)
                now = self._read_clock()
                if is_late := now - started > protocol.maximum_seconds:
                    break
            is_enough = now - started >= protocol.minimum_seconds and len(laps) * size >= minimum
        encodes, matches = np.array(laps).T
        return Laps(encodes, matches, size, is_enough), answers


def _spread_numbers(n: int, wanted: int) -> npt.NDArray[np.int64]:
    """Return the numbers of `wanted` of `n` images, spread over all: at least one, and no more than there are."""
    return np.linspace(0, n - 1, max(1, min(n, wanted))).astype(np.int64)


def make_synchroniser(device: str) -> Callable[[], None]:
    """Return a function that waits until `device` is idle."""
    if not device.startswith("cuda"):
        return lambda: None
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


def compute_streaming_rate(seconds: Seconds) -> float:
    """Return 1 / median of single-query times."""
    return 1 / float(np.median(seconds))


def compute_offline_rate(seconds: Seconds, images_per_call: int) -> float:
    """Return images per second over all calls."""
    return images_per_call * len(seconds) / float(seconds.sum())


def find_fastest_batch(offline: Sequence[Laps]) -> Laps:
    """Return the laps of the batch size with the highest total rate."""
    return max(offline, key=lambda laps: compute_offline_rate(laps.total_seconds, laps.images_per_call))


def estimate_percentile_bound(seconds: Seconds, share: float, confidence: float = 0.99) -> float | None:
    """Return the upper bound of a percentile at `confidence`, from order statistics; None if there are too few laps.

    At most h laps may lie above it, h the largest number with P(Binomial(n, 1 - share) <= h) <= 1 - confidence; at
    least one has to, so that a p90 needs 64 laps and a p99 662. Source: MLPerf LoadGen, sample counts.
    """
    from scipy.special import bdtr  # slow to import, and not needed to complain about an option

    n = len(seconds)
    allowed = int(np.searchsorted(bdtr(np.arange(n), n, 1 - share), 1 - confidence, "right")) - 1
    return float(np.sort(seconds)[-1 - allowed]) if allowed >= 1 else None
