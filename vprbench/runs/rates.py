"""Rates and percentiles of the laps that a stopwatch measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vprbench.runs.stopwatch import Laps, Seconds


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
