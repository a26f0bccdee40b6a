"""The doctor's comparison of traverses: aligned, shifted in part or whole, reversed, or too different to tell."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from doctored import PLACES, season

from vprbench.api.arrays import Image
from vprbench.api.dataset import Dataset
from vprbench.api.images import Images
from vprbench.data.doctor import Finding, examine, offsets


def compared(
    references: Sequence[Sequence[Image]],
    queries: Sequence[Image],
    right: Sequence[Sequence[int]] | None = None,
    tolerance: int = 0,
    **protocol: Any,
) -> list[Finding]:
    """Return what alignment says where query i shows place i, give or take the tolerance, or `right` if given."""
    places = len(references[0])
    if right is None:
        right = [range(max(0, i - tolerance), min(places, i + tolerance + 1)) for i in range(len(queries))]
    dataset = Dataset(
        name="ride",
        references=Images.from_arrays([frame for frames in references for frame in frames]),
        places=np.tile(np.arange(places), len(references)),
        queries=Images.from_arrays(queries),
        positives=tuple(np.array(one, np.int64) for one in right),
        protocol={"references": ["spring", "fall"][: len(references)], "query": "summer", **protocol},
    )
    return [finding for finding in examine(dataset) if finding.check == "alignment"]


def test_aligned_seasons_are_called_aligned() -> None:
    (found,) = compared([season(0)], season(1))

    assert found.level == "note"
    assert found.text.startswith("summer and spring are aligned: likeness 0.")
    assert found.text.endswith("20 of 20 stretches agree")


@pytest.mark.parametrize(
    ("first_reference", "first_query", "told"),
    [(0, 3, "3 places later"), (3, 0, "3 places earlier"), (0, 1, "1 place later"), (25, 0, "25 places earlier")],
)
def test_a_traverse_that_begins_at_another_place_is_an_error(first_reference: int, first_query: int, told: str) -> None:
    long = 120
    references = season(0, long)[first_reference : first_reference + long - 25]
    queries = season(1, long)[first_query : first_query + long - 25]

    (found,) = compared([references], queries)

    assert found.level == "error"
    assert found.text.startswith(f"summer is shifted against spring: all of it shows what spring shows {told} (")


def test_the_advice_names_two_frames_that_show_the_same_place() -> None:
    (found,) = compared([season(0)[:57]], season(1)[3:])

    # Of the 57 queries the first 54 have a place 3 further on; amid these is number 27, which shows place 27 + 3.
    assert found.advice.startswith("compare image 27 of summer with image 30 of spring by eye; ")


def test_one_shifted_reference_traverse_among_several_is_named() -> None:
    first, second = compared([season(0)[:57], season(2)[3:]], season(1)[:57])

    assert (first.level, second.level) == ("error", "note")
    assert "summer is shifted against fall: all of it shows what fall shows 3 places earlier" in first.text
    assert "summer and spring are aligned" in second.text


def test_where_all_reference_traverses_say_the_same_the_queries_are_told_to_be_shifted_once() -> None:
    (found,) = compared([season(0)[:57], season(2)[:57]], season(1)[3:])

    assert found.level == "error"
    assert found.text.startswith("summer is shifted against each of the 2 reference traverses: all of it shows what ")


def test_a_part_in_the_middle_is_found_with_its_ends_and_is_a_warning_where_it_is_small() -> None:
    references, queries = season(0, 400), season(1, 400)
    queries[100:130] = season(1, 400)[105:135]

    (found,) = compared([references], queries)

    assert found.level == "warning"
    assert "image 100 to image 129 (30 of 400 queries) show what spring shows 5 places later" in found.text


def test_a_shift_within_the_tolerance_is_only_noted() -> None:
    (found,) = compared([season(0)[:58]], season(1)[2:], tolerance=2)

    assert found.level == "note"
    assert "all of it shows what spring shows 2 places later" in found.text
    assert found.advice == "the ground truth counts these places as right"


def test_places_of_another_road_are_not_called_aligned_nor_shifted() -> None:
    noise = np.random.default_rng(5).integers(0, 256, (PLACES, 32, 64, 3), np.uint8)

    (found,) = compared([season(0)], [*noise])

    assert found.level == "note"
    assert found.text.startswith("summer and spring look too different to tell whether they are aligned")


@pytest.mark.parametrize("seed", [8, 9, 10])
def test_what_looks_no_more_alike_than_places_elsewhere_is_not_called_aligned(seed: int) -> None:
    noise = np.random.default_rng(seed).integers(0, 256, (PLACES, 32, 64, 3), np.uint8)

    (found,) = compared([season(0)], [*noise], tolerance=20)  # the best shift is no wrong one

    assert found.text.startswith("summer and spring look too different to tell whether they are aligned")


def test_what_looks_more_alike_a_lap_further_on_is_not_called_aligned() -> None:
    lap = 25  # places, more than a single query is compared with
    noise = np.random.default_rng(6).integers(0, 256, (lap, 32, 64, 3), np.uint8)

    (found,) = compared([[*noise, *season(0, lap) * 4]], season(1, lap) * 5)

    assert found.text.startswith("summer and spring look too different to tell whether they are aligned")


def test_every_fifth_frame_as_a_query_is_compared_with_the_place_it_stands_for() -> None:
    right = [[place] for place in range(0, 300, 5)]

    (aligned,) = compared([season(0, 300)], season(1, 300)[::5], right)
    (shifted,) = compared([season(0, 300)], season(1, 300)[3::5], right)

    assert "are aligned" in aligned.text
    assert "all of it shows what spring shows 3 places later" in shifted.text


def test_an_unordered_ground_truth_says_nothing_of_shifts() -> None:
    order = np.random.default_rng(0).permutation(PLACES)

    (found,) = compared([season(0)], [season(1)[place] for place in order], [[int(place)] for place in order])

    assert (found.level, found.text) == (
        "note",
        "not checked: the right place does not advance from query to query",
    )


def test_the_peak_is_that_of_all_shifts_tried_one_by_one() -> None:
    rng = np.random.default_rng(3)
    places = offsets.described(rng.integers(0, 256, (50, 16, 32)).astype(np.uint8))
    middles = np.sort(rng.integers(0, 50, 31))
    queries = places[::-1][np.clip(middles - 9, 0, 49)]

    found = offsets.peak(queries, middles, places)

    means = {}
    for backwards, ordered in ((False, places), (True, places[::-1])):
        for shift in range(-49, 50):
            pairs = [(query, middle + shift) for query, middle in enumerate(middles) if 0 <= middle + shift < 50]
            if len(pairs) >= 15.5:
                means[backwards, shift] = np.mean([queries[query] @ ordered[place] for query, place in pairs])
    assert (found.backwards, found.shift) == max(means, key=means.__getitem__) == (True, -9)
    assert float(np.nanmean(found.likeness)) == pytest.approx(means[True, -9], abs=1e-5)


def test_a_traverse_is_described_the_same_in_any_light() -> None:
    small = np.random.default_rng(4).integers(0, 120, (30, 16, 32)).astype(np.uint8)

    dark, light = offsets.described(small), offsets.described(small * np.uint8(2))

    assert np.einsum("ij,ij->i", dark, light).min() > 0.99
