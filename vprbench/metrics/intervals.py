"""How far an accuracy can be trusted: intervals for a share of queries and a paired test of two methods."""

from __future__ import annotations

import math
from dataclasses import dataclass
from statistics import NormalDist
from typing import Literal

import numpy as np
import numpy.typing as npt

Values = npt.NDArray[np.float64]

_SIGNIFICANT = 2.0  # times sqrt(log10 n / n): the constant c that Politis and White recommend
FEWEST = 20  # values: with fewer, autocorrelation is not told from chance
_PARTS = 12  # of a hit, at least, that sums are told apart by: halves, thirds and quarters are exact
_GRID_POINTS = 1 << 14  # of a sum, about: few queries are told apart more finely


def block_length(values: npt.ArrayLike) -> int:
    """Return the block length of the circular bootstrap of the mean of `values` (n,), given along the journey.

    The automatic rule of Politis and White (2004) with the correction of Patton, Politis and White (2009):
    b = (2 G^2 / D)^(1/3) n^(1/3), D = 4/3 g(0)^2, where g(0) = sum of w(k / M) R(k) and G = sum of w(k / M) |k| R(k)
    over lags k = -M ... M of the autocovariance R, with the flat-top window w. M is twice the lag after which
    K = max(5, sqrt(log10 n)) autocorrelations in a row are insignificant, twice the last significant one if there is
    no such row; lags beyond sqrt(n) + K are not looked at. Rounded up, at least 1 and at most min(3 sqrt(n), n / 3). 1
    for equal values and for fewer than 20. Raises ValueError for values that are not finite or not (n,).
    """
    row = _require_finite_row(values)
    n = len(row)
    if n < FEWEST or np.ptp(row) == 0:
        return 1
    covariances = _compute_autocovariances(row)
    within = max(5, math.ceil(math.sqrt(math.log10(n))))
    furthest = math.ceil(math.sqrt(n)) + within
    significant = np.abs(covariances / covariances[0]) >= _SIGNIFICANT * math.sqrt(math.log10(n) / n)
    width = min(2 * max(1, _find_last_lag(significant[: furthest + 1], within)), furthest)
    lags = np.arange(1, width + 1)
    weighted = np.clip(2 * (1 - lags / width), 0, 1) * covariances[1 : width + 1]
    at_zero = float(covariances[0] + 2 * weighted.sum())
    slope = float(2 * (lags * weighted).sum())
    most = math.floor(min(3 * math.sqrt(n), n / 3))
    if at_zero**2 * most**3 <= 1.5 * slope**2 * n:  # the same as length >= most, without dividing by what may be 0
        return most
    return max(1, math.ceil(math.cbrt(1.5 * (slope / at_zero) ** 2 * n)))


