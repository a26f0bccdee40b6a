"""Places of traverses, by rule or position, and frames of folders, in order or refused by name."""

import os
import re
from collections import namedtuple
from pathlib import Path

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from image_folders import answer, fill

from vprbench.datasets.readers.image_files import images_in
from vprbench.datasets.readers.traverses import match_numbers, split_places
from vprbench.datasets.readers.utm_names import match_names
from vprbench.errors import MissingData

quickly = settings(derandomize=True, deadline=None, max_examples=60, database=None)


Asked = namedtuple("Asked", "protocol places first_query_place query_places tolerance query_stride")


@st.composite
def asked(draw):
    protocol = draw(st.sampled_from(["vprtempo", "vprsnn"]))
    places = draw(st.integers(1, 60))
    first = draw(st.integers(0, places - 1))
    stride = 1 if protocol == "vprsnn" else draw(st.one_of(st.integers(1, 12), st.just(10**30)))
    queries = draw(st.integers(1, len(range(first, places, stride))))
    tolerance = draw(st.one_of(st.integers(0, places + 2), st.sampled_from([2**63 - 1, 10**30])))
    return Asked(protocol, places, first, queries, tolerance, stride)


@quickly
@given(asked())
def test_places_stay_in_order_queries_lie_in_the_map_and_right_is_what_lies_within_the_tolerance(given):
    parts = split_places(*given)
    mapped, queried, held_out = parts.mapped.tolist(), parts.queried.tolist(), parts.held_out.tolist()
    assert all(numbers == sorted({*numbers}) for numbers in (mapped, queried, held_out))
    assert (len(queried), len(held_out)) == (given.query_places, given.first_query_place)
    assert sorted({*mapped, *held_out}) == [*range(given.places)]
    assert ({*held_out} <= {*mapped}) if given.protocol == "vprtempo" else not {*held_out} & {*mapped}
    allowed = [place for place in mapped if place not in {*held_out}]
    assert queried == allowed[:: given.query_stride][: given.query_places]
    found = match_numbers(parts.queried, parts.mapped, given.tolerance)
    for query, right in zip(queried, found, strict=True):
        assert right.tolist() == [i for i, place in enumerate(mapped) if abs(place - query) <= given.tolerance]


@pytest.mark.parametrize(
    ("protocol", "asked", "told"),
    [
        ("vprsnn", (4, 3, 0), "dataset.first_query_place=4 and dataset.query_places=3"),
        ("vprtempo", (-1, 3, 0), "dataset.first_query_place=-1"),
        ("vprsnn", (0, 0, 0), "dataset.query_places=0"),
        ("vprtempo", (0, 10**30, 0), f"dataset.query_places={10**30}"),
        ("vprtempo", (1, 3, 0, 3), " need 8 places, and there are 6"),
        ("vprtempo", (1, 3, 0, 0), "dataset.query_stride=0 with"),
        ("vprsnn", (2, 1, 0, 4), "dataset.query_stride=4 with dataset.protocol=vprsnn"),
    ],
)
def test_a_split_that_does_not_fit_six_places_is_refused_with_its_options(protocol, asked, told):
    assert told in answer(split_places, protocol, 6, *asked)


EASTING, NORTHING = 54_325_696, 417_890_670  # centimetres, a corner of San Francisco
AROUND = st.tuples(st.integers(-6000, 6000), st.integers(-6000, 6000))
EDGE = st.sampled_from([(700, 2400), (-1500, 2000), (2500, 0), (2400, 701), (2401, 700), (0, 2501)])  # 7-24-25


def name_file(centimetres, zone="@10@S"):
    east, north = centimetres
    return Path(f"@{(EASTING + east) / 100:.2f}@{(NORTHING + north) / 100:.2f}{zone}@.jpg")


