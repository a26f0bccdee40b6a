"""Whatever is asked of the lists, splits and ground truths: no index out of range, and nothing silently reordered."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.configuration import set_hypothesis_home_dir
from little import numbers_in, pictures

from vprbench.api.dataset import Dataset
from vprbench.api.images import Images
from vprbench.datasets import nordland as nordland_module
from vprbench.datasets.folders import folders
from vprbench.datasets.nordland import chosen_names, nordland
from vprbench.datasets.oxford_robotcar import lists
from vprbench.datasets.oxford_robotcar.lists import every, published_timestamps
from vprbench.datasets.readers.traverses import (
    Evaluation,
    Split,
    Traverses,
    check_recorded,
    dataset_of,
    recorded_split,
    right_places,
    set_aside,
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

    def split(self) -> Split:
        return recorded_split(*self)

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
def test_places_stay_in_their_order_and_inside_their_journey(given: Asked) -> None:
    parts = given.split()
    for numbers in (parts.mapped.tolist(), parts.queried.tolist(), parts.held_out.tolist()):
        assert ascending(numbers)
        assert {*numbers} <= {*range(given.places)}


@quickly
@given(asked())
def test_no_held_out_place_is_queried_and_every_queried_one_is_in_the_map(given: Asked) -> None:
    parts = given.split()
    queried = parts.queried.tolist()
    assert len(queried) == given.query_places
    assert {*queried} <= {*parts.mapped.tolist()}
    assert not {*queried} & {*parts.held_out.tolist()}
    assert len(parts.held_out) == given.first_query_place


@quickly
@given(asked())
def test_the_map_is_the_whole_journey_or_with_what_is_set_aside_makes_it_up(given: Asked) -> None:
    parts = given.split()
    aside = [] if given.protocol == "vprtempo" else parts.held_out.tolist()
    assert sorted([*parts.mapped.tolist(), *aside]) == [*range(given.places)]


@quickly
@given(asked())
def test_queries_are_as_far_apart_in_the_map_as_was_asked_from_its_first_that_may_be_queried(given: Asked) -> None:
    parts = given.split()
    allowed = [place for place in parts.mapped.tolist() if place not in {*parts.held_out.tolist()}]
    assert parts.queried.tolist() == allowed[:: given.query_stride][: given.query_places]


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
            recorded_split(protocol, places, first, queries, tolerance, stride)
    elif places <= 80:
        assert len(recorded_split(protocol, places, first, queries, tolerance, stride).queried) == queries


# Ground truth


@quickly
@given(asked())
def test_right_are_exactly_the_places_of_the_map_that_lie_within_the_tolerance(given: Asked) -> None:
    parts = given.split()
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

    return dataset_of("made", given.split(), Traverses(names, str(query), frames), {})


traversed = st.lists(st.integers(0, 4), min_size=1, max_size=3, unique=True)


@quickly
@given(asked(), traversed, st.integers(0, 4))
def test_references_come_traverse_by_traverse_and_place_by_place(
    given: Asked, traverses: list[int], query: int
) -> None:
    dataset, mapped = made(given, traverses, query), given.split().mapped.tolist()
    assert numbers_in(dataset.references) == [1000 * traverse + place for traverse in traverses for place in mapped]
    assert dataset.places.tolist() == [*range(len(mapped))] * len(traverses)


@quickly
@given(asked(), traversed, st.integers(0, 4))
def test_a_query_has_its_own_place_among_its_right_ones_and_none_outside_of_the_map(
    given: Asked, traverses: list[int], query: int
) -> None:
    dataset = made(given, traverses, query)
    shown = [number % 1000 for number in numbers_in(dataset.references)]
    for number, right in zip(numbers_in(dataset.queries), dataset.positives, strict=True):
        assert number // 1000 == query
        assert ascending(right.tolist())
        assert {*right.tolist()} <= {*range(dataset.n_places)}
        assert number % 1000 in [shown[place] for place in right]


@quickly
@given(asked(), traversed, st.integers(0, 4))
def test_held_out_queries_have_their_own_place_right_and_are_no_queries(
    given: Asked, traverses: list[int], query: int
) -> None:
    dataset = made(given, traverses, query)
    held_out = dataset.held_out
    if held_out is None:
        assert given.first_query_place == 0
        return
    shown, numbers = numbers_in(held_out.references), numbers_in(held_out.queries)
    assert [shown[place] % 1000 for place in held_out.right] == [number % 1000 for number in numbers]
    assert not {*numbers} & {*numbers_in(dataset.queries)}
    assert held_out.in_map == ({*shown} <= {*numbers_in(dataset.references)})


# The published lists


@quickly
@given(st.integers(1, 4000), st.data())
def test_the_places_of_nordland_are_names_of_the_list_in_its_order(stride: int, data: st.DataObject) -> None:
    places = data.draw(st.integers(1, len(range(0, N_LISTED, stride))))
    assert chosen_names(stride, places, 1) == [LISTED[k * stride] for k in range(places)]


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


def rows_of(traverse: str) -> list[int]:
    return [int(row) for row in Path(lists.__file__).with_name(f"oxford_{traverse}.csv").read_text().split()]


@quickly
@given(st.sampled_from(["sun", "rain", "dusk"]), st.integers(1, 600), st.data())
def test_the_places_of_robotcar_are_rows_of_the_list_in_its_order_however_often_an_image_comes(
    traverse: str, stride: int, data: st.DataObject
) -> None:
    places = data.draw(st.integers(1, len(range(0, 3369, stride))))
    rows = rows_of(traverse)
    assert every(published_timestamps(traverse), stride, places) == [rows[k * stride] for k in range(places)]


# Nordland as a whole, over empty files


@pytest.fixture(scope="module")
def seasons(tmp_path_factory: pytest.TempPathFactory) -> str:
    root = tmp_path_factory.mktemp("nordland")
    (root / "spring").mkdir()
    for name in LISTED[:240]:
        (root / "spring" / name).touch()
    for season in SEASONS[1:]:
        (root / season).symlink_to(root / "spring")
    return str(root)


@quickly
@given(
    asked(most_places=30),
    st.integers(1, 8),
    st.lists(st.sampled_from(SEASONS), min_size=1, unique=True),
    st.sampled_from(SEASONS),
)
def test_a_query_of_nordland_is_named_like_the_references_of_one_of_its_right_places(
    seasons: str, given: Asked, stride: int, references: list[str], query: str
) -> None:
    dataset = nordland(root=seasons, references=references, query=query, stride=stride, **given.options())
    names, n_places = dataset.references.names, dataset.n_places
    assert [*names] == sorted({*names}) * len(references)
    assert [*dataset.queries.names] == sorted(dataset.queries.names)
    for asked, right in zip(dataset.queries.names, dataset.positives, strict=True):
        assert 0 <= right.min() <= right.max() < n_places
        assert asked in [names[place] for place in right]
    for folder in dataset.folders:
        assert [*folder.used] == sorted({*folder.used})


@quickly
@given(st.lists(st.sampled_from(["dawn", "noon", "tea"])), st.sampled_from(["dawn", "noon", "tea"]))
def test_traverses_are_taken_if_all_are_recorded_and_none_is_named_twice(references: list[str], query: str) -> None:
    if references and "tea" not in [*references, query] and len({*references}) == len(references):
        check_recorded("Town", "hour", ("dawn", "noon"), references, query)
    else:
        with pytest.raises(BadInput, match=r"^dataset\.(references|query)="):
            check_recorded("Town", "hour", ("dawn", "noon"), references, query)


# Folders matched by their order

MOST_IMAGES = 13


@pytest.fixture(scope="module")
def numbered(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder for each number of images, which are empty files."""
    root = tmp_path_factory.mktemp("numbered")
    for count in range(1, MOST_IMAGES + 1):
        for number in range(count):
            (root / f"{count}" / "a").mkdir(parents=True, exist_ok=True)
            (root / f"{count}" / "a" / f"{number}.png").touch()
    return root


