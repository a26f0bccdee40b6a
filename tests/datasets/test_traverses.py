"""What is asked of traverses: how places are split, the right places of a query, and what is refused."""

import numpy as np
import pytest
from image_folders import answer

from vprbench.datasets.readers.traverses import Traverses, right_places, set_aside, split


def right(queried, mapped, tolerance):
    return [places.tolist() for places in right_places(np.array(queried), np.array(mapped), tolerance)]


def test_a_tolerance_is_of_places_along_the_journey_and_right_places_are_of_the_map():
    # Of the journey 0 to 9 the map holds 1, 2, 5, 6 and 9, which it numbers 0, 1, 2, 3 and 4.
    assert right([1, 5, 9], [1, 2, 5, 6, 9], tolerance=1) == [[0, 1], [2, 3], [4]]
    assert right([1, 5, 9], [1, 2, 5, 6, 9], tolerance=3) == [[0, 1], [1, 2, 3], [3, 4]]


@pytest.mark.parametrize("tolerance", [2**63 - 1, 10**30])
def test_a_tolerance_beyond_all_numbers_makes_every_place_right(tolerance):
    assert right([0, 2], [0, 1, 2], tolerance) == [[0, 1, 2]] * 2


def test_the_places_set_aside_are_the_published_draw():
    # The ten numbers that numpy's RandomState(42).permutation(10) is known for: 8 1 5 0 7 2 9 4 3 6.
    assert [set_aside(10, count).tolist() for count in (0, 3, 10)] == [[], [1, 5, 8], [*range(10)]]


@pytest.mark.parametrize(
    ("protocol", "stride", "recorded"),
    [
        ("vprtempo", 1, {"first_query_place": 3, "reference_places": 10, "held_out_places": 3}),
        ("vprtempo", 2, {"first_query_place": 3, "reference_places": 10, "held_out_places": 3, "query_stride": 2}),
        ("vprsnn", 1, {"reference_places": 7, "held_out_places": 3}),
    ],
)
def test_the_record_tells_how_many_places_there_are_of_each_kind(protocol, stride, recorded):
    told = {"places": 10, "query_places": 4, "tolerance_places": 1}
    assert split(protocol, 10, 3, 4, 1, stride).record() == told | recorded


PROTOCOLS = ("vprtempo", "vprsnn")
OUTSIDE = [(-1, 2), (0, 0), (0, -3), (4, 3), (6, 1)]


@pytest.mark.parametrize(
    ("protocol", "asked", "told"),
    [
        ("sift", (3, 4, 0), "dataset.protocol=sift: choose vprtempo or vprsnn"),
        *((name, (first, n, 0), f" need {first + n} places, and ") for name in PROTOCOLS for first, n in OUTSIDE),
        ("vprtempo", (1, 3, 0, 3), " need 8 places, and there are 6"),
        ("vprtempo", (1, 3, 0, 0), "dataset.query_stride=0 with"),
        ("vprsnn", (2, 1, 0, 4), "dataset.query_stride=4 with dataset.protocol=vprsnn"),
        ("vprtempo", (1, 3, -1), "dataset.tolerance=-1"),
    ],
)
def test_a_split_that_does_not_fit_six_places_is_refused_with_its_options(protocol, asked, told):
    message = answer(split, protocol, 6, *asked)
    assert told in message
    assert told.startswith("dataset.") or f"first_query_place={asked[0]} and dataset.query_places={asked[1]}" in message


def test_frames_that_are_missing_between_places_break_the_journey():
    numbers = [10, 20, 30, 60, 70, 110]
    assert Traverses(["a"], "b", None, numbers=numbers).breaks(np.arange(6)).tolist() == [3, 5]
    assert Traverses(["a"], "b", None, numbers=numbers).breaks(np.array([1, 2, 4])).tolist() == [2]
    assert Traverses(["a"], "b", None).breaks(np.array([0, 1, 4, 5])).tolist() == [2]
    assert Traverses(["a"], "b", None).breaks(np.array([0, 2, 4])).tolist() == []
    assert Traverses(["a"], "b", None).breaks(np.array([7])).tolist() == []
