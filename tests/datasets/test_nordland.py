"""Nordland: the places of the paper, what may be asked of it, and folders in which something is missing."""

from functools import partial

import pytest
from image_folders import answer, needs_real_frames, reds
from PIL import Image as PillowImage

from vprbench.datasets.nordland import nordland
from vprbench.errors import NotThere

TINY = {"stride": 2, "places": 6, "query_places": 4, "first_query_place": 2}
TINY_FRAMES = (202, 204, 206, 208, 210, 212)  # the list begins with 202, 203, 204 and so on
refusal = partial(answer, nordland)
SEASON_LEVEL = {"spring": 10, "summer": 20, "fall": 30, "winter": 40}


@pytest.fixture(autouse=True)
def no_downloads(tmp_path_factory, monkeypatch):
    """Where downloads lie: nothing is there yet, whatever lies beside the checkout."""
    folder = tmp_path_factory.mktemp("downloads")
    monkeypatch.setenv("VPRBENCH_DATA", str(folder))
    return folder


@pytest.fixture
def tiny_root(tmp_path):
    """Four seasons of six places; the red level of a frame is that of its season plus its place."""
    for season, level in SEASON_LEVEL.items():
        (tmp_path / season).mkdir()
        for place, frame in enumerate(TINY_FRAMES):
            PillowImage.new("RGB", (3, 2), (level + place, 0, 0)).save(tmp_path / season / f"images-{frame:05d}.png")
    return tmp_path


def test_two_seasons_are_two_traverses_in_the_order_asked_for(tiny_root):
    dataset = nordland(root=str(tiny_root), references=["winter", "spring"], **TINY)
    assert reds(dataset.references) == [40, 41, 42, 43, 44, 45, 10, 11, 12, 13, 14, 15]
    assert dataset.places.tolist() == [0, 1, 2, 3, 4, 5] * 2


def test_queries_are_those_of_the_query_season_from_the_first_query_place_on(tiny_root):
    dataset = nordland(root=str(tiny_root), query="winter", **TINY)
    assert reds(dataset.queries) == [42, 43, 44, 45]
    assert [right.tolist() for right in dataset.positives] == [[2], [3], [4], [5]]


def test_frames_of_the_query_season_outside_the_queries_may_be_missing(tiny_root):
    (tiny_root / "summer" / "images-00202.png").unlink()
    assert len(nordland(root=str(tiny_root), **TINY).queries) == 4


def test_the_places_before_the_first_query_are_held_out_in_every_season(tiny_root):
    held_out = nordland(root=str(tiny_root), query="winter", **TINY).held_out
    assert reds(held_out.references) == [10, 11, 30, 31]
    assert held_out.places.tolist() == [0, 1, 0, 1]
    assert reds(held_out.queries) == [40, 41]
    assert (held_out.right.tolist(), held_out.in_map) == ([0, 1], True)


# numpy's RandomState(42) draws of six places first 0, then 1, then 5.
SET_ASIDE = {"stride": 2, "places": 6, "first_query_place": 3, "query_places": 2, "protocol": "vprsnn"}


@pytest.fixture
def vprsnn(tiny_root):
    return nordland(root=str(tiny_root), query="winter", **SET_ASIDE)


def test_the_places_that_vprsnn_sets_aside_are_neither_in_the_map_nor_queried(vprsnn):
    assert reds(vprsnn.references) == [12, 13, 14, 32, 33, 34]
    assert vprsnn.places.tolist() == [0, 1, 2, 0, 1, 2]
    assert reds(vprsnn.queries) == [42, 43]
    assert [right.tolist() for right in vprsnn.positives] == [[0], [1]]


def test_the_places_that_vprsnn_sets_aside_are_held_out(vprsnn):
    assert reds(vprsnn.held_out.references) == [10, 11, 15, 30, 31, 35]
    assert vprsnn.held_out.places.tolist() == [0, 1, 2, 0, 1, 2]
    assert reds(vprsnn.held_out.queries) == [40, 41, 45]
    assert (vprsnn.held_out.right.tolist(), vprsnn.held_out.in_map) == ([0, 1, 2], False)


