"""Places of traverses, by rule or position, and frames of folders, in order or refused by name."""

import os
import re
from collections import namedtuple
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import example, given, settings
from hypothesis import strategies as st
from image_folders import answer, fill
from little import a_run, numbers_in, pictures
from stored_runs import answers

from vprbench.datasets.readers.image_files import images_in
from vprbench.datasets.readers.positions import by_names, by_radius, earth_centred, position_in
from vprbench.datasets.readers.traverses import Traverses, dataset_of, right_places, set_aside, split
from vprbench.errors import BadInput, NotThere
from vprbench.paper.plan import PlannedColumn
from vprbench.plugins import registry
from vprbench.tuning.places import cut, querying, searchable

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
    parts = split(*given)
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


@pytest.mark.parametrize(
    ("protocol", "asked", "told"),
    [
        ("sift", (3, 4, 0), "dataset.protocol=sift: choose vprtempo or vprsnn"),
        ("vprtempo", (4, 3, 0), "dataset.first_query_place=4 and dataset.query_places=3"),
        ("vprsnn", (4, 3, 0), "dataset.first_query_place=4 and dataset.query_places=3"),
        ("vprtempo", (-1, 3, 0), "dataset.first_query_place=-1"),
        ("vprsnn", (0, 0, 0), "dataset.query_places=0"),
        ("vprtempo", (0, 10**30, 0), f"dataset.query_places={10**30}"),
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


@pytest.mark.parametrize(
    ("protocol", "mapped", "queried", "held_out", "in_map"),
    [
        ("vprtempo", [*range(10)], [3, 5, 7], [0, 1, 2], True),
        ("vprsnn", [0, 2, 3, 4, 6, 7, 9], [0, 2, 3], [1, 5, 8], False),
    ],
)
def test_images_come_traverse_by_traverse_and_queries_have_their_place(protocol, mapped, queried, held_out, in_map):
    def frames(shown):
        return pictures([1000 * int(traverse) + place for traverse, place in shown])

    parts = split(protocol, 10, 3, 3, 1, 2 if in_map else 1)
    dataset = dataset_of("made", parts, Traverses(["4", "0"], "2", frames), {"kind": 1}, ["note"])
    assert numbers_in(dataset.references) == [1000 * traverse + place for traverse in (4, 0) for place in mapped]
    assert dataset.places.tolist() == [*range(len(mapped))] * 2
    assert numbers_in(dataset.queries) == [2000 + place for place in queried]
    right = [[i for i, place in enumerate(mapped) if abs(place - query) <= 1] for query in queried]
    assert [found.tolist() for found in dataset.positives] == right
    assert (dataset.name, dict(dataset.protocol), dataset.notes) == ("made", {"kind": 1}, ("note",))
    assert (dataset.place_numbers is None) if in_map else dataset.place_numbers.tolist() == mapped
    aside = dataset.held_out
    assert numbers_in(aside.references) == [1000 * traverse + place for traverse in (4, 0) for place in held_out]
    assert numbers_in(aside.queries) == [2000 + place for place in held_out]
    assert (aside.right.tolist(), aside.places.tolist(), aside.in_map) == ([0, 1, 2], [0, 1, 2] * 2, in_map)
    whole = split(protocol, 10, 0, 3, 1, 1)
    assert dataset_of("made", whole, Traverses(["4"], "2", frames), {}, []).held_out is None


EASTING, NORTHING = 54_325_696, 417_890_670  # centimetres, a corner of San Francisco
AROUND = st.tuples(st.integers(-6000, 6000), st.integers(-6000, 6000))
EDGE = st.sampled_from([(700, 2400), (-1500, 2000), (2500, 0), (2400, 701), (2401, 700), (0, 2501)])  # 7-24-25


def named(centimetres, grid="@10@S"):
    east, north = centimetres
    return Path(f"@{(EASTING + east) / 100:.2f}@{(NORTHING + north) / 100:.2f}{grid}@.jpg")


@settings(derandomize=True, deadline=None, database=None, max_examples=60)
@given(st.lists(st.tuples(AROUND | EDGE, st.integers(31, 32)), min_size=1, max_size=20), st.integers(31, 33))
@example([((700, 2400), 31), ((701, 2400), 31), ((0, 0), 32)], 31)
def test_right_is_what_whole_centimetres_say_is_within_25_metres_the_edge_included_and_in_the_zone(references, zone):
    files = [named(at, f"@{own}@V") for at, own in references]
    truth = by_names(files, [named((0, 0), f"@{zone}@V")], 25.0, "apart")
    near = [i for i, ((x, y), own) in enumerate(references) if x * x + y * y <= 2500**2 and own == zone]
    assert truth.positives[0].tolist() == near
    assert truth.places.tolist() == [*range(len(references))]


@pytest.mark.parametrize(
    ("first", "second", "zones", "told"),
    [
        ("@10@S", "@10@t", "error", ""),
        ("@10@S", "@33@U", "error", "10 north.*33 north"),
        ("@23@M", "@23@N", "error", "23 south.*23 north"),
        ("@10@S", "", "error", ""),
        ("@10@S", "@61@S", "error", ""),
        ("@10@S", "@60@S", "error", "10 north.*60 north"),
        ("@10@S", "", "apart", "10 north.*no zone"),
    ],
)
def test_metres_of_several_zones_or_sides_of_the_equator_do_not_compare(first, second, zones, told):
    names = [named((0, 0), first)], [named((0, 0), second)]
    if told:
        assert re.search(told, answer(by_names, *names, 25.0, zones))
    else:
        assert len(by_names(*names, 25.0, zones).positives[0]) == 1


def test_a_position_may_be_negative_and_zone_and_letter_may_be_left_out():
    assert position_in(Path("a@b/@-0012.50@0000003.25@@@@@.jpg")) == (-12.5, 3.25, "")
    assert "a@b/1.jpg" in answer(position_in, Path("a@b/1.jpg"))


@pytest.mark.parametrize("radius", [0, float("nan"), 1.01e8])
def test_a_radius_that_is_no_length_is_refused(radius):
    with pytest.raises(BadInput, match=r"dataset\.radius_metres="):
        by_radius(np.zeros((1, 2)), np.zeros((1, 2)), radius)


# Lengths of one degree on the WGS 84 ellipsoid as the tables of the US National Geospatial-Intelligence Agency have
# them (whole metres); a thousandth of a degree, so that chord and arc do not differ.
@pytest.mark.parametrize(
    ("latitude", "north", "east"), [(0, 110.574, 111.320), (60, 111.412, 55.800), (-30, 110.852, 96.486)]
)
def test_a_thousandth_of_a_degree_is_as_long_as_the_tables_say(latitude, north, east):
    points = earth_centred(np.array([latitude, latitude + 1e-3, latitude]), np.array([10.0, 10.0, 10.001]))
    lengths = np.linalg.norm(points[1:] - points[0], axis=1)
    assert lengths == pytest.approx([north, east], rel=1e-4)


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
    (top / "again").symlink_to(tmp_path / "a")
    (top / "0.png").symlink_to(tmp_path / "gone.png")
    assert names_in(top) == ("0.png", "1.png", "5.png")
    top, listed = fill(tmp_path / "e", ["1.png", "closed/2.png"]), os.scandir

    def scandir(folder):
        if Path(folder).name == "closed":
            raise PermissionError(13, "Permission denied", str(folder))
        return listed(folder)

    monkeypatch.setattr(os, "scandir", scandir)
    assert f"{top / 'closed'} cannot be read (Permission denied)" in answer(names_in, top, kind=NotThere)


@pytest.mark.parametrize("kind", ["2.heic", "2.png~", "2", "a folder", "a pipe", "a linked folder"])
def test_what_may_be_a_frame_and_cannot_be_read_is_refused_by_name(tmp_path, kind):
    top = fill(tmp_path / "a", ["1.png", "3.png"])
    stranger = top / (kind if kind.startswith("2") else "2.png")
    if kind == "a folder":
        fill(tmp_path / "a/2.png", ["2.png"])
    elif kind == "a linked folder":
        stranger.symlink_to(fill(tmp_path / "b", ["2.png"]))
    elif kind == "a pipe":
        os.mkfifo(stranger)
    else:
        stranger.touch()
    for deep in (True, False):
        assert answer(names_in, top, deep=deep).startswith(f"dataset.queries: {stranger} is ")


def config(name):
    return dict(yaml.safe_load(registry.entries("dataset")[name].path.read_text(encoding="utf-8")))


def test_nothing_is_searched_under_a_protocol_or_beside_a_column_that_scatters_its_held_out_places():
    with pytest.raises(BadInput, match=r"dataset\.protocol=vprsnn: a search needs places in a row"):
        searchable("nordland", {**config("nordland"), "protocol": "vprsnn"}, 20, [])
    nordland, rendered = (
        PlannedColumn("a column", "A column", (f"dataset={name}", "dataset.protocol=vprsnn"))
        for name in ("nordland", "synthetic")
    )
    with pytest.raises(BadInput, match="reported results query all of its 3300 places"):
        searchable("nordland", config("nordland"), 100, [nordland])
    assert searchable("synthetic", config("synthetic"), 20, [rendered]).searched == range(20)
    whole = registry.make_dataset({**config("synthetic"), "places": 12})
    assert whole.held_out is not None
    assert cut(whole, range(2, 8)).held_out is None


@pytest.mark.parametrize(("protocol", "named"), [("vprtempo", False), ("vprsnn", True)])
def test_a_stored_run_whose_queries_are_scattered_may_query_any_place(protocol, named):
    stored = a_run(
        dataset="nordland",
        config={**a_run().config, "dataset": {**config("nordland"), "protocol": protocol}},
        positives=tuple(np.array([place]) for place in (700, 701)),
        outcome=answers([1, 1]),
    )
    found = querying([stored], searchable("nordland", config("nordland"), 500, []))
    assert found == [f"nordland/little-{stored.key}"] * named
