"""The settings that are searched: Table I, drawn at random within ranges, and a grid around the best."""

from itertools import islice

import numpy as np
import pytest

from vprbench.plugins import registry
from vprbench.tuning.space import PAPER, PARAMETERS, draw_settings, list_grid

CENTRE = {**PAPER, "rate_min": 0.4, "rate_max": 0.7, "p_excitatory": 0.2}
CORNER = {**PAPER, "rate_min": 0.99, "rate_max": 1.0, "p_excitatory": 0.02, "p_inhibitory": 0.06}


def changed(values):
    return {name for name in CENTRE if values[name] != CENTRE[name]}


def test_the_papers_settings_are_vprtempos_defaults_and_lie_within_the_ranges():
    assert [*PAPER.values()] == [0.5, 0.005, 0.15, 0.2, 0.9, 0.1, 0.5, 0.1]  # Table I
    assert all(each.low <= each.paper <= each.high for each in PARAMETERS)
    defaults = registry.find_entries("method")["vprtempo"].values()
    assert {name: defaults[name] for name in PAPER} == {**PAPER, "constant_input": None}  # null: 0.1, as the rules say


def test_settings_lie_within_the_ranges_f_min_is_never_above_f_max_and_three_digits_are_enough():
    points = [*islice(draw_settings(seed=1), 300), *islice(list_grid(CENTRE), 80), *islice(list_grid(CORNER), 200)]
    assert len(points) > 400
    for values in points:
        assert set(values) == set(PAPER)
        assert all(each.low <= values[each.name] <= each.high for each in PARAMETERS)
        assert values["rate_min"] <= values["rate_max"]
        assert all(float(f"{value:.3g}") == value for value in values.values())


def test_random_settings_are_spread_evenly_or_by_the_logarithm_and_the_same_for_a_seed():
    points = [*islice(draw_settings(seed=2), 300)]
    for each in (each for each in PARAMETERS if "rate_m" not in each.name):
        scale = np.log if each.log else np.asarray
        values = scale([point[each.name] for point in points])
        thirds = np.histogram(values, bins=3, range=(scale(each.low), scale(each.high)))[0]
        assert thirds.min() > 70, each.name  # 100 expected, standard deviation 8
    assert [*islice(draw_settings(seed=2), 300)] == points
    assert next(draw_settings(seed=3)) != next(draw_settings(seed=4))


def test_the_grid_goes_through_all_neighbours_those_that_differ_least_first_and_then_takes_two_steps():
    # 4 parameters, a step up or down: 4 x 2 points differ in one, 6 x 4 in two, 4 x 8 in three, 16 in four
    *neighbours, beyond = islice(list_grid(CENTRE), 81)
    assert [len(changed(values)) for values in neighbours] == [1] * 8 + [2] * 24 + [3] * 32 + [4] * 16
    assert len({tuple(values.values()) for values in neighbours}) == 80
    assert {name: sorted({CENTRE[name], *(values[name] for values in neighbours)}) for name in PAPER} == {
        **{name: [CENTRE[name]] for name in PAPER},
        "rate_min": [0.35, 0.4, 0.45],
        "rate_max": [0.65, 0.7, 0.75],
        "p_excitatory": [0.17, 0.2, 0.23],
        "p_inhibitory": [0.4, 0.5, 0.6],
    }
    ring = [len(changed(values)) for values in islice(list_grid(CENTRE), 81, 300)]
    assert ring == sorted(ring)
    (name,) = changed(beyond)
    step = next(each.step for each in PARAMETERS if each.name == name)
    assert abs(beyond[name] - CENTRE[name]) == pytest.approx(2 * step)
