"""Intervals, also of exponents, block lengths and the paired test against scipy, enumeration and worked values."""

from itertools import product
from math import ceil, floor, log10, sqrt
from statistics import NormalDist

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import binomtest

from vprbench.metrics import intervals
from vprbench.metrics.growth import fit_power
from vprbench.metrics.intervals import block_bootstrap, block_length, difference_interval, mcnemar_exact, share_interval


def test_wilson_of_whole_counts_is_that_of_scipy_and_of_expected_hits_solves_its_defining_equation():
    for successes, n, confidence in ((0, 1, 0.95), (7, 20, 0.95), (20, 20, 0.5), (1350, 2700, 0.95)):
        expected = binomtest(successes, n).proportion_ci(confidence, method="wilson")
        found = intervals.wilson(successes, n, confidence)
        assert (found.low, found.high) == pytest.approx((expected.low, expected.high), abs=1e-12)
    found = intervals.wilson(37.25, 100)
    z = NormalDist().inv_cdf(0.975)
    for end in (found.low, found.high):
        assert abs(0.3725 - end) == pytest.approx(z * (end * (1 - end) / 100) ** 0.5, abs=1e-12)


@pytest.mark.parametrize(("n", "block", "unit"), [(4, 2, 1), (5, 2, 1 / 4), (7, 3, -1 / 3), (5, 1, 1), (7, 3, 1)])
def test_the_bootstrap_has_the_quantiles_of_all_choices_of_circular_blocks(n, block, unit):
    values = unit * np.random.default_rng(n).integers(0, 4, n)
    starts = np.array([*product(range(n), repeat=-(-n // block))])  # (n_draws, n_blocks)
    draws = ((starts[:, :, None] + np.arange(block)) % n).reshape(len(starts), -1)[:, :n]
    means = values[draws].mean(axis=1)
    found = block_bootstrap(values, block, confidence=0.8)
    for end, share in ((found.low, 0.1), (found.high, 0.9)):
        assert np.abs(means - end).min() < 1e-9
        assert np.mean(means < end - 1e-9) < share <= np.mean(means < end + 1e-9) + 1e-9


def in_runs(n, share, kept, random):
    """Hits of mean `share`, each of which is that before it with chance `kept` and else drawn anew."""
    drawn = (random.random(n) < share).astype(np.float64)
    anew = random.random(n) >= kept
    anew[0] = True
    return drawn[np.maximum.accumulate(np.where(anew, np.arange(n), 0))]


def covered(found, truth):
    return float(np.mean([each.low - 1e-12 <= truth <= each.high + 1e-12 for each in found]))


def test_intervals_of_hits_in_runs_hold_the_truth_far_more_often_than_wilsons_and_than_blocks_of_ten():
    random = np.random.default_rng(0)
    rows = [in_runs(800, 0.3, 0.95, random) for _ in range(100)]
    assert covered([share_interval(row) for row in rows], 0.3) > 0.85
    assert covered([block_bootstrap(row, 10) for row in rows], 0.3) < 0.75
    assert covered([intervals.wilson(row.sum(), 800) for row in rows], 0.3) < 0.4
    pairs = []
    for _ in range(100):  # two methods of equal recall that find some stretches easy together, and each some of its own
        together = in_runs(800, 0.5, 0.98, random)
        pairs.append([np.where(together > 0, in_runs(800, 0.4, 0.95, random), 0) for _ in range(2)])
    assert covered([difference_interval(*pair) for pair in pairs], 0) > 0.88
    assert covered([block_bootstrap(one - other, 10) for one, other in pairs], 0) < 0.75


def test_which_interval_is_wider_and_its_block_length_are_told():
    perfect = share_interval(np.ones(200))
    assert perfect == intervals.WiderInterval(*vars(intervals.wilson(200, 200)).values(), kind="independent", block=1)
    runs = np.repeat([1, 0, 1, 1, 0, 0, 1, 0, 1, 1], 20)
    found, plain = share_interval(runs), block_bootstrap(runs, block_length(runs))
    assert (found.kind, found.block) == ("blocks", block_length(runs))
    assert found.low < plain.low < plain.high < found.high  # for there are few blocks


def test_a_difference_without_runs_has_the_interval_of_agresti_and_min():
    # 12 of 400 won and 4 lost, spread evenly: mean 8 / 402 and variance (17 / 402 - mean^2) / 402
    won, lost = np.zeros(400), np.zeros(400)
    won[10::33], lost[17::99] = 1, 1
    assert (won.sum(), lost.sum()) == (12, 4)
    half = 1.959964 * ((17 / 402 - (8 / 402) ** 2) / 402) ** 0.5
    found = difference_interval(won, lost)
    assert found.kind == "independent"
    assert (found.low, found.high) == pytest.approx((8 / 402 - half, 8 / 402 + half), abs=1e-6)


def hits(both, first, second, none):
    return [1] * (both + first) + [0] * (second + none), [1] * both + [0] * first + [1] * second + [0] * none


def test_mcnemar_is_the_exact_binomial_test_of_the_queries_on_which_two_disagree():
    for b, c in ((0, 1), (5, 5), (0, 9), (700, 640)):
        found, swapped = mcnemar_exact(*hits(4, b, c, 6)), mcnemar_exact(*reversed(hits(4, b, c, 6)))
        assert (found.b, found.c) == (swapped.c, swapped.b) == (b, c)
        assert found.p_value == swapped.p_value == pytest.approx(binomtest(b, b + c).pvalue, rel=1e-9)


def test_what_is_undefined_and_what_has_no_width():
    assert intervals.wilson(0, 0) is share_interval([]) is None
    assert difference_interval(np.ones(19), np.zeros(19)) is None  # too few
    assert difference_interval(np.ones(20), np.zeros(20)) is not None
    assert [block_bootstrap(np.ones(n), 10) for n in (0, 1, 19)] == [None] * 3  # less than two blocks
    assert block_bootstrap(np.ones(20), 10) == block_bootstrap(np.ones(45), 10) == intervals.Interval(1, 1)
    assert mcnemar_exact(*hits(3, 0, 0, 2)) == mcnemar_exact([], []) == intervals.McNemar(0, 0, 1.0)


def test_where_windows_overlap_only_every_window_th_query_is_a_trial():
    random = np.random.default_rng(3)
    ours, theirs = random.integers(0, 2, 90), random.integers(0, 2, 90)
    p_values = [mcnemar_exact(ours[way::4], theirs[way::4]).p_value for way in range(4)]
    whole, apart = mcnemar_exact(ours, theirs), mcnemar_exact(ours, theirs, window=4)
    assert (apart.b, apart.c) == (whole.b, whole.c)
    assert apart.p_value == pytest.approx(min(1.0, 2 * sum(p_values) / 4))
    copied = mcnemar_exact(np.repeat([1] * 8, 10), np.repeat([0] * 8, 10), window=10)  # eight trials, seen ten times
    assert copied.p_value == pytest.approx(2 * 2 * 0.5**8)


def test_no_block_is_shorter_than_the_window_that_an_answer_rests_on():
    hits = np.random.default_rng(0).integers(0, 2, 400)
    assert share_interval(hits).block < 25 == share_interval(hits, window=25).block
    assert difference_interval(hits, hits[::-1], window=30).block == 30
    assert share_interval(hits[:25], window=25) is None  # one block says nothing of how far blocks differ
    assert difference_interval(hits[:30], hits[30:60], window=30) is None


def transcribed(x):
    """Politis and White (2004), section 3, with D of Patton, Politis and White (2009), in plain loops."""
    n = len(x)
    mean = sum(x) / n
    k_n = max(5, ceil(sqrt(log10(n))))
    m_max = ceil(sqrt(n)) + k_n

    def r(k):
        return sum((x[i] - mean) * (x[i + abs(k)] - mean) for i in range(n - abs(k))) / n

    def rho_is_large(k):
        return abs(r(k) / r(0)) >= 2 * sqrt(log10(n) / n)

    small = (m for m in range(m_max - k_n + 1) if not any(rho_is_large(m + k) for k in range(1, k_n + 1)))
    m_hat = next(small, max((k for k in range(1, m_max + 1) if rho_is_large(k)), default=1))
    m = min(2 * max(m_hat, 1), m_max)

    def window(t):
        return min(1.0, max(0.0, 2 * (1 - abs(t))))

    g_hat = sum(window(k / m) * abs(k) * r(k) for k in range(-m, m + 1))
    spectrum_at_0 = sum(window(k / m) * r(k) for k in range(-m, m + 1))
    d_circular = 4 / 3 * spectrum_at_0**2
    b = (2 * g_hat**2 / d_circular) ** (1 / 3) * n ** (1 / 3)
    return max(1, min(ceil(b), floor(min(3 * sqrt(n), n / 3))))


@pytest.mark.parametrize("n", [20, 150, 400])
@pytest.mark.parametrize("phi", [-0.6, 0.0, 0.5, 0.99])
def test_the_length_is_that_of_a_slow_transcription_of_the_published_rule(n, phi):
    series = np.asarray(lfilter([1], [1, -phi], np.random.default_rng(n).standard_normal(n + 1000))[1000:])
    for row in (series, (series > np.median(series)).astype(np.float64)):
        assert block_length(row) == transcribed(row.tolist())


def test_the_exponent_is_a_slope_with_student_s_interval():
    # ln places 0 to 4; ln seconds 0, 1, 2, 3, 4 with errors 1, 0, -2, 0, 1, orthogonal to a line and a constant: slope
    # 1, its standard error sqrt(6 / 3 / 10), Student's 97.5 % quantile of 3 degrees of freedom 3.18245
    places = np.exp(np.arange(5.0))
    found = fit_power(places, np.exp(np.array([1.0, 1, 0, 3, 5])))
    half = 3.18245 * 0.2**0.5
    assert (found.low, found.exponent, found.high) == pytest.approx((1 - half, 1, 1 + half), rel=1e-5)
    sizes = np.array([100.0, 300, 1000, 3000, 9000, 27000])
    for power in (-1.0, 0.0, 0.5, 2.0):
        exact = fit_power(sizes, 0.003 * sizes**power)
        assert (exact.low, exact.exponent, exact.high) == pytest.approx((power, power, power), abs=1e-6)
        assert exact.at([1, 50]) == pytest.approx(0.003 * np.array([1, 50.0**power]))
