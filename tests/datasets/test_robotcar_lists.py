"""RobotCar's published lists: their places, the images that they repeat, and other lists refused by name."""

import hashlib
import os
import re

import numpy as np
import pytest
import yaml
from image_folders import answer, rights
from PIL import Image as PillowImage

from vprbench.datasets.oxford_robotcar import oxford_robotcar
from vprbench.datasets.oxford_robotcar.lists import RECORDINGS, published_timestamps, vprsnn_timestamps
from vprbench.datasets.oxford_robotcar.repeats import ceiling, remarks, sharing, steps_back
from vprbench.errors import BadInput, NotThere
from vprbench.plugins import registry

PUBLISHED = {traverse: published_timestamps(traverse)[:3150:7] for traverse in RECORDINGS}
DIAGONAL = tuple(np.array([place]) for place in range(450))


@pytest.fixture(autouse=True)
def _no_downloads(tmp_path, monkeypatch):
    monkeypatch.setenv("VPRBENCH_DATA", str(tmp_path / "downloads"))


def one_frame_under(root, stamps):
    """Put one processed frame under all the names of every traverse."""
    for traverse, listed in stamps.items():
        (root / traverse).mkdir(parents=True)
        PillowImage.new("RGB", (3, 2)).save(root / traverse / "frame.png")
        for stamp in {*listed}:
            os.link(root / traverse / "frame.png", root / traverse / f"{stamp}.png")
    return root


# VPRTempo's list


@pytest.mark.parametrize(
    ("traverse", "digest"),
    [
        # sha256 of the whole original files, header and row numbers included; QVPR/VPRTempo 64154e5, orc-*.csv.
        ("sun", "3ac989cf3ccb4065b5ad71e8410a25db50791160473e30ec75b0cc7f7d5a86ee"),
        ("rain", "000c064fec256cd4ecd0eea769f1c9b318f7ff00b3dc759a070ffd52c2a90338"),
        ("dusk", "0740768981b3065bb6e74b01a80845d6f09ea3f90d2c3152fcabb8bd4c27f019"),
    ],
)
def test_the_lists_are_those_that_were_published(traverse, digest):
    rows = [f"{stamp}.png,{row}" for row, stamp in enumerate(published_timestamps(traverse))]
    original = "".join(f"{line}\n" for line in ["Image name,index", *rows])
    assert hashlib.sha256(original.encode()).hexdigest() == digest


def test_the_queries_of_the_paper_are_places_90_to_449_and_the_protocol_says_what_is_odd_about_the_list(tmp_path):
    # 445 and 448 of the 450 reference images are distinct, and all 360 queries; steps back of 450 places: 55 and 59.
    paper = oxford_robotcar(root=str(one_frame_under(tmp_path, PUBLISHED)))
    assert (paper.queries.names[0], paper.queries.names[-1]) == ("1416586236868041.png", "1416587169054477.png")
    assert rights(paper) == [[place] for place in range(90, 450)]
    assert (paper.n_places, paper.places.tolist()) == (450, [*range(450), *range(450)])
    assert dict(paper.protocol) == {
        **{"protocol": "vprtempo", "image_list": "vprtempo", "references": ["sun", "rain"], "query": "dusk"},
        **{"stride": 7, "places": 450, "query_places": 360, "first_query_place": 90, "reference_places": 450},
        **{"held_out_places": 90, "tolerance_places": 0, "also_tolerance_places": [1, 2, 3]},
        "repeated_images": {"sun": 5, "rain": 2, "queries": 0},
        "steps_back_in_time": {"sun": 55, "rain": 59, "queries": 4},
    }


def test_an_image_that_shows_two_places_is_read_for_both(tmp_path):
    # The published rain list names one image twice in a row.
    stamps = published_timestamps("rain")
    twice = next(row for row in range(len(stamps)) if stamps[row] == stamps[row + 1])
    one_frame_under(tmp_path, {"rain": stamps[: twice + 2]})
    two = {"references": ["rain"], "query": "rain", "query_places": 2}
    dataset = oxford_robotcar(root=str(tmp_path), stride=1, places=twice + 2, first_query_place=twice, **two)
    assert dataset.queries.names[0] == dataset.queries.names[1]
    assert rights(dataset) == [[twice], [twice + 1]]
    assert dataset.protocol["repeated_images"]["queries"] == 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({}, "https://mrgdatashare.robots.ox.ac.uk/register/"),
        ({"query": "night"}, "dataset.query=night: Oxford RobotCar has sun, rain, dusk"),
        ({"references": []}, "dataset.references=[]: name at least one traverse"),
        ({"places": 483}, "dataset.places=483: the list of 3369 names at stride 7 has 482 places"),
        ({"first_query_place": 91}, "dataset.first_query_place=91 and dataset.query_places=360"),
    ],
)
def test_a_bad_option_is_named_in_one_line(arguments, message):
    assert message in answer(oxford_robotcar, kind=BadInput if arguments else NotThere, **arguments)


# VPRSNN's list


START = {"sun": 1439388276045321, "rain": 1446121117630140, "dusk": 1416586027583964}


def stamps(traverse):
    """The timestamps of a made-up list: a row repeats the one before it now and then, but none of every eighth."""
    return [START[traverse] + 1000 * (row - (row % 8 == 3)) for row in range(3876)]


def write_list(folder, traverse, lines):
    folder.mkdir(parents=True, exist_ok=True)
    text = "".join(f"{line}\n" for line in lines)
    (folder / f"ORC_{traverse.capitalize()}_timestamps.csv").write_text(text, errors="surrogateescape")


def column(line, traverse="sun"):
    """Lines of the same stamps in other words."""
    return [line.format(row=row, stamp=stamp) for row, stamp in enumerate(stamps(traverse))]