images = st.integers(1, MOST_IMAGES)


@quickly
@given(images, images, st.integers(1, 3), st.integers(0, MOST_IMAGES), st.sampled_from(["error", "keep"]))
def test_images_of_folders_are_matched_by_their_number_or_refused(
    numbered: Path, n_references: int, n_queries: int, traverses: int, reach: int, unmatched: Literal["error", "keep"]
) -> None:
    references = [str(numbered / str(n_references))] * traverses

    def matched() -> Dataset:
        return folders(
            references=references, queries=str(numbered / str(n_queries)), tolerance=reach, unmatched=unmatched
        )

    lonely = n_queries - 1 > n_references - 1 + reach
    if lonely and unmatched == "error":
        with pytest.raises(BadInput, match="have no reference within"):
            matched()
        return
    dataset = matched()
    assert [*dataset.references.names] == [f"{number}.png" for number in range(n_references)] * traverses
    assert [*dataset.queries.names] == [f"{number}.png" for number in range(n_queries)]
    assert dataset.places.tolist() == [*range(n_references)] * traverses
    for query, right in enumerate(dataset.positives):
        assert right.tolist() == [place for place in range(n_references) if abs(place - query) <= reach]


@quickly
@given(images, images, anything)
def test_any_tolerance_of_folders_is_taken_or_refused(
    numbered: Path, n_references: int, n_queries: int, reach: int
) -> None:
    try:
        dataset = folders(
            references=[str(numbered / str(n_references))],
            queries=str(numbered / str(n_queries)),
            tolerance=reach,
            unmatched="keep",
        )
    except BadInput:
        assert reach < 0
    else:
        within = np.abs(np.arange(n_queries)[:, None] - np.arange(n_references)) <= reach
        assert [right.tolist() for right in dataset.positives] == [np.flatnonzero(row).tolist() for row in within]
