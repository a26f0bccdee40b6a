"""How time grows with the number of places: constant, logarithmic and linear laws compared, and a power's exponent."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import inf, log
from typing import Literal

import numpy as np
import numpy.typing as npt

from vprbench.errors import BadInput

Law = Literal["constant", "logarithmic", "linear"]
LAWS: tuple[Law, ...] = ("constant", "logarithmic", "linear")

_FEWEST_SIZES = 5  # with fewer the correction of AICc for two coefficients is infinite
_CLOSEST = 1e-6  # error of ln seconds below which no time is known: keeps exact data from an infinite likelihood
_SEPARATED = 2.0  # a difference of AICc below which a law keeps substantial support (Burnham and Anderson 2002)


@dataclass(frozen=True)
class Fit:
    """Seconds under one law: a, a + b ln n or a + b n, with b at least 0."""

    law: Law
    a: float
    b: float
    aicc: float

    def at(self, n_places: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """Return the seconds at numbers of places (n,)."""
        return self.a + self.b * _shape(self.law, np.asarray(n_places, np.float64))


@dataclass(frozen=True)
class Exponent:
    """The power of n that seconds grow with, and its 95 % interval."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Comparison:
    """How well each law describes the times."""

    fits: Mapping[Law, Fit]
    best: Law  # with the lowest AICc
    differences: Mapping[Law, float]  # AICc less that of the best
    exponent: Exponent

    @property
    def supported(self) -> tuple[Law, ...]:
        """The laws that the times do not separate from the best: their AICc lies within 2 of it."""
        return tuple(law for law in LAWS if self.differences[law] < _SEPARATED)


def compare(n_places: npt.ArrayLike, seconds: npt.ArrayLike) -> Comparison:
    """Fit the laws to times (n_samples,) at numbers of places (n_samples,) and compare them.

    Of several times at one number of places, such as those of seeds, the median counts as one: what a size has of its
    own is in all of them. Each law is fitted by least squares on ln seconds, so that small maps count as much as large
    ones and half a time is as wrong as twice it. None falls, nor lies below 0 at the smallest map. AICc = m ln(S / m) +
    2 k + 2 k (k + 1) / (m - k - 1), S the sum of squared errors at m sizes and k the coefficients and the variance
    (Hurvich and Tsai 1989). The exponent is the slope of ln seconds over ln places with Student's interval. Raises
    BadInput for fewer than 5 different sizes and for times that are not above 0.
    """
    given, all_times = np.asarray(n_places, np.float64), np.asarray(seconds, np.float64)
    sizes = np.unique(given)
    times = np.array([np.median(all_times[given == size]) for size in sizes])
    if len(sizes) < _FEWEST_SIZES:
        raise BadInput(
            f"times at {len(sizes)} numbers of places cannot tell laws of growth apart: run at least {_FEWEST_SIZES}"
        )
    if not (np.isfinite(all_times).all() and all_times.min() > 0 and sizes.min() >= 1):
        raise BadInput(
            f"times from {all_times.min():g} s at maps from {sizes.min():g} places cannot be fitted: "
            "times have to be finite and above 0, and maps of one place or more"
        )
    fits = {law: _fit(law, sizes, times) for law in LAWS}
    best = min(LAWS, key=lambda law: fits[law].aicc)
    differences = {law: fits[law].aicc - fits[best].aicc for law in LAWS}
    return Comparison(fits, best, differences, exponent(sizes, times))


def _fit(law: Law, sizes: npt.NDArray[np.float64], times: npt.NDArray[np.float64]) -> Fit:
    """Fit a law by least squares on ln(seconds), from several starts."""
    from scipy.optimize import least_squares  # takes long to import

    shape, logs = _shape(law, sizes), np.log(times)
    if law == "constant":
        level = float(logs.mean())
        return Fit(law, float(np.exp(level)), 0.0, _aicc(float(np.mean((logs - level) ** 2)), len(sizes), 2))
    rise = (shape - shape.min()) / (shape.max() - shape.min())  # 0 to 1

    def errors(coefficients: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        return np.asarray(np.log(np.exp(coefficients[0]) + coefficients[1] * times.max() * rise) - logs)

    tight = {"xtol": 1e-15, "ftol": 1e-15, "gtol": 1e-15}
    starts = [(low, high) for low in (logs.min(), logs.mean()) for high in (1e-6, 0.1, 1.0)]
    found = [least_squares(errors, start, bounds=([-np.inf, 0], np.inf), **tight) for start in starts]
    best = min(found, key=lambda one: float(one.cost))
    smallest, b = float(np.exp(best.x[0])), float(best.x[1] * times.max() / (shape.max() - shape.min()))
    mean_square = float(np.mean(errors(best.x) ** 2))
    return Fit(law, smallest - b * float(shape.min()), b, _aicc(mean_square, len(sizes), 3))


def _shape(law: Law, sizes: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    if law == "logarithmic":
        return np.log(sizes)
    return sizes if law == "linear" else np.zeros_like(sizes)


def _aicc(mean_square: float, n_samples: int, n_parameters: int) -> float:
    correction = 2 * n_parameters * (n_parameters + 1) / (n_samples - n_parameters - 1)
    return n_samples * log(max(mean_square, _CLOSEST**2)) + 2 * n_parameters + correction


def exponent(n_places: npt.ArrayLike, seconds: npt.ArrayLike) -> Exponent:
    """Return the slope of ln seconds (n_sizes,) over ln places (n_sizes,), with Student's 95 % interval.

    Two sizes leave no residuals: their interval is infinite.
    """
    from scipy.stats import t  # takes long to import

    sizes, times = np.log(np.asarray(n_places, np.float64)), np.log(np.asarray(seconds, np.float64))
    x, y = sizes - sizes.mean(), times - times.mean()
    slope = float(x @ y / (x @ x))
    left = len(x) - 2
    if left == 0:
        return Exponent(slope, -inf, inf)
    half = float(t.ppf(0.975, left)) * float(np.sqrt(np.sum((y - slope * x) ** 2) / left / (x @ x)))
    return Exponent(slope, slope - half, slope + half)
