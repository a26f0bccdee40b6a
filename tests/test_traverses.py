"""What is asked of traverses: the right places of a query, and what recordings refuse."""

import pytest

from vprbench.datasets.traverses import check_recorded, check_recorded_range, places_of, right_places
from vprbench.interface import BadInput


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
