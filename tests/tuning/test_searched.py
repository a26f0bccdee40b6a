"""Where and among which settings may be searched: nowhere that a result queries, around Table I within ranges."""

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest
from little import pictures

from vprbench.api.dataset import Dataset
from vprbench.errors import BadInput
from vprbench.plugins import registry
from vprbench.report.plan import Column
from vprbench.tuning.places import Searchable, choose_places, cut_dataset
from vprbench.tuning.space import PAPER, PARAMETERS, draw_settings, list_grid


def config(name):
    return dict(registry.find_entries("dataset")[name].values())


def column(*options):
    return Column("a column", "A column", options)


def test_a_rendered_journey_is_another_one_than_every_reported_one_and_all_of_its_places_are_queried():
    name = "synthetic"
    reported = [column(f"dataset={name}"), column(f"dataset={name}", "dataset.seed=7")]
    assert choose_places(name, {**config(name), "seed": 3}, 20, reported).dataset["seed"] not in (3, 7)
    allowed = choose_places(name, config(name), 10, [])
    assert (allowed.searched, allowed.checked) == (range(10), range(10, 20))
    other, usual = registry.make_dataset(allowed.dataset), registry.make_dataset({**config(name), "places": 20})
    assert [right.tolist() for right in other.positives] == [[place] for place in range(20)]
    for frame in (0, 1, 20, 21):  # of both traverses
        assert not np.array_equal(other.references[frame], usual.references[frame])


ON_REQUEST = replace(column("dataset=nordland", "dataset.protocol=vprsnn"), on_request=True)
OTHER = column("dataset=nordland_64x32", "dataset.first_query_place=0", "dataset.query_places=500")
SMALLER = ("dataset.places=450", "dataset.first_query_place=90", "dataset.query_places=360")


def test_places_that_the_paper_or_a_column_of_the_table_queries_are_left_out():
    for name, columns, places, searched, checked in (
        ("nordland", [column("dataset=nordland")], 500, range(500), range(500, 600)),
        ("nordland", [ON_REQUEST, OTHER], 500, range(500), range(500, 600)),
        ("nordland", [column("dataset=nordland", *SMALLER)], 150, range(450, 600), range(90)),
        ("oxford_robotcar", [], 60, range(60), range(60, 90)),
    ):
        whole = {"first_query_place": 0, "query_places": {"nordland": 3300, "oxford_robotcar": 450}[name]}
        assert choose_places(name, config(name), places, columns) == Searchable(
            {**config(name), **whole}, searched, checked
        )


def test_what_has_no_free_places_is_refused_with_the_reason():
    for name, places, complaint in (
        ("nordland_64x32", 100, "dataset=nordland_64x32 0 places in a row .* search on dataset=synthetic"),
        ("folders", 100, "dataset=folders: nothing says which of its places"),
        ("oxford_robotcar", 100, "places=100: of dataset=oxford_robotcar 90 places in a row"),
        ("oxford_robotcar", 85, "10 or more have to be left to check"),
    ):
        with pytest.raises(BadInput, match=complaint):
            choose_places(name, config(name), places, [])


def two_traverses(tolerance=0):
    """Six places in two traverses; query i shows place i, the last none."""
    rights = [np.arange(max(0, place - tolerance), min(6, place + tolerance + 1)) for place in range(6)]
    return Dataset(
        name="twice",
        references=pictures([*range(6), *range(10, 16)]),
        places=np.tile(np.arange(6), 2),
        queries=pictures(range(20, 27)),
        positives=(*rights, np.empty(0, np.int64)),
        protocol={"query": "dusk"},
        place_numbers=np.arange(10, 16),
        query_breaks=np.array([5]),
        place_breaks=np.array([5]),
    )


def test_a_stretch_has_its_own_references_queries_and_numbers_and_no_query_that_is_right_in_another():
    part = cut_dataset(two_traverses(), range(2, 5))
    assert [*part.references.names] == [f"image {number}" for number in (2, 3, 4, 8, 9, 10)]
    assert [*part.queries.names] == ["image 2", "image 3", "image 4"]
    assert part.places.tolist() == [0, 1, 2, 0, 1, 2]
    assert [right.tolist() for right in part.positives] == [[0], [1], [2]]
    assert part.protocol == {"query": "dusk", "stretch": [2, 4]}
    parts = [cut_dataset(two_traverses(tolerance=1), stretch) for stretch in (range(3), range(3, 6))]
    assert [[*part.queries.names] for part in parts] == [["image 0", "image 1"], ["image 4", "image 5"]]


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
