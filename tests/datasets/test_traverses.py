"""What is asked of traverses: how places are split, the right places of a query, and what recordings refuse."""

import numpy as np
import pytest

from vprbench.datasets.readers.traverses import (
    check_recorded,
    recorded_split,
    right_places,
    set_aside,
    split,
)
from vprbench.errors import BadInput


def refusal(check, *arguments, **named):
    with pytest.raises(BadInput) as error:
        check(*arguments, **named)
    return str(error.value)


def right(queried, mapped, tolerance):
    return [places.tolist() for places in right_places(np.array(queried), np.array(mapped), tolerance)]


def test_a_tolerance_is_of_places_along_the_journey_and_right_places_are_of_the_map():
    # Of the journey 0 to 9 the map holds 1, 2, 5, 6 and 9, which it numbers 0, 1, 2, 3 and 4.
    assert right([1, 5, 9], [1, 2, 5, 6, 9], tolerance=1) == [[0, 1], [2, 3], [4]]
    assert right([1, 5, 9], [1, 2, 5, 6, 9], tolerance=3) == [[0, 1], [1, 2, 3], [3, 4]]


# How places are split


def test_vprtempo_searches_all_places_and_holds_out_those_before_the_first_query():
    parts = split("vprtempo", 7, 2, 4, 0)
    assert (parts.mapped.tolist(), parts.queried.tolist()) == ([0, 1, 2, 3, 4, 5, 6], [2, 3, 4, 5])
    assert (parts.held_out.tolist(), parts.held_out_in_map) == ([0, 1], True)


def test_the_places_set_aside_are_the_published_draw():
    # The ten numbers that numpy's RandomState(42).permutation(10) is known for: 8 1 5 0 7 2 9 4 3 6.
    assert [set_aside(10, count).tolist() for count in (0, 3, 10)] == [[], [1, 5, 8], [*range(10)]]


def test_vprsnn_searches_none_of_the_places_that_are_set_aside():
    parts = split("vprsnn", 10, 3, 4, 0)
    assert (parts.held_out.tolist(), parts.held_out_in_map) == ([1, 5, 8], False)
    assert parts.mapped.tolist() == [0, 2, 3, 4, 6, 7, 9]
    assert parts.queried.tolist() == [0, 2, 3, 4]


@pytest.mark.parametrize(
    ("protocol", "recorded"),
    [
        ("vprtempo", {"first_query_place": 3, "reference_places": 10, "held_out_places": 3}),
        ("vprsnn", {"reference_places": 7, "held_out_places": 3}),
    ],
)
def test_the_record_tells_how_many_places_there_are_of_each_kind(protocol, recorded):
    assert split(protocol, 10, 3, 4, 1).record() == {"places": 10, "query_places": 4, "tolerance_places": 1} | recorded


def test_an_unknown_protocol_is_answered_with_those_there_are():
    assert refusal(split, "sift", 10, 3, 4, 0) == "dataset.protocol=sift: choose vprtempo or vprsnn"


# What recordings refuse


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


OUTSIDE = [(-1, 2), (0, 0), (0, -3), (4, 3), (6, 1)]


@pytest.mark.parametrize(("first", "count"), OUTSIDE)
def test_recordings_refuse_queries_outside_of_their_places(first, count):
    message = refusal(recorded_split, "vprtempo", 6, first, count, 0)
    assert message.startswith(
        f"dataset.first_query_place={first} and dataset.query_places={count} ask for places {first} "
    )
    assert message.endswith("wanted are one or more of the places 0 to 5, so set both to fit")


@pytest.mark.parametrize(("aside", "count"), OUTSIDE)
def test_recordings_refuse_more_queries_than_places_are_left_once_some_are_set_aside(aside, count):
    message = refusal(recorded_split, "vprsnn", 6, aside, count, 0)
    assert message == (
        f"dataset.first_query_place={aside} and dataset.query_places={count} with dataset.protocol=vprsnn: of 6 "
        "places the first number is set aside and the second queried; wanted are 0 or more and 1 or more, "
        "together at most 6"
    )


def test_queries_may_be_some_places_apart():
    parts = recorded_split("vprtempo", 10, 1, 3, 1, query_stride=4)
    assert (parts.mapped.tolist(), parts.queried.tolist()) == ([*range(10)], [1, 5, 9])
    assert parts.record()["query_stride"] == 4


def test_queries_a_place_apart_are_recorded_as_they_always_were():
    assert "query_stride" not in recorded_split("vprtempo", 10, 1, 3, 1).record()


@pytest.mark.parametrize(
    ("protocol", "arguments", "message"),
    [
        (
            "vprtempo",
            (2, 3),
            "dataset.first_query_place=2 and dataset.query_places=3, dataset.query_stride=4 apart, ask for places 2 to "
            "10; wanted are one or more of the places 0 to 9, so set both to fit",
        ),
        (
            "vprsnn",
            (2, 1),
            "dataset.query_stride=4 with dataset.protocol=vprsnn: give 1 or more places from one query to the next, "
            "and 1 with vprsnn",
        ),
    ],
)
def test_recordings_refuse_queries_that_lie_too_far_apart(protocol, arguments, message):
    assert refusal(recorded_split, protocol, 10, *arguments, 0, query_stride=4) == message


def test_a_tolerance_beyond_all_numbers_makes_every_place_right():
    assert (
        right([0, 2], [0, 1, 2], tolerance=2**63 - 1) == right([0, 2], [0, 1, 2], tolerance=10**30) == [[0, 1, 2]] * 2
    )
