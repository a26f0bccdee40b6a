"""What the doctor finds in lists, in the comparison of traverses, in recordings, and in real frames."""

import re
from dataclasses import replace

import numpy as np
import pytest
from doctored import NAMES, PLACES, coded, dataset_of, healthy, season
from little import picture

from vprbench.api.dataset import Dataset
from vprbench.api.events import Events, Recording
from vprbench.api.images import Images
from vprbench.data.doctor import examine, quick

PLAIN = [f"{number}.png" for number in range(12)]


def ride(references, queries, right, names=None, query_names=None, **protocol):
    """Return a dataset of one or two reference traverses and, for each query, the places that are right."""
    return Dataset(
        name="ride",
        references=Images.from_arrays([frame for frames in references for frame in frames], names),
        places=np.tile(np.arange(len(references[0])), len(references)),
        queries=Images.from_arrays(queries, query_names),
        positives=tuple(np.array(places, np.int64) for places in right),
        protocol={"references": ["spring", "fall"][: len(references)], "query": "summer", **protocol},
    )


def checked(names=NAMES, query_names=NAMES, right=None, more=(), **protocol):
    """Return what the cheap checks find where places, queries and further reference traverses have these names."""
    listed = [*names, *(name for others in more for name in others)]
    references, queries = [[picture(0)] * len(names)] * (1 + len(more)), [picture(1)] * len(query_names)
    return quick(ride(references, queries, right or places(len(query_names)), listed, query_names, **protocol))


def places(count, skipped=()):
    """Return the place of its own for each query, none for some."""
    return [[] if query in skipped else [query] for query in range(count)]


FINDINGS = {
    "all in dictionary order": ({"names": sorted(PLAIN), "query_names": sorted(PLAIN)}, ["warning order: 10 11 2"]),
    "a file missing in the midst": (
        {"names": [name for name in NAMES if name != "020.png"], "query_names": NAMES[:59]},
        ["warning names: 38 59 021 022"],
    ),
    "references that begin at another file": ({"more": [[*NAMES[1:], NAMES[0]]]}, ["warning names: 60 60 001 000"]),
    "queries of every other place": ({"query_names": NAMES[:20], "right": [[2 * query] for query in range(20)]}, []),
    "names of another scheme": ({"query_names": [f"frame{number:03d}.png" for number in range(PLACES)]}, []),
    "a query without a right place, asked for": (
        {"right": places(PLACES, (4,)), "unmatched": "keep"},
        ["note ground truth: 1 60 1 98.3 004"],
    ),
    "no right place at all": ({"right": [[]] * PLACES}, ["error ground truth: 60 60 1 0.0 000 001 002 003 004 55"]),
    "most places right": ({"right": [range(45)] * PLACES}, ["warning ground truth: 75.0 60"]),
}


@pytest.mark.parametrize("lists", FINDINGS)
def test_the_cheap_checks_find_in_lists(lists, tmp_path):
    given, expected = FINDINGS[lists]
    assert coded(checked(**given), tmp_path) == expected


@pytest.mark.parametrize("names", [PLAIN, [f"{number:02d}.png" for number in range(12)], list("gadbhecf"), PLAIN[::-1]])
def test_other_orders_are_not_taken_for_dictionary_order(names):
    assert not [finding for finding in checked(names=names, query_names=names) if finding.check == "order"]


def compared(references, queries, right=None, tolerance=0):
    """Return what alignment says where query i shows place i, give or take the tolerance, or `right` if given."""
    n = len(references[0])
    around = [range(max(0, i - tolerance), min(n, i + tolerance + 1)) for i in range(len(queries))]
    return [finding for finding in examine(ride(references, queries, right or around)) if finding.check == "alignment"]


def noise(seed):
    return [*np.random.default_rng(seed).integers(0, 256, (PLACES, 32, 64, 3), np.uint8)]


@pytest.mark.parametrize(
    ("references", "queries", "tolerance", "told"),
    [
        (season(0), season(1), 0, "note .* are aligned: 60 of 60 queries"),
        *((season(0), noise(seed), 20 * (seed > 5), "note .*too different") for seed in (5, 8, 9, 10)),
        *(
            (season(0, 120)[first:95], season(1, 120)[: 95 - first], 0, f"error .*{told} earlier, by")
            for first, told in ((3, "3 places"), (25, "25 places"))
        ),
        *(
            (season(0, 120)[: 95 - first], season(1, 120)[first:95], 0, f"error .*{told} later, by")
            for first, told in ((1, "1 place"), (3, "3 places"))
        ),
        (season(0)[:58], season(1)[2:], 2, "note .*2 places later"),  # which the ground truth counts as right
    ],
)
def test_traverses_are_aligned_shifted_or_too_different_to_tell(references, queries, tolerance, told):
    (found,) = compared([references], queries, tolerance=tolerance)
    assert re.match(told, f"{found.level} {found.text}")


