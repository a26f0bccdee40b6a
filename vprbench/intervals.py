"""How far an accuracy can be trusted: intervals for a share of queries and a paired test of two methods."""

from __future__ import annotations

from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
import numpy.typing as npt


@dataclass(frozen=True)
class Interval:
    """The two ends of a confidence interval."""

    low: float
    high: float


def wilson(successes: float, n: int, confidence: float = 0.95) -> Interval | None:
    """Return the Wilson score interval of a share, 0 to 1 (Wilson 1927); None without trials.

    Expected hits are not whole where scores tie, so `successes` may be any number from 0 to `n`. Takes the
    trials as independent: of consecutive frames it is too narrow, see `block_bootstrap`. Raises ValueError
    outside the ranges.
    """
    _check_confidence(confidence)
    if n < 0 or not 0 <= successes <= n:
        raise ValueError(f"{successes} successes of {n} trials are impossible: give 0 to n of n >= 0")
    if n == 0:
        return None
    z = NormalDist().inv_cdf((1 + confidence) / 2)
    share = float(successes) / n
    scale = 1 + z**2 / n
    centre = (share + z**2 / (2 * n)) / scale
    half = z * (share * (1 - share) / n + z**2 / (4 * n**2)) ** 0.5 / scale
    return Interval(max(centre - half, 0.0), min(centre + half, 1.0))


def block_bootstrap(
    values: npt.ArrayLike, block: int = 10, confidence: float = 0.95, resamples: int = 2000, seed: int = 0
) -> Interval | None:
    """Return the bootstrap interval of the mean of `values` (n_queries,), given in the order of the traverse.

    Consecutive frames see nearly the same, so blocks of `block` neighbours are drawn with replacement until
    there are as many values again; the last block is cut to fit. Blocks run on from the last value to the
    first, so that each value is drawn as often as any other (circular block bootstrap, Politis and Romano
    1992). The interval lies between the percentiles of the resampled means; the same seed gives the same one.
    None for fewer than two blocks.
    """
    _check_confidence(confidence)
    if block < 1 or resamples < 1:
        raise ValueError(f"block={block}, resamples={resamples}: both must be at least 1")
    row = np.asarray(values, dtype=np.float64)  # (n,)
    if row.ndim != 1 or not np.isfinite(row).all():
        raise ValueError(f"values must be finite and (n_queries,), but {row.shape} came or one is not finite")
    if len(row) < 2 * block:
        return None
    n_blocks, rest = divmod(len(row), block)
    random = np.random.default_rng(seed)
    sums = _circular_sums(row, block)[random.integers(len(row), size=(resamples, n_blocks))].sum(axis=1)
    sums += _circular_sums(row, rest)[random.integers(len(row), size=resamples)]
    tail = (1 - confidence) / 2
    low, high = np.quantile(sums / len(row), [tail, 1 - tail])
    return Interval(float(low), float(high))


def _circular_sums(row: npt.NDArray[np.float64], length: int) -> npt.NDArray[np.float64]:
    """Return for each start the sum of `length` values from there, (n,)."""
    running: npt.NDArray[np.float64] = np.cumsum(np.concatenate([[0.0], row, row[:length]]))
    return running[length : length + len(row)] - running[: len(row)]


@dataclass(frozen=True)
class McNemar:
    """On how many queries two methods disagree, and how likely so uneven a split is between equals."""

    b: int  # only the first is right
    c: int  # only the second is right
    p_value: float


def mcnemar_exact(hits_a: npt.ArrayLike, hits_b: npt.ArrayLike) -> McNemar:
    """Return the exact McNemar test of two methods on the same queries: hits 0 or 1, each (n_queries,).

    p = min(1, 2 sum_{i <= min(b, c)} C(b + c, i) / 2^(b + c)); 1 where they never disagree. A chance to be
    right is no trial: where scores tie, give the pessimistic hits. Raises ValueError for other values or
    different lengths.
    """
    from scipy.special import bdtr  # takes long to import

    first, second = np.asarray(hits_a, dtype=np.float64), np.asarray(hits_b, dtype=np.float64)
    if first.ndim != 1 or first.shape != second.shape:
        raise ValueError(f"a paired test needs hits on the same queries, not {first.shape} and {second.shape}")
    if not np.isin([first, second], (0, 1)).all():
        raise ValueError("a paired test needs hits of 0 or 1: where scores tie, give the pessimistic hits")
    b, c = (int(np.count_nonzero(only)) for only in (first > second, second > first))
    return McNemar(b, c, min(1.0, 2 * float(bdtr(min(b, c), b + c, 0.5))))


def _check_confidence(confidence: float) -> None:
    if not 0 < confidence < 1:
        raise ValueError(f"confidence={confidence} must lie between 0 and 1, for example 0.95")
