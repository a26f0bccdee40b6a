"""The settings that are searched: Table I, drawn at random within ranges, and a grid around the best."""

from __future__ import annotations

from itertools import islice

import numpy as np
import pytest
import yaml

from vprbench.plugins import registry
from vprbench.tuning.space import PAPER, PARAMETERS, Parameter, Values, around, drawn

CENTRE: Values = {**PAPER, "rate_min": 0.4, "rate_max": 0.7, "p_excitatory": 0.2}
STEPPED = ("rate_min", "rate_max", "p_excitatory", "p_inhibitory")


def changed(values: Values, centre: Values = CENTRE) -> set[str]:
    return {name for name in centre if values[name] != centre[name]}


def test_the_papers_settings_are_vprtempos_defaults_and_lie_within_the_ranges() -> None:
    assert [*PAPER.values()] == [0.5, 0.005, 0.15, 0.2, 0.9, 0.1, 0.5, 0.1]  # Table I
    assert all(each.low <= each.paper <= each.high for each in PARAMETERS)
    defaults = yaml.safe_load(registry.entries("method")["vprtempo"].path.read_text(encoding="utf-8"))
    assert {name: defaults[name] for name in PAPER} == {**PAPER, "constant_input": None}  # null: 0.1, as the rules say


def test_random_settings_lie_within_the_ranges_and_f_min_is_never_above_f_max() -> None:
    for values in drawn(300, seed=1):
        assert set(values) == set(PAPER)
        assert all(each.low <= values[each.name] <= each.high for each in PARAMETERS)
        assert values["rate_min"] <= values["rate_max"]


@pytest.mark.parametrize("each", [p for p in PARAMETERS if "rate_m" not in p.name], ids=lambda p: p.name)
def test_random_settings_are_spread_over_the_range_evenly_or_by_its_logarithm(each: Parameter) -> None:
    scale = np.log if each.log else np.asarray
    low, high = scale(each.low), scale(each.high)
    shares = [(scale(values[each.name]) - low) / (high - low) for values in drawn(300, seed=2)]
    thirds = np.histogram(shares, bins=3, range=(0, 1))[0]
    assert thirds.min() > 70  # 100 expected, standard deviation 8


def test_a_longer_search_begins_with_the_settings_of_a_shorter_one() -> None:
    assert drawn(9, seed=3)[:4] == drawn(4, seed=3)
    assert drawn(1, seed=3) != drawn(1, seed=4)


def test_settings_can_be_typed_with_three_digits() -> None:
    for values in [*drawn(20, seed=5), *islice(around(CENTRE), 80)]:
        assert all(float(f"{value:.3g}") == value for value in values.values())


def test_the_grid_goes_through_all_neighbours_those_that_differ_least_first() -> None:
    # 4 parameters, a step up or down: 4 x 2 points differ in one, 6 x 4 in two, 4 x 8 in three, 16 in four
    neighbours = list(islice(around(CENTRE), 80))
    assert [len(changed(values)) for values in neighbours] == [1] * 8 + [2] * 24 + [3] * 32 + [4] * 16
    assert len({tuple(values.values()) for values in neighbours}) == 80


def test_the_grid_moves_rates_and_probabilities_by_their_steps_and_leaves_the_rest_alone() -> None:
    ends = {name: {CENTRE[name]} for name in PAPER}
    for values in islice(around(CENTRE), 80):
        for name, value in values.items():
            ends[name].add(value)
    assert {name: sorted(ends[name]) for name in STEPPED} == {
        "rate_min": [0.35, 0.4, 0.45],
        "rate_max": [0.65, 0.7, 0.75],
        "p_excitatory": [0.17, 0.2, 0.23],
        "p_inhibitory": [0.4, 0.5, 0.6],
    }
    assert all(ends[name] == {CENTRE[name]} for name in PAPER if name not in STEPPED)


def test_after_all_neighbours_the_grid_takes_two_steps() -> None:
    ring = [len(changed(values)) for values in islice(around(CENTRE), 80, 300)]
    assert ring == sorted(ring)  # those that differ least first
    beyond = next(islice(around(CENTRE), 80, None))
    assert len(changed(beyond)) == 1
    (name,) = changed(beyond)
    step = next(each.step for each in PARAMETERS if each.name == name)
    assert step is not None
    assert abs(beyond[name] - CENTRE[name]) == pytest.approx(2 * step)


def test_the_grid_never_leaves_the_ranges_nor_crosses_the_rates() -> None:
    corner: Values = {**PAPER, "rate_min": 0.99, "rate_max": 1.0, "p_excitatory": 0.02, "p_inhibitory": 0.06}
    points = list(islice(around(corner), 200))
    assert points
    for values in points:
        assert all(each.low <= values[each.name] <= each.high for each in PARAMETERS)
        assert values["rate_min"] <= values["rate_max"]
