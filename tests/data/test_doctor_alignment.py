"""The doctor's comparison of traverses: aligned, shifted in part or whole, reversed, or too different to tell."""

import re

import numpy as np
import pytest
from doctored import PLACES, season

from vprbench.api.dataset import Dataset
from vprbench.api.images import Images
from vprbench.data.doctor import examine


def compared(references, queries, right=None, tolerance=0, **protocol):
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


def noise(seed, places=PLACES):
    return [*np.random.default_rng(seed).integers(0, 256, (places, 32, 64, 3), np.uint8)]


@pytest.mark.parametrize(
    ("references", "queries", "tolerance", "told"),
    [
        (season(0), season(1), 0, r"summer and spring are aligned: likeness 0\..*20 of 20 stretches agree$"),
        (season(0), noise(5), 0, "too different"),
        *((season(0), noise(seed), 20, "too different") for seed in (8, 9, 10)),  # the best shift is no wrong one
        # what comes a lap further on looks more alike: 25 places, more than a single query is compared with
        ([*noise(6, 25), *season(0, 25) * 4], season(1, 25) * 5, 0, "too different"),
    ],
)
def test_traverses_are_aligned_or_too_different_to_tell(references, queries, tolerance, told):
    (found,) = compared([references], queries, tolerance=tolerance)
    assert found.level == "note"
    assert re.search(told, found.text)


def test_of_several_reference_traverses_the_shifted_one_is_named_and_of_all_the_queries():
    first, second = compared([season(0)[:57], season(2)[3:]], season(1)[:57])
    assert (first.level, second.level) == ("error", "note")
    assert "what fall shows 3 places earlier" in first.text
    assert "summer and spring are aligned" in second.text
    (found,) = compared([season(0)[:57], season(2)[:57]], season(1)[3:])
    assert found.level == "error"
    assert "each of the 2 reference traverses" in found.text
    # Of the 57 queries the first 54 have a place 3 further on; amid these is number 27, which shows place 27 + 3.
    assert found.advice.startswith("compare image 27 of summer with image 30 of spring by eye; ")


@pytest.mark.parametrize(
    ("first_reference", "first_query", "told"),
    [(0, 3, "3 places later"), (3, 0, "3 places earlier"), (0, 1, "1 place later"), (25, 0, "25 places earlier")],
)
def test_a_traverse_that_begins_at_another_place_is_an_error(first_reference, first_query, told):
    long = 120
    references = season(0, long)[first_reference : first_reference + long - 25]
    queries = season(1, long)[first_query : first_query + long - 25]
    (found,) = compared([references], queries)
    assert found.level == "error"
    assert found.text.startswith(f"summer is shifted against spring: all of it shows what spring shows {told} (")


def test_a_part_in_the_middle_is_found_with_its_ends_and_is_a_warning_where_it_is_small():
    references, queries = season(0, 400), season(1, 400)
    queries[100:130] = season(1, 400)[105:135]
    (found,) = compared([references], queries)
    assert found.level == "warning"
    assert "image 100 to image 129 (30 of 400 queries) show what spring shows 5 places later" in found.text


def test_a_shift_is_told_by_the_places_that_the_ground_truth_says_are_right():
    (tolerated,) = compared([season(0)[:58]], season(1)[2:], tolerance=2)
    assert tolerated.level == "note"
    assert "all of it shows what spring shows 2 places later" in tolerated.text
    assert tolerated.advice == "the ground truth counts these places as right"
    right = [[place] for place in range(0, 300, 5)]
    (aligned,) = compared([season(0, 300)], season(1, 300)[::5], right)
    (shifted,) = compared([season(0, 300)], season(1, 300)[3::5], right)
    assert "are aligned" in aligned.text
    assert "all of it shows what spring shows 3 places later" in shifted.text
    order = np.random.default_rng(0).permutation(PLACES)
    (unordered,) = compared([season(0)], [season(1)[place] for place in order], [[int(place)] for place in order])
    assert (unordered.level, unordered.text.startswith("not checked: ")) == ("note", True)
