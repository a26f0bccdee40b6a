"""How many consecutive queries see nearly the same: the block length of a bootstrap, chosen from the data."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

_SIGNIFICANT = 2.0  # times sqrt(log10 n / n): the constant c that Politis and White recommend
FEWEST = 20  # values: with fewer, autocorrelation is not told from chance


def block_length(values: npt.ArrayLike) -> int:
    """Return the block length of the circular bootstrap of the mean of `values` (n,), given along the journey.

    The automatic rule of Politis and White (2004) with the correction of Patton, Politis and White (2009):
    b = (2 G^2 / D)^(1/3) n^(1/3), D = 4/3 g(0)^2, where g(0) = sum of w(k / M) R(k) and G = sum of w(k / M) |k| R(k)
    over lags k = -M ... M of the autocovariance R, with the flat-top window w. M is twice the lag after which
    K = max(5, sqrt(log10 n)) autocorrelations in a row are insignificant, twice the last significant one if there is
    no such row; lags beyond sqrt(n) + K are not looked at. Rounded up, at least 1 and at most min(3 sqrt(n), n / 3). 1
    for equal values and for fewer than 20. Raises ValueError for values that are not finite or not (n,).
    """
    row = finite_row(values)
    n = len(row)
    if n < FEWEST or np.ptp(row) == 0:
        return 1
    covariances = _autocovariances(row)
    within = max(5, math.ceil(math.sqrt(math.log10(n))))
    furthest = math.ceil(math.sqrt(n)) + within
    significant = np.abs(covariances / covariances[0]) >= _SIGNIFICANT * math.sqrt(math.log10(n) / n)
    width = min(2 * max(1, _last_lag(significant[: furthest + 1], within)), furthest)
    lags = np.arange(1, width + 1)
    weighted = np.clip(2 * (1 - lags / width), 0, 1) * covariances[1 : width + 1]
    at_zero = float(covariances[0] + 2 * weighted.sum())
    slope = float(2 * (lags * weighted).sum())
    most = math.floor(min(3 * math.sqrt(n), n / 3))
    if at_zero**2 * most**3 <= 1.5 * slope**2 * n:  # the same as length >= most, without dividing by what may be 0
        return most
    return max(1, math.ceil(math.cbrt(1.5 * (slope / at_zero) ** 2 * n)))


def finite_row(values: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """Return `values` as float64 (n,); raises ValueError if one is not finite or the shape is another."""
    row = np.asarray(values, dtype=np.float64)
    if row.ndim != 1 or not np.isfinite(row).all():
        raise ValueError(f"values must be finite and (n_queries,), but {row.shape} came or one is not finite")
    return row


def _autocovariances(row: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return the autocovariances at all lags from 0, (n,), each a sum of products over n."""
    spectrum = np.fft.rfft(row - row.mean(), 2 * len(row))
    products: npt.NDArray[np.float64] = np.fft.irfft(np.abs(spectrum) ** 2, 2 * len(row))
    return products[: len(row)] / len(row)


def _last_lag(significant: npt.NDArray[np.bool_], within: int) -> int:
    """Return the smallest lag after which `within` lags are insignificant, without such lags the last significant."""
    for lag in range(len(significant) - within):
        if not significant[lag + 1 : lag + 1 + within].any():
            return lag
    return int(np.flatnonzero(significant)[-1])  # that of lag 0 is 1
