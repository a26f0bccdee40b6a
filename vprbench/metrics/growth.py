"""How time grows with the number of places: the exponent of a power."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from vprbench.errors import BadInput

_FEWEST_SIZES = 3  # two leave no residuals, and no interval


@dataclass(frozen=True)
class Power:
    """Seconds as `factor` times the number of places to the power `exponent`, with the exponent's 95 % interval."""

    factor: float  # seconds
    exponent: float
    low: float
    high: float

    def at(self, n_places: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """Return the seconds at numbers of places (n,)."""
        return np.asarray(self.factor * np.asarray(n_places, np.float64) ** self.exponent)


def fit_power(n_places: npt.ArrayLike, seconds: npt.ArrayLike) -> Power:
    """Fit a power to times (n_samples,) at numbers of places (n_samples,).

    The exponent is the slope of ln seconds over ln places by least squares, with Student's interval. Of several times
    at one number of places, such as those of seeds, the median counts as one. Raises BadInput for fewer than 3
    different sizes and for times that are not above 0.
    """
    from scipy.stats import t  # takes long to import

    given, all_times = np.asarray(n_places, np.float64), np.asarray(seconds, np.float64)
    sizes = np.unique(given)
    if len(sizes) < _FEWEST_SIZES:
        raise BadInput(f"times at {len(sizes)} numbers of places give no exponent: run at least {_FEWEST_SIZES}")
    if not all_times.min() > 0:
        raise BadInput(f"times from {all_times.min():g} s give no exponent: they have to be longer than 0 s")
    logs = np.log([np.median(all_times[given == size]) for size in sizes])
    x, y = np.log(sizes) - np.log(sizes).mean(), logs - logs.mean()
    slope, left = float(x @ y / (x @ x)), len(x) - 2
    half = float(t.ppf(0.975, left)) * float(np.sqrt(np.sum((y - slope * x) ** 2) / left / (x @ x)))
    factor = float(np.exp(logs.mean() - slope * np.log(sizes).mean()))
    return Power(factor, slope, slope - half, slope + half)
