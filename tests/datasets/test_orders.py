"""Which frame is the i-th, where one drive ends and the next begins, and which traverses match by their order."""

from pathlib import Path

import numpy as np
import pytest
from image_folders import fill, lists, reds, rights

import vprbench
from vprbench.api import BadInput
from vprbench.data.doctor import quick

DECIMAL = {  # names in the order of the road, of which the order of whole numbers is another one
    "times": ["1418132416.1", "1418132416.15", "1418132416.2", "1418132417.0", "1418132417.05", "1418132417.5"],
    "words before": ["t0.25", "t0.5", "t0.625", "t1.0", "t10.5"],
    "ISO": ["2014-12-09T13:21:02.125", "2014-12-09T13:21:02.25", "2014-12-09T13:21:02.5", "2014-12-09T13:21:03.75"],
    "negative": ["x-1.5_y2", "x-1_y2", "x-0.25_y2", "x0.5_y2", "x2_y2"],
    "whole and negative": ["-10", "-2", "-1", "0", "3", "12"],
    "exponents": ["1e-05", "2.5e-05", "0.0001", "0.25", "3.0", "1e+16"],
}
WHOLE = {  # names in the order of whole numbers, and how often that there is another one is said
    "counters": (["take1.8", "take1.9", "take1.10", "take1.11", "take2.1"], 1),
    "two patterns": (["left_0.5", "left_0.25", "right_0.5"], 1),
    "dates": (["2014.12.9", "2014.12.10"], 0),
    "dashes": (["frame-1", "frame-2", "frame-10"], 0),
    "equal lengths": (["t0.05", "t0.10", "t0.15"], 0),
}


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def named(names):
    return [f"{name}.png" for name in names]


def pair(names, query_names):
    """Return the options of two folders of one road, whose frames show the places 0, 1, 2 ... in the order given."""
    return {"references": [fill(Path("a"), named(names))], "queries": fill(Path("b"), named(query_names))}


def made(options, **given):
    """Yield the dataset of the same folders as the command line's reader and as Python's own function make it."""
    yield vprbench.dataset("folders", **options, **given).build()
    yield vprbench.dataset_of(**options, **given)


def stems(images):
    return [name.removesuffix(".png") for name in images.names]


@pytest.mark.parametrize("kind", DECIMAL)
def test_names_with_fractions_signs_and_exponents_stand_in_the_order_of_their_numbers(kind):
    names = DECIMAL[kind]
    options = pair(names, [f"{number:03}" for number in range(len(names))])
    for dataset in made(options):
        assert stems(dataset.references) == names
        assert reds(dataset.references) == reds(dataset.queries) == [*range(len(names))]
        assert rights(dataset) == [[number] for number in range(len(names))]
        assert (dataset.protocol["numbers"], len(dataset.notes)) == ("decimal", 1)
        assert not [one for one in quick(dataset) if one.level != "note"]
    for dataset in made(options, numbers="whole"):
        assert stems(dataset.references) != names
        assert ("numbers" in dataset.protocol, len(dataset.notes)) == (False, 1)


@pytest.mark.parametrize("kind", WHOLE)
def test_counters_dates_dashes_and_names_of_two_patterns_keep_the_order_of_whole_numbers(kind):
    names, said = WHOLE[kind]
    for dataset in made(pair(names, names)):
        assert stems(dataset.references) == stems(dataset.queries) == names
        assert ("numbers" in dataset.protocol, len(dataset.notes)) == (False, said)


def test_traverses_whose_names_would_be_read_in_different_ways_are_refused_unless_one_way_is_chosen():
    options = pair(["t1.8", "t1.9", "t1.10"], ["t0.25", "t0.5", "t0.625"])
    for make in (vprbench.dataset("folders", **options).build, lambda: vprbench.dataset_of(**options)):
        with pytest.raises(BadInput, match=r"numbers=auto.*t0\.25.* before t0\.5.*t1\.8.* before t1\.10"):
            make()
    for dataset in made(options, numbers="decimal"):
        assert stems(dataset.references) == ["t1.10", "t1.8", "t1.9"]


