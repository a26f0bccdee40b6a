"""Whatever is asked of the lists, splits and ground truths: no index out of range, and nothing silently reordered."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.configuration import set_hypothesis_home_dir
from little import numbers_in, pictures

from vprbench.api.dataset import Dataset
from vprbench.api.images import Images
from vprbench.datasets import nordland as nordland_module
from vprbench.datasets.nordland import chosen_names
from vprbench.datasets.readers.traverses import (
    Evaluation,
    Split,
    Traverses,
    check_recorded,
    dataset_of,
    right_places,
    set_aside,
    split,
)
from vprbench.errors import BadInput

quickly = settings(derandomize=True, deadline=None, max_examples=100, database=None)


@pytest.fixture(scope="module", autouse=True)
def _nothing_left_behind(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Hypothesis keeps what it found out of the code in a folder where the tests run, unless told of another one."""
    set_hypothesis_home_dir(tmp_path_factory.mktemp("hypothesis"))


N_LISTED = 27_592
SEASONS = ["spring", "summer", "fall", "winter"]
LISTED = [
    f"images-{frame:05d}.png"
    for first, last in csv.reader(Path(nordland_module.__file__).with_name("nordland_runs.csv").read_text().split())
    for frame in range(int(first), int(last) + 1)
]
anything = st.one_of(st.integers(-3, 80), st.sampled_from([-(10**30), 2**31, 2**63 - 1, 2**63, 10**30]))
protocols: st.SearchStrategy[Evaluation] = st.sampled_from(["vprtempo", "vprsnn"])


class Asked(NamedTuple):
    """What fits together: every argument of a split."""

    protocol: Evaluation
    places: int
    first_query_place: int
    query_places: int
    tolerance: int
    query_stride: int

    def parts(self) -> Split:
        return split(*self)

    def options(self) -> dict[str, Any]:
        return self._asdict()


@st.composite
def asked(draw: st.DrawFn, most_places: int = 60) -> Asked:
    protocol = draw(protocols)
    places = draw(st.integers(1, most_places))
    first = draw(st.integers(0, places - 1))
    stride = 1 if protocol == "vprsnn" else draw(st.one_of(st.integers(1, 12), st.just(10**30)))
    queries = draw(st.integers(1, len(range(first, places, stride))))
    tolerance = draw(st.one_of(st.integers(0, places + 2), st.sampled_from([2**63 - 1, 10**30])))
    return Asked(protocol, places, first, queries, tolerance, stride)


def ascending(numbers: list[int]) -> bool:
    return all(a < b for a, b in pairwise(numbers))


# How places are split


@quickly
@given(asked())
def test_places_stay_in_order_queries_lie_in_the_map_as_far_apart_as_asked_and_held_out_ones_are_no_queries(
    given: Asked,
) -> None:
    parts = given.parts()
    mapped, queried, held_out = parts.mapped.tolist(), parts.queried.tolist(), parts.held_out.tolist()
    assert all(map(ascending, (mapped, queried, held_out)))
    assert len(queried) == given.query_places
    assert len(held_out) == given.first_query_place
    assert sorted({*mapped, *held_out}) == [*range(given.places)]
    assert ({*held_out} <= {*mapped}) if given.protocol == "vprtempo" else not {*held_out} & {*mapped}
    allowed = [place for place in mapped if place not in {*held_out}]
    assert queried == allowed[:: given.query_stride][: given.query_places]


@quickly
@given(st.data(), st.integers(1, 300))
def test_what_is_set_aside_grows_by_one_place_at_a_time(data: st.DataObject, places: int) -> None:
    count = data.draw(st.integers(1, places))
    fewer, more = ({*set_aside(places, n).tolist()} for n in (count - 1, count))
    assert fewer < more <= {*range(places)}
    assert len(more) == count


@quickly
@given(protocols, anything, anything, anything, anything, anything)
def test_a_split_of_any_numbers_is_made_or_refused_by_name(
    protocol: Evaluation, places: int, first: int, queries: int, tolerance: int, stride: int
) -> None:
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


# Ground truth


@quickly
@given(asked())
def test_right_are_exactly_the_places_of_the_map_that_lie_within_the_tolerance(given: Asked) -> None:
    parts = given.parts()
    mapped = parts.mapped.tolist()
    found = right_places(parts.queried, parts.mapped, given.tolerance)
    for query, right in zip(parts.queried.tolist(), found, strict=True):
        assert right.tolist() == [i for i, place in enumerate(mapped) if abs(place - query) <= given.tolerance]
        assert query in [mapped[i] for i in right]


def made(given: Asked, traverses: list[int], query: int) -> Dataset:
    """Return the dataset of pictures whose number is 1000 times their traverse's and their place's together."""
    names = [*map(str, traverses)]

    def frames(shown: Sequence[tuple[str, int]]) -> Images:
        return pictures([1000 * int(traverse) + place for traverse, place in shown])

    return dataset_of("made", given.parts(), Traverses(names, str(query), frames), {})


traversed = st.lists(st.integers(0, 4), min_size=1, max_size=3, unique=True)


@quickly
@given(asked(), traversed, st.integers(0, 4))
def test_images_come_traverse_by_traverse_and_every_query_has_its_own_place_right(
    given: Asked, traverses: list[int], query: int
) -> None:
    dataset, mapped = made(given, traverses, query), given.parts().mapped.tolist()
    shown = numbers_in(dataset.references)
    assert shown == [1000 * traverse + place for traverse in traverses for place in mapped]
    assert dataset.places.tolist() == [*range(len(mapped))] * len(traverses)
    for number, right in zip(numbers_in(dataset.queries), dataset.positives, strict=True):
        assert number // 1000 == query
        assert ascending(right.tolist())
        assert {*right.tolist()} <= {*range(dataset.n_places)}
        assert number % 1000 in [mapped[place] for place in right]
    held_out = dataset.held_out
    if held_out is None:
        assert given.first_query_place == 0
        return
    known, asked_of = numbers_in(held_out.references), numbers_in(held_out.queries)
    assert [known[place] % 1000 for place in held_out.right] == [number % 1000 for number in asked_of]
    assert not {*asked_of} & {*numbers_in(dataset.queries)}
    assert held_out.in_map == ({*known} <= {*shown})


# The published lists


@quickly
@given(anything, anything, anything)
def test_names_of_any_numbers_are_as_many_as_asked_for_and_ascending_or_are_refused(
    stride: int, places: int, multiple: int
) -> None:
    listed = [name for name in LISTED if multiple >= 1 and int(name[7:12]) % multiple == 0]
    if min(stride, places, multiple) < 1 or len(range(0, len(listed), stride)) < places:
        with pytest.raises(BadInput, match=r"^dataset\."):
            chosen_names(stride, places, multiple)
    else:
        assert chosen_names(stride, places, multiple) == listed[::stride][:places]


@quickly
@given(st.lists(st.sampled_from(["dawn", "noon", "tea"])), st.sampled_from(["dawn", "noon", "tea"]))
def test_traverses_are_taken_if_all_are_recorded_and_none_is_named_twice(references: list[str], query: str) -> None:
    if references and "tea" not in [*references, query] and len({*references}) == len(references):
        check_recorded("Town", "hour", ("dawn", "noon"), references, query)
    else:
        with pytest.raises(BadInput, match=r"^dataset\.(references|query)="):
            check_recorded("Town", "hour", ("dawn", "noon"), references, query)