def test_frames_of_places_that_vprsnn_sets_aside_have_to_be_there(tiny_root):
    (tiny_root / "summer" / "images-00202.png").unlink()
    message = refusal(kind=NotThere, root=str(tiny_root), **SET_ASIDE)
    assert f"images-00202.png is missing from {tiny_root / 'summer'} (1 of 5 expected frames" in message


def test_the_protocol_says_everything_that_was_selected(tiny_root):
    dataset = nordland("mine", str(tiny_root), ["fall"], "winter", tolerance=1, **TINY)
    assert dataset.name == "mine"
    assert dict(dataset.protocol) == {
        "protocol": "vprtempo",
        "references": ["fall"],
        "query": "winter",
        "stride": 2,
        "places": 6,
        "query_places": 4,
        "first_query_place": 2,
        "reference_places": 6,
        "held_out_places": 2,
        "tolerance_places": 1,
        "frame_multiple": 1,
    }


def test_no_root_is_answered_with_the_option_and_where_the_frames_are():
    message = refusal(kind=NotThere)
    assert "dataset.root is not set" in message
    assert "Somayeh-h/Nordland" in message


def test_a_root_that_does_not_exist_is_named(tmp_path):
    assert f"dataset.root={tmp_path / 'nowhere'} is no folder" in refusal(kind=NotThere, root=str(tmp_path / "nowhere"))


@pytest.mark.parametrize("name", ["nordland", "nordland_27k"])
def test_without_a_root_the_download_that_all_protocols_share_is_taken(tiny_root, no_downloads, name):
    (no_downloads / "nordland").symlink_to(tiny_root)
    assert reds(nordland(name, **TINY).queries) == [22, 23, 24, 25]


def test_without_a_root_frames_of_another_size_are_another_download(tiny_root, no_downloads):
    (no_downloads / "nordland").symlink_to(tiny_root)
    message = refusal(kind=NotThere, name="nordland_64x32", download="nordland_64x32", **TINY)
    assert message.startswith("dataset.root is not set: nordland_64x32 needs")
    assert message.endswith(f"or call that folder {no_downloads / 'nordland_64x32'}")


def test_a_default_root_that_does_not_exist_is_no_root():
    assert "dataset.root is not set" in refusal(kind=NotThere, default_root="../no/such/folder")


def test_a_missing_season_is_named(tiny_root):
    (tiny_root / "fall").rename(tiny_root / "autumn")
    assert str(tiny_root / "fall") in refusal(kind=NotThere, root=str(tiny_root), **TINY)


@pytest.mark.parametrize(("season", "n_wanted"), [("fall", 6), ("summer", 4)])
def test_missing_frames_are_counted_and_the_first_is_named(tiny_root, season, n_wanted):
    for frame in (208, 212):
        (tiny_root / season / f"images-{frame:05d}.png").unlink()
    message = refusal(kind=NotThere, root=str(tiny_root), **TINY)
    assert f"images-00208.png is missing from {tiny_root / season}" in message
    assert f"2 of {n_wanted} expected frames are missing" in message


def test_a_folder_under_the_name_of_a_frame_is_no_frame(tiny_root):
    frame = tiny_root / "fall" / "images-00208.png"
    frame.unlink()
    frame.mkdir()
    assert f"{frame.name} is missing from {tiny_root / 'fall'}" in refusal(kind=NotThere, root=str(tiny_root), **TINY)


@pytest.mark.parametrize(
    ("count", "told"),
    [
        (
            24_570,
            "24,570 images are a part of the partition of Olid et al., which numbers the frames in another way; get ",
        ),
        (28_865, "28,865 images are the partition of Olid et al., which numbers the frames in another way; get "),
    ],
)
def test_a_season_in_another_numbering_is_known_by_its_count(tiny_root, count, told):
    (tiny_root / "fall" / "images-00208.png").unlink()
    for number in range(count - 5):
        (tiny_root / "fall" / f"{number}.png").touch()
    (tiny_root / "fall" / "README.md").touch()
    message = refusal(kind=NotThere, root=str(tiny_root), **TINY)
    assert f"images-00208.png is missing from {tiny_root / 'fall'} (1 of 6 expected frames are missing, " in message
    assert told in message
    assert "dataset.root" in message


