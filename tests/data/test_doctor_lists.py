"""The doctor's checks of lists: names, their order, and the ground truth."""

import numpy as np
import pytest
from doctored import NAMES, PLACES, coded, notes
from little import picture

from vprbench.api.dataset import Dataset
from vprbench.api.images import Images
from vprbench.data.doctor import quick

PLAIN = [f"{number}.png" for number in range(12)]


def checked(
    names=NAMES,
    query_names=NAMES,
    right=None,
    more=(),
    **protocol,
):
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


def places(count, skipped=()):
    """Return the place of its own for each query, none for some."""
    return [[] if query in skipped else [query] for query in range(count)]


PAST_THE_GAP = [*range(10), 8, *range(11, 30), *range(55, 60)]
SHUFFLED = [[int(place)] for place in np.random.default_rng(0).permutation(PLACES)]
AROUND = [range(max(0, query - 1), min(20, query + 2)) for query in range(20)]
FINDINGS = {
    "a name twice too often": ({"names": [*NAMES[:58], "003.png", "003.png"]}, ["note names: 1 2 60 003"]),
    "queries in dictionary order": (
        {"names": PLAIN, "query_names": sorted(PLAIN)},
        ["error order: 10 11 2", "warning names: 10 12 10 2"],
    ),
    "all in dictionary order": ({"names": sorted(PLAIN), "query_names": sorted(PLAIN)}, ["warning order: 10 11 2"]),
    "a file missing in the midst": (
        {"names": [name for name in NAMES if name != "020.png"], "query_names": NAMES[:59]},
        ["warning names: 38 59 021 022"],
    ),
    "references that begin at another file": ({"more": [[*NAMES[1:], NAMES[0]]]}, ["warning names: 60 60 001 000"]),
    "queries of every other place": (
        {"query_names": NAMES[:20], "right": [[2 * query] for query in range(20)]},
        ["note ground truth: 40 60"],
    ),
    "names of another scheme": ({"query_names": [f"frame{number:03d}.png" for number in range(PLACES)]}, []),
    "queries without a right place": (
        {"right": places(PLACES, (4, 9, 14))},
        ["warning ground truth: 3 60 1 95.0 004 009 014", "note ground truth: 3 60"],
    ),
    "such queries, asked for": (
        {"right": places(PLACES, (4,)), "unmatched": "keep"},
        ["note ground truth: 1 60 1 98.3 004", "note ground truth: 1 60"],
    ),
    "no right place at all": (
        {"right": [[]] * PLACES},
        ["error ground truth: 60 60 1 0.0 000 001 002 003 004 55", "note ground truth: 60 60"],
    ),
    "most places right": (
        {"right": [range(45)] * PLACES},
        ["warning ground truth: 60 60 10 60 75.0", "note ground truth: 15 60"],
    ),
    # 18 queries with 3 of 20 places and 2 with 2 of 20, which is no more than 10 %
    "few places, a wide tolerance": (
        {"names": NAMES[:20], "query_names": NAMES[:20], "right": AROUND, "tolerance_places": 1},
        ["note ground truth: 18 20 10 20 14.5"],
    ),
    "places that are never right": ({"query_names": NAMES[:48]}, ["note ground truth: 12 60"]),
    "more right than the tolerance allows": (
        {"right": [*places(7), [6, 7, 8, 9], *places(PLACES)[8:]], "tolerance_places": 1},
        ["warning ground truth: 1 3 1 007"],
    ),
    "a step back and a leap": (
        {"query_names": NAMES[: len(PAST_THE_GAP)], "right": [[middle] for middle in PAST_THE_GAP]},
        ["note ground truth: 26 60", "note ground truth: 1 010", "note ground truth: 1 030"],
    ),
    "no order at all": ({"right": SHUFFLED, "query_names": [f"q{name}" for name in NAMES]}, []),
}


@pytest.mark.parametrize("lists", FINDINGS)
def test_the_cheap_checks_find_in_lists(lists, tmp_path):
    given, expected = FINDINGS[lists]
    assert coded(checked(**given), tmp_path) == expected


@pytest.mark.parametrize(
    "names", [PLAIN, [f"{number:02d}.png" for number in range(12)], list("gadbhecf"), PLAIN[::-1]], ids=str
)
def test_other_orders_are_not_taken_for_dictionary_order(names):
    assert not [finding for finding in checked(names=names, query_names=names) if finding.check == "order"]


def test_the_notes_of_a_dataset_are_shown():
    frames, own = Images.from_arrays([picture(0)] * 2), (np.array([0]), np.array([1]))
    dataset = Dataset("noted", frames, np.arange(2), frames, own, {}, notes=("41 rows step back in time",))
    assert notes(quick(dataset), "dataset") == ["41 rows step back in time"]
