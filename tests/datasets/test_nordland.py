"""Nordland: the places of the paper, what may be asked of it, and folders in which something is missing."""

from functools import partial

import pytest
from image_folders import answer, needs_real_frames, reds, rights
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


def test_seasons_come_in_the_order_asked_for_and_queries_from_the_first_query_place_on(tiny_root):
    dataset = nordland(root=str(tiny_root), references=["winter", "spring"], query="fall", **TINY)
    assert reds(dataset.references) == [40, 41, 42, 43, 44, 45, 10, 11, 12, 13, 14, 15]
    assert reds(dataset.queries) == [32, 33, 34, 35]
    assert rights(dataset) == [[2], [3], [4], [5]]
    assert (reds(dataset.held_out.references), reds(dataset.held_out.queries)) == ([40, 41, 10, 11], [30, 31])


@pytest.mark.parametrize(
    ("options", "lacking", "told"),
    [
        ({}, None, None),
        ({"protocol": "vprsnn"}, "summer", "images-00202.png is missing from {} (1 of 6 "),
        ({"query": "spring"}, "spring", "images-00202.png is missing from {} (1 of 6 "),
        ({}, "fall", "images-00202.png is missing from {} (1 of 6 "),
    ],
)
def test_only_frames_that_some_method_needs_have_to_be_there(tiny_root, options, lacking, told):
    # numpy's RandomState(42) draws of six places first 0 and 1, so vprsnn needs the first frames of the query season.
    (tiny_root / (lacking or "summer") / "images-00202.png").unlink()
    asked = {"root": str(tiny_root), **TINY, **options}
    if lacking:
        assert told.format(tiny_root / lacking) in refusal(kind=NotThere, **asked)
    else:
        dataset = nordland(**asked)
        assert [len(folder.used) for folder in dataset.folders] == [4, 6, 6]


@pytest.mark.parametrize(
    ("frames", "others", "told"),
    [
        ((208, 212), 0, "2 of 6 expected frames are missing, 4 files are there): copy or download them again"),
        ((206, 208, 210, 212), 0, "set dataset.root so that"),
        ((208,), 24_565, "24,570 images are a part of the partition of Olid et al."),
        ((208,), 28_860, "28,865 images are the partition of Olid et al."),
        ((202, 204, 206, 208, 210, 212), -1, "does not exist"),
    ],
)
def test_missing_frames_are_counted_with_what_to_do(tiny_root, frames, others, told):
    for frame in frames:
        (tiny_root / "fall" / f"images-{frame:05d}.png").unlink()
    for number in range(others):
        (tiny_root / "fall" / f"{number}.png").touch()
    if others < 0:
        (tiny_root / "fall").rmdir()
    message = refusal(kind=NotThere, root=str(tiny_root), **TINY)
    assert str(tiny_root / "fall") in message
    assert told in message


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


def test_places_before_the_first_one_are_left_out_and_the_others_keep_their_numbers(tiny_root):
    options = {**TINY, "places": 4, "query_places": 3, "first_query_place": 1, "first_place": 2}
    dataset = nordland(root=str(tiny_root), references=["winter"], query="fall", **options)
    assert (reds(dataset.references), reds(dataset.queries)) == ([42, 43, 44, 45], [33, 34, 35])
    assert (rights(dataset), dataset.place_numbers.tolist()) == ([[1], [2], [3]], [2, 3, 4, 5])
    assert dataset.protocol["first_place"] == 2
    assert "dataset.first_place=-1" in refusal(root=str(tiny_root), **{**TINY, "first_place": -1})


@pytest.mark.parametrize("name", ["nordland", "nordland_27k"])
def test_without_a_root_the_download_that_all_protocols_share_is_taken(tiny_root, no_downloads, name):
    (no_downloads / "nordland").symlink_to(tiny_root)
    assert reds(nordland(name, **TINY).queries) == [22, 23, 24, 25]


def test_a_folder_under_the_name_of_a_frame_is_no_frame(tiny_root):
    frame = tiny_root / "fall" / "images-00208.png"
    frame.unlink()
    frame.mkdir()
    assert f"{frame.name} is missing from {tiny_root / 'fall'}" in refusal(kind=NotThere, root=str(tiny_root), **TINY)


def test_frames_that_were_converted_are_answered_with_the_suffix_to_set(tiny_root):
    for path in [*tiny_root.rglob("*.png")]:
        path.rename(path.with_suffix(".jpg"))
    message = refusal(kind=NotThere, root=str(tiny_root), **TINY)
    assert message.endswith("images-00206.jpg is there: pass dataset.suffix=.jpg")
    assert nordland(root=str(tiny_root), suffix=".jpg", **TINY).queries.names[0] == "images-00206.jpg"


def test_a_whole_season_has_35768_frames_and_a_filtered_one_those_of_the_list(tiny_root):
    for folder in nordland(root=str(tiny_root), **TINY).folders:
        assert folder.counts == (35_768, 27_592)
        assert {*folder.wrong_counts} == {24_570, 28_865}


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
        ({"references": ["spring", "spring"]}, "dataset.references=['spring', 'spring']"),
        ({"query": "tea"}, "dataset.query=tea: Nordland has spring, summer, fall, winter"),
        ({"places": 3450}, "dataset.places=3450: the list of 27592 names at stride 8 has 3449 places"),
        ({"stride": 1, "places": 2762, "frame_multiple": 10}, "dataset.places=2762: the list of 2761 names"),
        ({"first_query_place": 601}, "dataset.first_query_place=601 and dataset.query_places=2700"),
        ({"stride": 0}, "dataset.stride=0"),
        ({"frame_multiple": 0}, "dataset.frame_multiple=0"),
        ({"protocol": "sift"}, "dataset.protocol=sift: choose vprtempo, vprsnn, patchnetvlad, 27k or vprbench"),
        ({"protocol": "27k"}, "dataset.protocol=27k with dataset.stride=8"),
        ({"protocol": "vprbench", "stride": 1, "frame_multiple": 10}, "choose dataset=nordland_vprbench"),
    ],
)
def test_a_bad_option_is_named_in_one_line(arguments, message):
    assert message in refusal(**arguments)


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({}, "dataset.root is not set: nordland needs"),
        ({"default_root": "../no/such/folder"}, "dataset.root is not set"),
        ({"root": "/no/such"}, "dataset.root=/no/such is no folder"),
        ({"name": "nordland_64x32", "download": "nordland_64x32"}, "or call that folder {}/nordland_64x32"),
    ],
)
def test_no_root_is_answered_with_where_the_frames_are(tiny_root, no_downloads, options, told):
    (no_downloads / "nordland" / "archives").mkdir(parents=True)
    message = refusal(kind=NotThere, **options)
    assert told.format(no_downloads) in message
    assert "Somayeh-h/Nordland" in message


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
