"""Oxford RobotCar: the published lists, the places of the paper, and folders in which something is missing."""

import hashlib
import os

import pytest
from image_folders import answer, reds
from PIL import Image as PillowImage

from vprbench.datasets.oxford_robotcar import oxford_robotcar
from vprbench.datasets.oxford_robotcar.lists import RECORDINGS, published_timestamps
from vprbench.errors import BadInput, NotThere

TINY = {"places": 4, "first_query_place": 1, "query_places": 3}
TINY_STAMPS = {traverse: published_timestamps(traverse)[:28:7] for traverse in RECORDINGS}
LEVEL = {"sun": 10, "rain": 20, "dusk": 30}


def write_traverse(folder, traverse, mode="RGB"):
    """Four frames whose red level is that of their traverse plus their place."""
    folder.mkdir(parents=True)
    for place, stamp in enumerate(TINY_STAMPS[traverse]):
        level = LEVEL[traverse] + place
        PillowImage.new(mode, (3, 2), (level, 0, 0) if mode == "RGB" else level).save(folder / f"{stamp}.png")


@pytest.fixture(autouse=True)
def _no_downloads(tmp_path_factory, monkeypatch):
    monkeypatch.setenv("VPRBENCH_DATA", str(tmp_path_factory.mktemp("no-downloads")))


@pytest.fixture
def tiny_root(tmp_path):
    for traverse in RECORDINGS:
        write_traverse(tmp_path / traverse, traverse)
    return tmp_path


@pytest.fixture(scope="module")
def paper(tmp_path_factory):
    """The dataset of the paper over one frame that has all the names."""
    root = tmp_path_factory.mktemp("robotcar")
    PillowImage.new("RGB", (3, 2)).save(root / "frame.png")
    for traverse in RECORDINGS:
        (root / traverse).mkdir()
        for stamp in set(published_timestamps(traverse)[:3150:7]):
            os.link(root / "frame.png", root / traverse / f"{stamp}.png")
    return oxford_robotcar(root=str(root))


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


def test_the_queries_of_the_paper_are_places_90_to_449_and_nothing_else_is_right(paper):
    assert (paper.queries.names[0], paper.queries.names[-1]) == ("1416586236868041.png", "1416587169054477.png")
    assert [right.tolist() for right in paper.positives] == [[place] for place in range(90, 450)]
    assert (paper.n_places, paper.places.tolist()) == (450, [*range(450), *range(450)])


def test_the_protocol_says_everything_that_was_selected_and_what_is_odd_about_it(paper):
    # 445 and 448 of the 450 reference images are distinct, and all 360 queries; steps back of 450 places: 55 and 59.
    protocol = dict(paper.protocol)
    assert protocol.pop("repeated_images") == {"sun": 5, "rain": 2, "queries": 0}
    steps = protocol.pop("steps_back_in_time")
    assert (steps["sun"], steps["rain"]) == (55, 59)
    assert steps["queries"] <= 5
    assert protocol == {
        "protocol": "vprtempo",
        "image_list": "vprtempo",
        "references": ["sun", "rain"],
        "query": "dusk",
        "stride": 7,
        "places": 450,
        "query_places": 360,
        "first_query_place": 90,
        "reference_places": 450,
        "held_out_places": 90,
        "tolerance_places": 0,
        "also_tolerance_places": [1, 2, 3],
    }


def test_an_image_that_shows_two_places_is_read_for_both(tmp_path):
    # The published rain list names one image twice in a row.
    stamps = published_timestamps("rain")
    twice = next(row for row in range(len(stamps)) if stamps[row] == stamps[row + 1])
    (tmp_path / "rain").mkdir()
    for stamp in set(stamps[: twice + 2]):
        PillowImage.new("RGB", (1, 1)).save(tmp_path / "rain" / f"{stamp}.png")
    dataset = oxford_robotcar(
        root=str(tmp_path), references=["rain"], query="rain", stride=1, places=twice + 2, first_query_place=twice,
        query_places=2,
    )  # fmt: skip
    assert dataset.queries.names[0] == dataset.queries.names[1]
    assert [right.tolist() for right in dataset.positives] == [[twice], [twice + 1]]
    assert dataset.protocol["repeated_images"]["queries"] == 1


@pytest.mark.parametrize("name", ["oxford_robotcar", "mine"])
def test_without_a_root_the_download_is_taken_whatever_the_dataset_is_called(tiny_root, monkeypatch, name):
    (tiny_root / "oxford_robotcar").mkdir()
    for traverse in RECORDINGS:
        (tiny_root / traverse).rename(tiny_root / "oxford_robotcar" / traverse)
    monkeypatch.setenv("VPRBENCH_DATA", str(tiny_root))
    assert reds(oxford_robotcar(name, **TINY).queries) == [31, 32, 33]


@pytest.mark.parametrize("traverse", ["rain", "dusk"])
def test_raw_frames_among_processed_ones_are_refused_for_what_they_are(tiny_root, traverse):
    (tiny_root / traverse).rename(tiny_root / "aside")
    write_traverse(tiny_root / traverse, traverse, mode="L")
    message = answer(oxford_robotcar, root=str(tiny_root), **TINY)
    assert str(tiny_root / traverse) in message
    assert "raw Bayer frames" in message
    assert "<root>/<recording>/stereo/left" in message


def test_a_first_frame_that_is_no_image_is_named(tiny_root):
    broken = tiny_root / "sun" / f"{TINY_STAMPS['sun'][0]}.png"
    broken.write_bytes(b"")
    assert str(broken) in answer(oxford_robotcar, root=str(tiny_root), **TINY)


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