def test_a_part_that_is_shifted_is_named_with_its_ends_and_places_may_be_skipped_but_not_shuffled():
    references, queries = season(0, 400), season(1, 400)
    queries[100:130] = season(1, 400)[105:135]
    (found,) = compared([references], queries)
    assert found.level == "warning"
    assert "about image 100 to image 129 (30 of 400 queries) show what it shows 5 places later" in found.text
    right = [[place] for place in range(0, 300, 5)]
    (aligned,) = compared([season(0, 300)], season(1, 300)[::5], right)
    (shifted,) = compared([season(0, 300)], season(1, 300)[3::5], right)
    assert "are aligned" in aligned.text
    assert "3 places later" in shifted.text
    order = np.random.default_rng(0).permutation(PLACES)
    (unordered,) = compared([season(0)], [season(1)[place] for place in order], [[int(place)] for place in order])
    assert (unordered.level, unordered.text.startswith("not checked: ")) == ("note", True)


HEIGHT, WIDTH = 24, 32
SECOND = 1_000_000


def drive(seed):
    """Return the events of 60 seconds."""
    chance = np.random.default_rng(seed)
    t = np.sort(chance.integers(PLACES * SECOND, size=20_000))
    x, y = chance.integers(WIDTH, size=len(t)), chance.integers(HEIGHT, size=len(t))
    return Events(t, x.astype(np.uint16), y.astype(np.uint16), chance.random(len(t)) < 0.5)


def recorded(events, name="winter", unit=1, **changes):
    """Return a recording that comes in chunks, with a position each second."""
    metres = np.stack([10.0 * np.arange(PLACES), np.zeros(PLACES)], axis=1)
    middle = SECOND * np.arange(PLACES) + SECOND // 2

    def chunks():
        yield from (chosen(events, part) for part in np.array_split(np.arange(len(events.t)), 7))

    return replace(Recording(name, chunks, HEIGHT, WIDTH, middle // unit, metres, middle), **changes)


def chosen(events, which):
    return Events(events.t[which], events.x[which], events.y[which], events.p[which])


def swapped(events, back_us):
    t = events.t.copy()
    t[1000] = t[999] - back_us
    return recorded(replace(events, t=t))


def hot(events):
    often = np.arange(len(events.t)) % 10 == 0
    x, y = (np.where(often, at, column).astype(np.uint16) for at, column in ((7, events.x), (5, events.y)))
    return recorded(replace(events, x=x, y=y))


FOUND = {
    "nothing": (recorded, []),
    "time that runs backwards": (lambda events: swapped(events, 70_000), ["error time: 1 70,000"]),
    "a late packet": (lambda events: swapped(events, 7_000), ["note time: 1 7,000"]),
    "a gap": (lambda e: recorded(chosen(e, (e.t < 20 * SECOND) | (e.t > 22 * SECOND))), ["warning gaps: 1 2.0"]),
    "a hot pixel": (hot, ["warning hot pixels: 1 10."]),
    "polarity that is always the same": (
        lambda events: recorded(replace(events, p=np.ones_like(events.p))),
        ["warning polarity: 100.0 2"],
    ),
    "positions of another unit": (lambda events: recorded(events, unit=1000), ["error clocks: 0.0 0.1 0.0 60.0 0"]),
    "positions that are not in order": (
        lambda events: recorded(events, positions_us=np.zeros(PLACES, np.int64)),
        ["error clocks:"],
    ),
}


@pytest.mark.parametrize("damage", FOUND)
def test_the_doctor_finds_in_a_recording(damage, tmp_path):
    winter, summer = healthy(tmp_path)
    spoil, expected = FOUND[damage]
    recordings = spoil(drive(1)), recorded(drive(2), "summer")
    found = coded(examine(replace(dataset_of(winter, summer), recordings=recordings)), tmp_path)
    told = [code for code in found if not code.startswith("note alignment")]
    assert [code[: len(start)] for code, start in zip(told, expected, strict=True)] == expected