NAMED, PLAIN = column("{row:06d}.png,{stamp}.png"), column("{stamp}.png")


@pytest.mark.parametrize(
    "lines",
    [
        ["Image from this repo,Image from ORC", *NAMED],
        column("{stamp}"),
        ["", "stamp", *column(" {stamp}.png "), ""],
        ["a,b,c", *column('{row},"{stamp}",x')],
        ["\ufeffname,index", *column("{stamp}.png,{row}")],
    ],
    ids=["as published", "no head", "blanks", "quoted", "byte order mark"],
)
def test_the_column_of_timestamps_is_found_whatever_stands_beside_and_above_it(tmp_path, lines):
    write_list(tmp_path, "sun", lines)
    assert vprsnn_timestamps(tmp_path, "sun") == stamps("sun")


@pytest.mark.parametrize(
    ("lines", "told"),
    [
        (["head", *PLAIN[:3875]], "lists 3875 images; VPRSNN's list has 3876"),
        (["head"], "lists 0 images"),
        ([*PLAIN[:16], PLAIN[8], *PLAIN[17:]], "every 8th row names 449 distinct images among the first 450"),
        ([*NAMED[:7], "000007.png,no stamp", *NAMED[8:]], "line 8: 000007.png,no stamp names"),
        ([*NAMED[:7], "000007.png", *NAMED[8:]], "line 8: 000007.png names"),
        ([*NAMED[:7], "000007.png,143938827604532.png", *NAMED[8:]], "line 8: "),
        (["\0\udcff"], "cannot be read as a list"),
        ([], "does not exist"),
    ],
    ids=["too short", "empty", "a repeat", "no stamp", "a cell", "a short stamp", "no text", "missing"],
)
def test_another_list_is_refused_with_where_to_get_the_right_one(tmp_path, lines, told):
    if lines:
        write_list(tmp_path, "sun", lines)
    message = answer(vprsnn_timestamps, tmp_path, "sun", kind=BadInput if lines else NotThere)
    assert f"{tmp_path / 'ORC_Sun_timestamps.csv'}" in message
    assert told in message
    assert "https://github.com/QVPR/VPRSNN" in message


def test_the_places_are_every_eighth_row_without_those_set_aside_and_lists_may_lie_outside_of_the_root(tmp_path):
    root = one_frame_under(tmp_path / "robotcar", {traverse: stamps(traverse)[:3600:8] for traverse in RECORDINGS})
    for traverse in RECORDINGS:
        write_list(root / "lists", traverse, column("{row},{stamp}.png", traverse))
    config = yaml.safe_load(registry.entries("dataset")["oxford_robotcar_vprsnn"].path.read_text("utf-8"))

    def asked(**arguments):
        return registry.make_dataset({**config, "root": str(root), **arguments})

    dataset = asked()
    aside = set(np.random.RandomState(42).permutation(450)[:75].tolist())
    wanted = [f"{stamps('dusk')[8 * place]}.png" for place in range(450) if place not in aside]
    assert list(dataset.queries.names) == wanted
    assert (len(dataset.queries), dataset.n_places, len(dataset.references)) == (375, 375, 750)
    assert rights(dataset) == [[place] for place in range(375)]
    assert (dataset.protocol["protocol"], dataset.protocol["image_list"]) == ("vprsnn", "vprsnn")
    assert (dataset.protocol["held_out_places"], dataset.protocol["also_tolerance_places"]) == (75, [1, 2, 3])
    download = tmp_path / "downloads" / "oxford_robotcar" / "lists"
    download.parent.mkdir(parents=True)
    (root / "lists").rename(download)
    assert len(asked().queries) == 375
    named = download.rename(tmp_path / "named")
    assert len(asked(lists=str(named)).queries) == 375
    message = answer(asked, kind=NotThere)
    assert "dataset.lists" in message
    assert f"https://github.com/QVPR/VPRSNN to {root}" in message


# Images that a list names for several places


@pytest.mark.parametrize(
    ("references", "queries", "right", "best"),
    [
        ("abc", "xyz", [[0], [1], [2]], 1.0),
        ("abb", "xy", [[0], [1]], 0.75),  # a tie of two for y
        ("ab", "xx", [[0], [1]], 0.5),  # x has one answer
        ("abb", "xxx", [[0], [1], [1, 2]], 0.5),  # b is right for half of one and all of another, a for one
        ("aab", "xyy", [[0, 2], [], [0, 1]], 2 / 3),  # two lack nothing, one has no right place
    ],
)
def test_the_ceiling_is_reached_by_the_best_group_of_places_for_each_image(references, queries, right, best):
    assert ceiling(references, queries, right) == pytest.approx(best)


def test_repeats_and_steps_back_are_those_that_the_description_of_the_list_counts():
    assert {traverse: steps_back(stamps) for traverse, stamps in PUBLISHED.items()} == {
        "sun": 55,
        "rain": 59,
        "dusk": 5,
    }
    assert steps_back([3, 3, 2, 5]) == 1
    # 445, 448 and 449 distinct images of 450, and none stands at more than two places.
    assert {traverse: sharing(stamps) for traverse, stamps in PUBLISHED.items()} == {"sun": 10, "rain": 4, "dusk": 2}
    maps = {traverse: PUBLISHED[traverse] for traverse in ("sun", "rain")}
    images, steps = remarks(maps, PUBLISHED["dusk"][90:], DIAGONAL[90:], 0)
    assert re.findall(r"[\d.]+", images) == ["10", "450", "4", "450", "0", "360", "1", "0", "99.72"]  # 359 of 360
    assert re.findall(r"[\d.]+", steps) == ["55", "449", "59", "449", "4", "359"]
