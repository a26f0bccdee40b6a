"""What is asked of traverses: the right places of a query, and refusals in the words of each kind of dataset."""

from dataclasses import replace

import pytest

from vprbench.datasets.traverses import Rendered, check_recorded, check_recorded_range, places_of, right_places
from vprbench.interface import BadInput

JOURNEY = Rendered("the little journey", "hour", ("dawn", "noon"), 3, 20, skipped=(1, 4))
ASKED = {
    "places": 8,
    "references": ["dawn"],
    "query": "noon",
    "first_query_place": None,
    "query_places": None,
    "tolerance": 0,
    "seed": 0,
}


def refusal(check, *arguments, **named):
    with pytest.raises(BadInput) as error:
        check(*arguments, **named)
    return str(error.value)


def test_right_are_the_places_within_the_tolerance_as_far_as_there_are_any():
    right = right_places(first=0, count=4, places=5, tolerance=2)
    assert [places.tolist() for places in right] == [[0, 1, 2], [0, 1, 2, 3], [0, 1, 2, 3, 4], [1, 2, 3, 4]]


def test_without_a_tolerance_each_query_has_its_own_place_alone():
    assert [places.tolist() for places in right_places(first=3, count=2, places=9, tolerance=0)] == [[3], [4]]


def test_every_traverse_shows_all_places_in_order():
    assert places_of(3, 2).tolist() == [0, 1, 2, 0, 1, 2]


@pytest.mark.parametrize(
    ("skipped", "places", "expected"), [((1, 4), 8, (2, 6)), ((2, 11), 11, (2, 9)), ((1, 5), 14, (3, 11))]
)
def test_a_share_of_the_places_is_not_queried_unless_told_otherwise(skipped, places, expected):
    assert replace(JOURNEY, skipped=skipped).check(**(ASKED | {"places": places})) == expected


@pytest.mark.parametrize(
    ("first", "count", "expected"), [(0, None, (0, 8)), (7, None, (7, 1)), (2, 6, (2, 6)), (None, 3, (2, 3))]
)
def test_first_query_place_and_number_of_queries_are_kept_when_given(first, count, expected):
    assert JOURNEY.check(**(ASKED | {"first_query_place": first, "query_places": count})) == expected


@pytest.mark.parametrize("places", [3, 20])
def test_a_rendered_journey_may_be_as_short_and_as_long_as_it_says(places):
    assert sum(JOURNEY.check(**(ASKED | {"places": places}))) == places


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"places": 2}, "dataset.places=2 came; the little journey has 3 to 20 places"),
        ({"places": 21}, "dataset.places=21 came; the little journey has 3 to 20 places"),
        ({"first_query_place": 8}, "dataset.first_query_place=8 came, but the places run from 0 to 7: choose one"),
        (
            {"query_places": 7},
            "dataset.query_places=7 came, but from place 2 to the last of 8 there are 1 to 6 to query",
        ),
        ({"tolerance": -1}, "dataset.tolerance=-1 came; a number of places, 0 or more, was wanted"),
        ({"seed": -1}, "dataset.seed=-1 came; a whole number, 0 or more, was wanted"),
        ({"references": "dawn"}, "dataset.references='dawn' came; wanted at least one of dawn, noon, as a list"),
        ({"references": []}, "dataset.references=[] came; wanted at least one of dawn, noon, as a list"),
        ({"references": ["noon", "noon"]}, "dataset.references=['noon', 'noon'] came; name each hour once"),
        ({"references": ["noon", "tea"]}, "dataset.references=tea came; the hours are dawn, noon"),
        ({"query": "tea"}, "dataset.query=tea came; the hours are dawn, noon"),
    ],
)  # fmt: skip
def test_a_rendered_journey_refuses_what_it_cannot_show(arguments, message):
    assert refusal(JOURNEY.check, **(ASKED | arguments)) == message


@pytest.mark.parametrize(
    ("references", "query", "message"),
    [
        (["dawn", "tea"], "noon", "dataset.references=tea: Town has dawn, noon"),
        (["dawn"], "tea", "dataset.query=tea: Town has dawn, noon"),
        ([], "noon", "dataset.references=[]: name at least one hour, each once"),
        (["dawn", "dawn"], "noon", "dataset.references=['dawn', 'dawn']: name at least one hour, each once"),
    ],
)
def test_recordings_refuse_traverses_that_are_unknown_or_named_twice(references, query, message):
    assert refusal(check_recorded, "Town", "hour", ("dawn", "noon"), references, query) == message


def test_the_query_traverse_of_recordings_may_be_the_map():
    check_recorded("Town", "hour", ("dawn", "noon"), ["noon"], "noon")


@pytest.mark.parametrize(("first", "count"), [(-1, 2), (0, 0), (0, -3), (4, 3), (6, 1)])
def test_recordings_refuse_queries_outside_of_their_places(first, count):
    message = refusal(check_recorded_range, 6, first, count, 0)
    assert message.startswith(
        f"dataset.first_query_place={first} and dataset.query_places={count} ask for places {first} "
    )
    assert message.endswith("wanted are one or more of the places 0 to 5")


@pytest.mark.parametrize(("first", "count"), [(0, 6), (5, 1)])
def test_recordings_may_be_queried_from_their_first_place_to_their_last(first, count):
    check_recorded_range(6, first, count, 0)


def test_recordings_refuse_a_negative_tolerance():
    assert refusal(check_recorded_range, 6, 0, 6, -2) == "dataset.tolerance=-2: give 0 or more places"
