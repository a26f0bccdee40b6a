"""The exponent of growth, and the runs that make the growth of a row."""

from dataclasses import replace

import figure_runs
import numpy as np
import pytest

from vprbench.metrics.growth import fit_power
from vprbench.report.figures.growth import compute_median_interval, tabulate_growth

SIZES = np.array([100.0, 300, 1000, 3000, 9000, 27000])
OLD = {"time_utc": "2024-01-01T00:00:00Z"}


def test_the_exponent_is_a_slope_with_student_s_interval():
    # ln places 0 to 4; ln seconds 0, 1, 2, 3, 4 with errors 1, 0, -2, 0, 1, orthogonal to a line and a constant: slope
    # 1, its standard error sqrt(6 / 3 / 10), Student's 97.5 % quantile of 3 degrees of freedom 3.18245
    places = np.exp(np.arange(5.0))
    found = fit_power(places, np.exp(np.array([1.0, 1, 0, 3, 5])))
    half = 3.18245 * 0.2**0.5
    assert (found.low, found.exponent, found.high) == pytest.approx((1 - half, 1, 1 + half), rel=1e-5)
    for power in (-1.0, 0.0, 0.5, 2.0):
        exact = fit_power(SIZES, 0.003 * SIZES**power)
        assert (exact.low, exact.exponent, exact.high) == pytest.approx((power, power, power), abs=1e-6)
        assert exact.at([1, 50]) == pytest.approx(0.003 * np.array([1, 50.0**power]))


def test_the_interval_of_a_median_lies_at_the_tabulated_ranks():
    # ranks of the 95 % interval: Conover, Practical Nonparametric Statistics, table of the binomial distribution
    assert compute_median_interval(np.arange(5.0)) is None
    for n_laps, k in ((6, 1), (10, 2), (25, 8), (100, 40)):
        laps = np.random.default_rng(0).permutation(np.arange(1.0, n_laps + 1))
        assert compute_median_interval(laps) == (k, n_laps + 1 - k)


def test_samples_stand_in_the_order_of_places_and_seeds_and_the_newest_run_of_each_counts():
    asked = [(n, seed) for n in (300, 100) for seed in (1, 0)]
    runs = [figure_runs.sized(n, 5.0, 0.001 * n, seed=seed, fit_compute_seconds=n / 100) for n, seed in asked]
    runs.append(figure_runs.sized(100, 9.0, 0.009, seed=0, time_utc="2020-01-01T00:00:00Z"))
    found = tabulate_growth(runs)
    assert [*zip(found.places, found.seed, strict=True)] == [(100, 0), (100, 1), (300, 0), (300, 1)]
    assert found.fit_compute_seconds.tolist() == [1, 1, 3, 3]
    assert found.query_seconds.iloc[-1] == pytest.approx(0.301)  # 1 ms to encode


def test_runs_with_other_arguments_weights_or_protocol_are_another_growth():
    given, protocol = {"max_module": 1100, "rules": "own"}, {"places": 300, "tolerance_places": 0}
    new = figure_runs.sized(1000, 1.0, 0.001, arguments=given, protocol={**protocol, "places": 1000})
    heavier = figure_runs.sized(300, 9.0, 0.001, arguments=given, protocol=protocol, **OLD)
    others = {
        "arguments of the method": {"arguments": {**given, "rules": "reference"}, "protocol": protocol},
        "dataset": {"arguments": given, "protocol": {**protocol, "tolerance_places": 2}},
    }
    runs = {part: figure_runs.sized(300, 9.0, 0.001, **changed, **OLD) for part, changed in others.items()}
    runs["weights"] = replace(heavier, config={**heavier.config, "files": [{"name": "weights", "sha256": "ab"}]})
    fewer = {"arguments": given, "protocol": {**protocol, "query_places": 9}}
    smaller = figure_runs.sized(300, 9.0, 0.001, **fewer, **OLD)
    assert [*tabulate_growth([new, smaller])["record"]] == [smaller, new]
    for other in runs.values():
        assert [*tabulate_growth([new, other])["record"]] == [new]