def _require_finite_row(values: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """Return `values` as float64 (n,); raises ValueError if one is not finite or the shape is another."""
    row = np.asarray(values, dtype=np.float64)
    if row.ndim != 1 or not np.isfinite(row).all():
        raise ValueError(f"values must be finite and (n_queries,), but {row.shape} came or one is not finite")
    return row


def _compute_autocovariances(row: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return the autocovariances at all lags from 0, (n,), each a sum of products over n."""
    spectrum = np.fft.rfft(row - row.mean(), 2 * len(row))
    return np.asarray(np.fft.irfft(np.abs(spectrum) ** 2, 2 * len(row))[: len(row)] / len(row))


def _find_last_lag(significant: npt.NDArray[np.bool_], within: int) -> int:
    """Return the smallest lag after which `within` lags are insignificant, without such lags the last significant."""
    for lag in range(len(significant) - within):
        if not significant[lag + 1 : lag + 1 + within].any():
            return lag
    return int(np.flatnonzero(significant)[-1])  # that of lag 0 is 1


@dataclass(frozen=True)
class Interval:
    """The two ends of a confidence interval."""

    low: float
    high: float


@dataclass(frozen=True)
class WiderInterval(Interval):
    """The wider one of an interval that takes queries as independent and one that draws neighbours together."""

    kind: Literal["independent", "blocks"]  # Wilson's, of differences Agresti and Min's; a block bootstrap
    block: int  # length in queries


def share_interval(hits: npt.ArrayLike, confidence: float = 0.95, window: int = 1) -> WiderInterval | None:
    """Return the interval of the mean of hits (n_queries,), 0 to 1, given in the order of the journey.

    The wider one of Wilson's and that of a circular block bootstrap, whose length `block_length` finds in the hits and
    which is expanded for few blocks; Wilson's where that length is 1. Where a hit rests on a `window` of so many
    neighbours, no block is shorter. None without queries, and where one block holds all of them. Raises ValueError for
    other values.
    """
    row = _require_finite_row(hits)
    independent = wilson(float(row.sum()), len(row), confidence)
    if independent is None or (window > 1 and len(row) <= window):
        return None
    return _choose_wider(row, independent, max(block_length(row), window), confidence)


def difference_interval(
    ours: npt.ArrayLike, theirs: npt.ArrayLike, confidence: float = 0.95, window: int = 1
) -> WiderInterval | None:
    """Return the interval of the mean of ours - theirs, hits 0 to 1 of two methods on the same queries in order.

    The wider one of Agresti and Min's (2005), which takes queries as independent, and that of the block bootstrap as
    in `share_interval`. Most differences are 0, which hides from the rule that the others come together: the block
    length is the largest of those of both hits, of the differences and of the `window`. None for fewer than 20 queries,
    too few to see whether neighbours are alike, and where one block holds all queries. Of values beyond 0 and 1 the
    lower end alone says anything: it is at least -1, the upper end at most 1. Raises ValueError for hits on different
    queries.
    """
    first, second = _require_finite_row(ours), _require_finite_row(theirs)
    if first.shape != second.shape:
        raise ValueError(f"a difference needs hits on the same queries, not {first.shape} and {second.shape}")
    row = first - second
    if len(row) < FEWEST or (window > 1 and len(row) <= window):
        return None
    block = max(window, *map(block_length, (first, second, row)))
    return _choose_wider(row, _estimate_agresti_min(row, confidence), block, confidence)


def wilson(successes: float, n: int, confidence: float = 0.95) -> Interval | None:
    """Return the Wilson score interval of a share, 0 to 1 (Wilson 1927); None without trials.

    Expected hits are not whole where scores tie, so `successes` may be any number from 0 to `n`. Takes the
    trials as independent: of consecutive frames it is too narrow, see `block_bootstrap`.
    """
    if n == 0:
        return None
    z = NormalDist().inv_cdf((1 + confidence) / 2)
    share = float(successes) / n
    scale = 1 + z**2 / n
    centre = (share + z**2 / (2 * n)) / scale
    half = z * (share * (1 - share) / n + z**2 / (4 * n**2)) ** 0.5 / scale
    return Interval(max(centre - half, 0.0), min(centre + half, 1.0))


def block_bootstrap(values: npt.ArrayLike, block: int, confidence: float = 0.95) -> Interval | None:
    """Return the bootstrap interval of the mean of `values` (n_queries,), given in the order of the journey.

    Consecutive frames see nearly the same, so blocks of `block` neighbours are drawn with replacement until
    there are as many values again; the last block is cut to fit. Blocks run on from the last value to the
    first, so that each value is drawn as often as any other (circular block bootstrap, Politis and Romano
    1992). The interval lies between the percentiles of the resampled means, whose distribution is computed and not
    drawn. None for fewer than two blocks. Raises ValueError for values that are not finite or not (n,).
    """
    row = _require_finite_row(values)
    if len(row) < 2 * block:
        return None
    tail = (1 - confidence) / 2
    means, reached = _resample_means(row, block)
    low, high = means[np.searchsorted(reached, [tail, 1 - tail])]
    return Interval(float(low), float(high))


def _resample_means(row: Values, block: int) -> tuple[Values, Values]:
    """Return the means that the bootstrap may give, ascending, and the chance of no more than each.

    A sum of independent blocks is distributed as the convolution of their sums, a product of Fourier transforms. Sums
    lie on a grid; a sum between two points is shared by them so that its mean stays.
    """
    n_blocks, rest = divmod(len(row), block)
    largest = len(row) * float(np.ptp(row))
    per_unit = _PARTS * max(1, int(_GRID_POINTS / (_PARTS * max(largest, 1))))
    n_points = 1 << math.ceil(largest * per_unit + 2).bit_length()
    above = (row - row.min()) * per_unit
    transform = np.fft.rfft(_share_chances(_sum_circularly(above, block), n_points)) ** n_blocks
    transform *= np.fft.rfft(_share_chances(_sum_circularly(above, rest), n_points))
    reached = np.cumsum(np.fft.irfft(transform, n_points))
    return row.min() + np.arange(n_points) / per_unit / len(row), np.maximum.accumulate(reached)


def _share_chances(sums: Values, n_points: int) -> Values:
    """Return how likely each of the points 0, 1, 2 ... is, (n_points,), if one of `sums` is drawn."""
    below = np.floor(sums + 1e-9)
    share = np.clip(sums - below, 0, 1)
    point = below.astype(np.int64)
    counts = np.bincount(point, 1 - share, n_points) + np.bincount(point + 1, share, n_points)
    return np.asarray(counts / len(sums))


def _sum_circularly(row: Values, length: int) -> Values:
    """Return for each start the sum of `length` values from there, (n,)."""
    running: Values = np.cumsum(np.concatenate([[0.0], row, row[:length]]))
    return running[length : length + len(row)] - running[: len(row)]


def _choose_wider(row: Values, independent: Interval, block: int, confidence: float) -> WiderInterval:
    blocks = block_bootstrap(row, block, _expand_confidence(confidence, len(row) / block)) if block > 1 else None
    if blocks is None or blocks.high - blocks.low <= independent.high - independent.low:
        return WiderInterval(independent.low, independent.high, "independent", block)
    return WiderInterval(blocks.low, blocks.high, "blocks", block)


def _expand_confidence(confidence: float, n_blocks: float) -> float:
    """Return the confidence at which the percentiles of few blocks are as wide as Student's t would make them.

    A bootstrap of n values takes their spread as known and (n - 1) / n too small (Hesterberg 2015, expanded percentile
    interval); n is the number of blocks here.
    """
    from scipy.special import stdtrit  # takes long to import

    score = math.sqrt(n_blocks / (n_blocks - 1)) * float(stdtrit(n_blocks - 1, (1 + confidence) / 2))
    return min(2 * NormalDist().cdf(score) - 1, 1 - 1e-9)


def _estimate_agresti_min(differences: Values, confidence: float) -> Interval:
    """Return Wald's interval of the mean paired difference (n,) after half a query was added to each of four outcomes.

    As it needs the sums alone, it takes differences that are not whole as well.
    """
    n = len(differences) + 2
    mean = float(differences.sum()) / n
    variance = (float((differences**2).sum()) + 1) / n - mean**2
    half = NormalDist().inv_cdf((1 + confidence) / 2) * math.sqrt(variance / n)
    return Interval(max(mean - half, -1.0), min(mean + half, 1.0))


@dataclass(frozen=True)
class McNemar:
    """On how many queries two methods disagree, and how likely so uneven a split is between equals."""

    b: int  # only the first is right
    c: int  # only the second is right
    p_value: float


def mcnemar_exact(hits_a: npt.ArrayLike, hits_b: npt.ArrayLike, window: int = 1) -> McNemar:
    """Return the exact McNemar test of two methods on the same queries: hits 0 or 1, each (n_queries,).

    p = min(1, 2 sum_{i <= min(b, c)} C(b + c, i) / 2^(b + c)); 1 if they never disagree. A chance to be
    right is no trial: where scores tie, give the pessimistic hits. Where a hit rests on a `window` of so many
    neighbours, in the order of the journey, only every `window`-th query is a trial: p is twice the mean over the
    ways to begin, which holds whatever these share (Vovk and Wang 2020), and b and c are of all queries.
    """
    from scipy.special import bdtr  # takes long to import

    first, second = np.asarray(hits_a, dtype=np.float64), np.asarray(hits_b, dtype=np.float64)

    def p_value(b: int, c: int) -> float:
        return min(1.0, 2 * float(bdtr(min(b, c), b + c, 0.5)))

    ours, theirs = first > second, second > first
    ways = [p_value(int(ours[way::window].sum()), int(theirs[way::window].sum())) for way in range(window)]
    return McNemar(int(ours.sum()), int(theirs.sum()), ways[0] if window == 1 else min(1.0, 2 * sum(ways) / window))