def test_frames_that_were_converted_are_answered_with_the_suffix_to_set(tiny_root):
    for path in [*tiny_root.rglob("*.png")]:
        path.rename(path.with_suffix(".jpg"))
    message = refusal(kind=NotThere, root=str(tiny_root), **TINY)
    assert message.endswith("images-00206.jpg is there: pass dataset.suffix=.jpg")
    assert nordland(root=str(tiny_root), suffix=".jpg", **TINY).queries.names[0] == "images-00206.jpg"


def test_each_season_is_a_folder_with_the_names_that_are_wanted_of_it(tiny_root):
    folders = nordland(root=str(tiny_root), **TINY).folders
    names = tuple(f"images-{frame:05d}.png" for frame in TINY_FRAMES)
    assert {folder.path.name: folder.used for folder in folders} == {
        "summer": names[2:],
        "spring": names,
        "fall": names,
    }


def test_a_whole_season_has_35768_frames_and_a_filtered_one_those_of_the_list(tiny_root):
    for folder in nordland(root=str(tiny_root), **TINY).folders:
        assert folder.counts == (35_768, 27_592)
        assert {*folder.wrong_counts} == {24_570, 28_865}


def test_a_folder_that_lacks_most_frames_is_answered_with_the_option_to_set(tiny_root):
    for frame in TINY_FRAMES[2:]:
        (tiny_root / "fall" / f"images-{frame:05d}.png").unlink()
    assert "set dataset.root so that" in refusal(kind=NotThere, root=str(tiny_root), **TINY)


def test_what_an_unfinished_download_left_is_no_root(tiny_root, no_downloads):
    (no_downloads / "nordland" / "archives").mkdir(parents=True)
    (no_downloads / "nordland" / ".fetch.lock").touch()
    message = refusal(kind=NotThere, **TINY)
    assert message.startswith("dataset.root is not set: nordland needs")
    assert message.endswith("nordland (which holds no frames yet: a download was not finished)")


def test_a_download_comes_before_the_default_root(tiny_root, no_downloads, tmp_path):
    (no_downloads / "nordland").symlink_to(tiny_root)
    (tmp_path / "other").mkdir()
    assert len(nordland(default_root=str(tmp_path / "other"), **TINY).queries) == 4


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"references": []}, "dataset.references=[]: name at least one season"),
        ({"places": 3450}, "dataset.places=3450: the list of 27592 names at stride 8 has 3449 places"),
        ({"stride": 1, "places": 2762, "frame_multiple": 10}, "dataset.places=2762: the list of 2761 names"),
        ({"first_query_place": 601}, "dataset.first_query_place=601 and dataset.query_places=2700 ask for"),
        ({"first_query_place": -1}, "dataset.first_query_place=-1"),
        ({"query_places": 0}, "dataset.query_places=0"),
        ({"query_places": -5}, "dataset.query_places=-5"),
        ({"tolerance": -1}, "dataset.tolerance=-1"),
        ({"stride": 0}, "dataset.stride=0"),
        ({"places": 0}, "dataset.places=0"),
        ({"frame_multiple": 0}, "dataset.frame_multiple=0"),
        ({"query_stride": 0}, "dataset.query_stride=0"),
        ({"protocol": "sift"}, "dataset.protocol=sift: choose vprtempo, vprsnn, patchnetvlad, 27k or vprbench"),
        ({"protocol": "27k"}, "dataset.protocol=27k with dataset.stride=8"),
        ({"protocol": "vprbench", "stride": 1, "frame_multiple": 10}, "choose dataset=nordland_vprbench"),
    ],
    ids=lambda value: ", ".join(f"{k}={v}" for k, v in value.items()) if isinstance(value, dict) else "",
)
def test_a_bad_option_is_named_in_one_line(arguments, message):
    assert message in refusal(**arguments)


@needs_real_frames
def test_the_frames_beside_the_checkout_are_found_by_their_default_root():
    dataset = nordland(
        "nordland_64x32",
        references=["winter"],
        stride=1,
        places=2761,
        query_places=2761,
        first_query_place=0,
        frame_multiple=10,
        default_root="../shared/data/nordland_64x32",
    )
    assert (len(dataset.references), dataset.n_places, len(dataset.queries)) == (2761, 2761, 2761)
    assert all(len([*folder.path.iterdir()]) == 3576 == folder.counts[0] for folder in dataset.folders)
    assert dataset.references[0].shape == dataset.queries[2760].shape == (32, 64, 3)
