"""The doctor's checks of lists: names, their order, and the ground truth."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from doctored import NAMES, PLACES, notes, wrong
from little import picture

from vprbench.api.dataset import Dataset
from vprbench.api.images import Images
from vprbench.data.doctor import Finding, quick

PLAIN = [f"{number}.png" for number in range(12)]


def checked(
    names: Sequence[str] = NAMES,
    query_names: Sequence[str] = NAMES,
    right: Sequence[Sequence[int]] | None = None,
    more: Sequence[Sequence[str]] = (),
    **protocol: Any,
) -> tuple[Finding, ...]:
    """Return what the cheap checks find where places, queries and further reference traverses have these names."""
    listed = [*names, *(name for others in more for name in others)]
    positives = [[number] for number in range(len(query_names))] if right is None else right
    return quick(
        Dataset(
            name="lists",
            references=Images.from_arrays([picture(0)] * len(listed), listed),
            places=np.tile(np.arange(len(names)), 1 + len(more)),
            queries=Images.from_arrays([picture(0)] * len(query_names), query_names),
            positives=tuple(np.array(places, np.int64) for places in positives),
            protocol={"references": ["sun", "rain"][: 1 + len(more)], "query": "dusk", **protocol},
        )
    )


def test_names_that_a_list_repeats_are_noted() -> None:
    names = [*NAMES[:58], "003.png", "003.png"]

    found = checked(names=names)

    assert notes(found, "names") == ["the list of sun repeats 1 name, 2 times in 60 images: 003.png"]


def test_a_query_list_in_dictionary_order_is_an_error_where_the_references_are_in_natural_order() -> None:
    ((level, check, text),) = [
        found for found in wrong(checked(names=PLAIN, query_names=sorted(PLAIN))) if found[1] == "order"
    ]

    assert (level, check) == ("error", "order")
    assert text == (
        "dusk is in dictionary order, not in the order of the numbers: ... 10.png, 11.png, 2.png ...; the other "
        "traverses are in the order of the numbers"
    )


def test_dictionary_order_everywhere_is_a_warning_for_places_still_fit() -> None:
    (found,) = wrong(checked(names=sorted(PLAIN), query_names=sorted(PLAIN)))

    assert found == (
        "warning",
        "order",
        "sun and dusk are in dictionary order, not in the order of the numbers: ... 10.png, 11.png, 2.png ...",
    )


@pytest.mark.parametrize(
    "names", [PLAIN, [f"{number:02d}.png" for number in range(12)], list("gadbhecf"), PLAIN[::-1]], ids=str
)
def test_other_orders_are_not_taken_for_dictionary_order(names: Sequence[str]) -> None:
    assert not [finding for finding in checked(names=names, query_names=names) if finding.check == "order"]


def test_a_file_missing_in_the_midst_shows_in_the_names_from_there_on() -> None:
    found = checked(names=[name for name in NAMES if name != "020.png"], query_names=NAMES[:59])

    assert wrong(found) == [
        (
            "warning",
            "names",
            "38 of 59 images of dusk are matched with one of another name in sun, though sun holds one of the same "
            "name; the first is 021.png, matched with 022.png",
        )
    ]


def test_reference_traverses_are_compared_by_name_too() -> None:
    ((_, check, text),) = wrong(checked(more=[[*NAMES[1:], NAMES[0]]]))

    assert check == "names"
    assert text.startswith("60 of 60 images of rain are matched with one of another name in sun")


def test_equal_names_mean_nothing_where_the_ground_truth_skips_places() -> None:
    right = [[2 * query] for query in range(20)]

    assert not wrong(checked(names=NAMES, query_names=NAMES[:20], right=right))


def test_names_of_another_scheme_are_not_compared() -> None:
    assert checked(query_names=[f"frame{number:03d}.png" for number in range(PLACES)]) == ()


def test_queries_without_a_right_place_bound_the_recall() -> None:
    right = [[] if query in (4, 9, 14) else [query] for query in range(PLACES)]

    found = checked(right=right)

    assert wrong(found) == [
        (
            "warning",
            "ground truth",
            "3 of 60 queries have no right place and count as misses, so that R@1 is at most 95.0%: "
            "004.png, 009.png, 014.png",
        )
    ]


def test_queries_without_a_right_place_are_only_noted_where_they_were_asked_for() -> None:
    right = [[] if query == 4 else [query] for query in range(PLACES)]

    found = checked(right=right, unmatched="keep")

    assert not wrong(found)
    assert notes(found, "ground truth")[0].startswith("1 of 60 queries have no right place")


def test_a_ground_truth_without_any_right_place_is_an_error() -> None:
    assert [level for level, _, _ in wrong(checked(right=[[]] * PLACES))] == ["error"]


def test_a_radius_that_makes_most_places_right_is_a_warning() -> None:
    found = checked(right=[range(45)] * PLACES)

    assert (
        "warning",
        "ground truth",
        "for 60 of 60 queries more than 10% of the 60 places are right; a guess is right for 75.0% of all",
    ) in wrong(found)


def test_a_wide_tolerance_among_few_places_is_noted() -> None:
    names = NAMES[:20]
    right = [range(max(0, query - 1), min(20, query + 2)) for query in range(20)]

    found = checked(names=names, query_names=names, right=right, tolerance_places=1)

    # 18 queries with 3 of 20 places and 2 with 2 of 20, which is no more than 10 %
    assert not wrong(found)
    assert notes(found, "ground truth") == [
        "for 18 of 20 queries more than 10% of the 20 places are right; a guess is right for 14.5% of all"
    ]


def test_places_that_are_never_right_are_counted() -> None:
    found = checked(query_names=NAMES[:48])

    assert notes(found, "ground truth") == ["12 of 60 places are right for no query: they are there to be mistaken"]


def test_more_right_places_than_the_tolerance_allows_are_a_warning() -> None:
    right = [[query] for query in range(PLACES)]
    right[7] = [6, 7, 8, 9]

    ((level, _, text),) = wrong(checked(right=right, tolerance_places=1))

    assert level == "warning"
    assert text == "a tolerance of 1 place allows 3 right at most, but of 1 query more are right: 007.png"


def test_a_ground_truth_that_goes_back_and_leaps_is_noted_with_the_query() -> None:
    middles = [*range(10), 8, *range(11, 30), *range(55, 60)]

    found = checked(query_names=NAMES[: len(middles)], right=[[middle] for middle in middles])

    assert notes(found, "ground truth")[1:] == [
        "the right place goes back 1 time from one query to the next: at 010.png",
        "the right place leaps ahead 1 time from one query to the next: at 030.png",
    ]


def test_an_unordered_ground_truth_neither_goes_back_nor_leaps() -> None:
    order = np.random.default_rng(0).permutation(PLACES)

    assert checked(right=[[int(place)] for place in order], query_names=[f"q{name}" for name in NAMES]) == ()


def test_the_notes_of_a_dataset_are_shown(tmp_path: Path) -> None:
    dataset = Dataset(
        name="noted",
        references=Images.from_arrays([picture(0)] * 2),
        places=np.arange(2),
        queries=Images.from_arrays([picture(0)] * 2),
        positives=(np.array([0]), np.array([1])),
        protocol={},
        notes=("41 rows step back in time",),
    )

    assert notes(quick(dataset), "dataset") == ["41 rows step back in time"]
