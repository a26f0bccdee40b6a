"""Whatever is asked of traverses: places are split, numbered and matched by rule, or refused by the option's name."""

from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from image_folders import answer
from little import numbers_in, pictures

from vprbench.datasets.readers.traverses import (
    Evaluation,
    Traverses,
    dataset_of,
    right_places,
    set_aside,
    split,
)
from vprbench.errors import BadInput

quickly = settings(derandomize=True, deadline=None, max_examples=60, database=None)
anything = st.one_of(st.integers(-3, 80), st.sampled_from([-(10**30), 2**31, 2**63 - 1, 2**63, 10**30]))
protocols = st.sampled_from(["vprtempo", "vprsnn"])


class Asked(NamedTuple):
    """What fits together: every argument of a split."""

    protocol: Evaluation
    places: int
    first_query_place: int
    query_places: int
    tolerance: int
    query_stride: int

    def parts(self):
        return split(*self)


@st.composite
def asked(draw):
    protocol = draw(protocols)
    places = draw(st.integers(1, 60))
    first = draw(st.integers(0, places - 1))
    stride = 1 if protocol == "vprsnn" else draw(st.one_of(st.integers(1, 12), st.just(10**30)))
    queries = draw(st.integers(1, len(range(first, places, stride))))
    tolerance = draw(st.one_of(st.integers(0, places + 2), st.sampled_from([2**63 - 1, 10**30])))
    return Asked(protocol, places, first, queries, tolerance, stride)


@quickly
@given(asked())
def test_places_stay_in_order_queries_lie_in_the_map_and_right_is_what_lies_within_the_tolerance(given):
    parts = given.parts()
    mapped, queried, held_out = parts.mapped.tolist(), parts.queried.tolist(), parts.held_out.tolist()
    assert all(numbers == sorted({*numbers}) for numbers in (mapped, queried, held_out))
    assert (len(queried), len(held_out)) == (given.query_places, given.first_query_place)
    assert sorted({*mapped, *held_out}) == [*range(given.places)]
    assert ({*held_out} <= {*mapped}) if given.protocol == "vprtempo" else not {*held_out} & {*mapped}
    allowed = [place for place in mapped if place not in {*held_out}]
    assert queried == allowed[:: given.query_stride][: given.query_places]
    found = right_places(parts.queried, parts.mapped, given.tolerance)
    for query, right in zip(queried, found, strict=True):
        assert right.tolist() == [i for i, place in enumerate(mapped) if abs(place - query) <= given.tolerance]


@pytest.mark.parametrize(
    ("protocol", "stride", "recorded"),
    [
        ("vprtempo", 2, {"first_query_place": 3, "reference_places": 10, "held_out_places": 3, "query_stride": 2}),
        ("vprsnn", 1, {"reference_places": 7, "held_out_places": 3}),
    ],
)
def test_the_places_set_aside_are_the_published_draw_and_the_record_counts_the_places(protocol, stride, recorded):
    # The ten numbers that numpy's RandomState(42).permutation(10) is known for: 8 1 5 0 7 2 9 4 3 6.
    assert [set_aside(10, count).tolist() for count in (0, 3, 10)] == [[], [1, 5, 8], [*range(10)]]
    told = {"places": 10, "query_places": 4, "tolerance_places": 1}
    assert split(protocol, 10, 3, 4, 1, stride).record() == told | recorded


@quickly
@given(protocols, anything, anything, anything, anything, anything)
def test_a_split_of_any_numbers_is_made_or_refused_by_name(protocol, places, first, queries, tolerance, stride):
    fits = (
        first >= 0
        and queries >= 1
        and tolerance >= 0
        and (stride == 1 if protocol == "vprsnn" else stride >= 1)
        and first + (queries - 1) * stride < places
    )
    if not fits:
        with pytest.raises(BadInput, match=r"^dataset\.\w+=-?\d"):
            split(protocol, places, first, queries, tolerance, stride)
    elif places <= 80:
        assert len(split(protocol, places, first, queries, tolerance, stride).queried) == queries


@pytest.mark.parametrize(
    ("protocol", "asked", "told"),
    [
        ("sift", (3, 4, 0), "dataset.protocol=sift: choose vprtempo or vprsnn"),
        *(
            (name, (4, 3, 0), "dataset.first_query_place=4 and dataset.query_places=3")
            for name in ("vprtempo", "vprsnn")
        ),
        ("vprtempo", (1, 3, 0, 3), " need 8 places, and there are 6"),
        ("vprtempo", (1, 3, 0, 0), "dataset.query_stride=0 with"),
        ("vprsnn", (2, 1, 0, 4), "dataset.query_stride=4 with dataset.protocol=vprsnn"),
        ("vprtempo", (1, 3, -1), "dataset.tolerance=-1"),
    ],
)
def test_a_split_that_does_not_fit_six_places_is_refused_with_its_options(protocol, asked, told):
    assert told in answer(split, protocol, 6, *asked)


def test_frames_that_are_missing_between_places_break_the_journey():
    numbers = [10, 20, 30, 60, 70, 110]
    assert Traverses(["a"], "b", None, numbers=numbers).breaks(np.arange(6)).tolist() == [3, 5]
    assert Traverses(["a"], "b", None, numbers=numbers).breaks(np.array([1, 2, 4])).tolist() == [2]
    for places, broken in (([0, 1, 4, 5], [2]), ([0, 2, 4], []), ([7], [])):
        assert Traverses(["a"], "b", None).breaks(np.array(places)).tolist() == broken


def made(given, traverses, query):
    """Return the dataset of pictures whose number is 1000 times their traverse's and their place's together."""

    def frames(shown):
        return pictures([1000 * int(traverse) + place for traverse, place in shown])

    return dataset_of(
        "made", given.parts(), Traverses([*map(str, traverses)], str(query), frames), {"kind": 1}, ["note"]
    )


@quickly
@given(asked(), st.lists(st.integers(0, 4), min_size=1, max_size=3, unique=True), st.integers(0, 4))
def test_images_come_traverse_by_traverse_and_every_query_has_its_own_place_right(given, traverses, query):
    dataset, parts = made(given, traverses, query), given.parts()
    mapped = parts.mapped.tolist()
    shown = numbers_in(dataset.references)
    assert shown == [1000 * traverse + place for traverse in traverses for place in mapped]
    assert dataset.places.tolist() == [*range(len(mapped))] * len(traverses)
    assert numbers_in(dataset.queries) == [1000 * query + place for place in parts.queried.tolist()]
    assert (dataset.name, dict(dataset.protocol), dataset.notes) == ("made", {"kind": 1}, ("note",))
    for number, right in zip(numbers_in(dataset.queries), dataset.positives, strict=True):
        assert number % 1000 in [mapped[place] for place in right]
    numbers = dataset.place_numbers
    assert (numbers is None) if given.protocol == "vprtempo" else (numbers is not None and numbers.tolist() == mapped)
    held_out = dataset.held_out
    if held_out is None:
        assert given.first_query_place == 0
        return
    known, asked_of = numbers_in(held_out.references), numbers_in(held_out.queries)
    assert [known[place] % 1000 for place in held_out.right] == [number % 1000 for number in asked_of]
    assert asked_of == [1000 * query + place for place in parts.held_out.tolist()]
    assert held_out.places.tolist() == [*range(len(asked_of))] * len(traverses)
    assert held_out.in_map == ({*known} <= {*shown}) == (given.protocol == "vprtempo")