@settings(derandomize=True, deadline=None, database=None, max_examples=60)
@given(st.lists(st.tuples(AROUND | EDGE, st.integers(31, 32)), min_size=1, max_size=20), st.integers(31, 33))
@example([((700, 2400), 31), ((701, 2400), 31), ((0, 0), 32)], 31)
def test_right_is_what_whole_centimetres_say_is_within_25_metres_the_edge_included_and_in_the_zone(references, zone):
    files = [name_file(at, f"@{own}@V") for at, own in references]
    truth = match_names(files, [name_file((0, 0), f"@{zone}@V")], 25.0, "apart")
    near = [i for i, ((x, y), own) in enumerate(references) if x * x + y * y <= 2500**2 and own == zone]
    assert truth.positives[0].tolist() == near
    assert truth.places.tolist() == [*range(len(references))]


@pytest.mark.parametrize(
    ("first", "second", "zones", "told"),
    [
        ("@10@S", "@10@t", "error", ""),
        ("@23@M", "@23@N", "error", "23 south.*23 north"),
        ("@10@S", "", "error", ""),
        ("@10@S", "@61@S", "error", ""),
        ("@10@S", "@60@S", "error", "10 north.*60 north"),
        ("@10@S", "", "apart", "no UTM zone"),
    ],
)
def test_metres_of_several_zones_or_sides_of_the_equator_do_not_compare(first, second, zones, told):
    names = [name_file((0, 0), first)], [name_file((0, 0), second)]
    if told:
        assert re.search(told, answer(match_names, *names, 25.0, zones))
    else:
        assert len(match_names(*names, 25.0, zones).positives[0]) == 1


def names_in(folder, **options):
    return images_in(folder, "dataset.queries", "", **options).names


def test_sub_folders_are_included_in_natural_order_and_what_is_no_image_left_out(tmp_path):
    names = ["run10/10.png", "run10/9.png", "run2/7.png", "run2/deep/3.png", ".thumbnails/2.png", "5.png"]
    assert names_in(fill(tmp_path / "a", names)) == ("5.png", "7.png", "3.png", "9.png", "10.png")
    assert names_in(fill(tmp_path / "a", names), order="plain") == ("5.png", "10.png", "9.png", "7.png", "3.png")
    assert names_in(fill(tmp_path / "a", names), deep=False) == ("5.png",)
    assert names_in(fill(tmp_path / "b", ["1.png", "01.png", "001.png"])) == ("001.png", "01.png", "1.png")
    beside = ["poses.txt", "GT.npz", "ground_truth.csv", "1.json", "README", "Thumbs.db", "._1.png", "@eaDir/1.jpg"]
    images = ("1.png", "2.JPG", "3.jpe", "4.pnm")
    assert names_in(fill(tmp_path / "d", [*images, *beside])) == images


def test_a_folder_that_cannot_be_read_is_refused_and_linked_ones_are_included(tmp_path, monkeypatch):
    twice = fill(tmp_path / "c", ["1.png", "inner/2.png"])
    (twice / "link").symlink_to(twice / "inner")
    assert str(twice / "link") in answer(names_in, twice)
    top = fill(tmp_path / "a", ["1.png"])
    (top / "2").symlink_to(fill(tmp_path / "elsewhere", ["5.png"]))
    (top / "0.png").symlink_to(tmp_path / "gone.png")
    assert names_in(top) == ("0.png", "1.png", "5.png")
    top, listed = fill(tmp_path / "e", ["1.png", "closed/2.png"]), os.scandir

    def scandir(folder):
        if Path(folder).name == "closed":
            raise PermissionError(13, "Permission denied", str(folder))
        return listed(folder)

    monkeypatch.setattr(os, "scandir", scandir)
    assert f"{top / 'closed'} cannot be read (Permission denied)" in answer(names_in, top, kind=MissingData)


@pytest.mark.parametrize("kind", ["2.heic", "2.png~", "2", "a folder", "a linked folder"])
def test_what_may_be_a_frame_and_cannot_be_read_is_refused_by_name(tmp_path, kind):
    top = fill(tmp_path / "a", ["1.png", "3.png"])
    stranger = top / (kind if kind.startswith("2") else "2.png")
    if kind == "a folder":
        fill(tmp_path / "a/2.png", ["2.png"])
    elif kind == "a linked folder":
        stranger.symlink_to(fill(tmp_path / "b", ["2.png"]))
    else:
        stranger.touch()
    for deep in (True, False):
        assert answer(names_in, top, deep=deep).startswith(f"dataset.queries: {stranger} is no image file")
