"""The block length against a literal transcription of the published rule, its limit for large n, and its edges."""

from __future__ import annotations

from math import ceil, floor, log10, sqrt

import numpy as np
import numpy.typing as npt
import pytest
from scipy.signal import lfilter

from vprbench.metrics.block_length import block_length


def autoregressive(n: int, phi: float, seed: int) -> npt.NDArray[np.float64]:
    noise = np.random.default_rng(seed).standard_normal(n + 1000)
    return np.asarray(lfilter([1], [1, -phi], noise)[1000:])


def transcribed(x: list[float]) -> int:
    """Politis and White (2004), section 3, with D of Patton, Politis and White (2009), in plain loops."""
    n = len(x)
    mean = sum(x) / n
    k_n = max(5, ceil(sqrt(log10(n))))
    m_max = ceil(sqrt(n)) + k_n

    def r(k: int) -> float:
        return sum((x[i] - mean) * (x[i + abs(k)] - mean) for i in range(n - abs(k))) / n

    def rho_is_large(k: int) -> bool:
        return abs(r(k) / r(0)) >= 2 * sqrt(log10(n) / n)

    m_hat = next(
        (m for m in range(m_max - k_n + 1) if not any(rho_is_large(m + k) for k in range(1, k_n + 1))),
        max((k for k in range(1, m_max + 1) if rho_is_large(k)), default=1),
    )
    m = min(2 * max(m_hat, 1), m_max)

    def window(t: float) -> float:
        return 1.0 if abs(t) <= 0.5 else 2 * (1 - abs(t)) if abs(t) <= 1 else 0.0

    g_hat = sum(window(k / m) * abs(k) * r(k) for k in range(-m, m + 1))
    spectrum_at_0 = sum(window(k / m) * r(k) for k in range(-m, m + 1))
    d_circular = 4 / 3 * spectrum_at_0**2
    b = (2 * g_hat**2 / d_circular) ** (1 / 3) * n ** (1 / 3)
    return max(1, min(ceil(b), floor(min(3 * sqrt(n), n / 3))))


@pytest.mark.parametrize("n", [20, 47, 150, 400])
@pytest.mark.parametrize("phi", [-0.6, 0.0, 0.5, 0.9, 0.99])
def test_the_length_is_that_of_a_slow_transcription_of_the_published_rule(n: int, phi: float) -> None:
    series = autoregressive(n, phi, seed=n)
    for row in (series, (series > np.median(series)).astype(np.float64)):
        assert block_length(row) == transcribed(row.tolist())


def test_the_length_of_an_autoregressive_series_comes_near_its_best_one() -> None:
    # R(k) = R(0) phi^|k|: G / g(0) = 2 phi / (1 - phi^2), so b = (6 phi^2 n / (1 - phi^2)^2)^(1/3)
    n, phi = 20_000, 0.7
    best = (6 * phi**2 * n / (1 - phi**2) ** 2) ** (1 / 3)
    found = [block_length(autoregressive(n, phi, seed)) for seed in range(20)]
    assert np.median(found) == pytest.approx(best, rel=0.1)


def test_too_few_and_equal_values_have_blocks_of_one_and_all_others_at_least_three_blocks() -> None:
    assert [block_length(row) for row in ([], [1.0], [0, 1] * 9, [0] * 9 + [1] * 10, [1.0] * 500)] == [1] * 5
    for n in (20, 100, 901, 5000):
        halves = np.arange(n) < n / 2
        swinging = np.arange(n) % 2  # g(0) is next to nothing
        for row in (halves, swinging, ~halves):
            assert 1 <= block_length(row) <= min(3 * n**0.5, n / 3)


def test_values_that_are_no_row_of_numbers_are_refused() -> None:
    for wrong in ([0, np.nan], np.ones((4, 4))):
        with pytest.raises(ValueError, match="finite"):
            block_length(wrong)