def test_vpr_bench_numbers_its_frames_by_whole_numbers_as_published_and_says_so():
    fill(Path("query"), ["0.5.png", "0.25.png"])
    fill(Path("ref"), ["0.5.png", "0.25.png"])
    np.save("ground_truth_new.npy", lists([0], [1]), allow_pickle=True)
    whole, decimal = (vprbench.dataset("vpr_bench", root=".", **way).build() for way in ({}, {"numbers": "decimal"}))
    assert (stems(whole.queries), "numbers" in whole.protocol, len(whole.notes)) == (["0.5", "0.25"], False, 1)
    assert (stems(decimal.queries), decimal.protocol["numbers"]) == (["0.25", "0.5"], "decimal")


def drives(*lengths):
    """Return the names of frames in a sub-folder for each drive."""
    return [f"drive{number}/{frame}" for number, length in enumerate(lengths) for frame in range(length)]


def test_another_sub_folder_begins_another_drive_at_which_tolerance_and_sequences_end():
    options = pair(drives(6, 5, 7), drives(6, 5, 7))
    for dataset in made(options, tolerance=1):
        assert (dataset.query_breaks.tolist(), dataset.place_breaks.tolist()) == ([6, 11], [6, 11])
        assert rights(dataset)[5:7] + rights(dataset)[10:12] == [[4, 5], [6, 7], [9, 10], [11, 12]]
        assert dataset.protocol["breaks"] == "folders"
    for dataset in made(options, tolerance=1, breaks="none"):
        assert (len(dataset.query_breaks), len(dataset.place_breaks), rights(dataset)[5]) == (0, 0, [4, 5, 6])
        assert "breaks" not in dataset.protocol


EASTS = [0, 5, 10, 15, 900, 905, 910]
ALONE = [f"{number}/frame" for number in range(6)]


@pytest.mark.parametrize(
    ("names", "query_names", "places", "queries", "seen_by"),
    [
        ([f"@{east}@0@" for east in EASTS], [f"@{east}@1@" for east in (0, 5, 10, 900)], [4], [3], "positions"),
        (ALONE, ALONE, [], [], None),  # a folder for every frame
    ],
)
def test_a_journey_breaks_off_where_the_folder_changes_or_the_position_jumps(
    names, query_names, places, queries, seen_by
):
    truth = "utm" if seen_by else "index"
    dataset = vprbench.dataset("folders", **pair(names, query_names), ground_truth=truth).build()
    found = [breaks.tolist() for breaks in (dataset.place_breaks, dataset.query_breaks)]
    assert (*found, dataset.protocol.get("breaks")) == (places, queries, seen_by)
    said = [one.text for one in quick(dataset) if one.check == "drives"]
    assert len(said) == bool(places) + bool(queries)


@pytest.mark.parametrize(
    ("names", "query_names", "told"),
    [
        (drives(60), [str(number) for number in range(30)], ("60", "30")),
        (
            [f"s{number}" for number in range(6)],
            [*(f"s{n}" for n in (0, 1, 4, 5)), "right/s2", "right/s3"],
            ("6", "2+4"),
        ),
        (drives(4, 2), drives(3, 3), ("4+2", "3+3")),
    ],
    ids=["every second place", "a folder in one traverse only", "drives of other lengths"],
)
def test_folders_that_cannot_match_by_order_are_refused_with_the_ways_out(names, query_names, told):
    options = pair(names, query_names)
    with pytest.raises(BadInput) as error:
        vprbench.dataset("folders", **options).build()
    wanted = (*told, "ground_truth=utm", "ground_truth=FILE.npz", "dataset=image_list")
    assert [word in str(error.value) for word in wanted] == [True] * len(wanted)
    with pytest.raises(BadInput, match=r"positives=.*image_list"):
        vprbench.dataset_of(**options)
    if len(names) == len(query_names):
        assert [rights(dataset)[3] for dataset in made(options, breaks="none")] == [[3], [3]]
    right = np.zeros((len(query_names), len(names)), bool)
    right[:, 0] = True
    np.savez("truth.npz", positives=right)
    assert rights(vprbench.dataset("folders", **options, ground_truth="truth.npz").build())[-1] == [0]
    assert rights(vprbench.dataset_of(**options, positives=right))[-1] == [0]
