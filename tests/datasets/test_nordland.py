"""Nordland: the published list and ways to ask it, and folders that are incomplete."""

import hashlib
from functools import partial

import numpy as np
import pytest
from image_folders import answer, reds, rights
from PIL import Image as PillowImage

from vprbench.config import make_request
from vprbench.datasets.nordland import chosen_names, nordland, published_frames
from vprbench.datasets.readers import frame_folders
from vprbench.errors import MissingData
from vprbench.plugins import registry

TINY = {"stride": 2, "places": 6, "query_places": 4, "first_query_place": 2}
TINY_FRAMES = (202, 204, 206, 208, 210, 212)  # the list begins with 202, 203, 204 and so on
FRAMES = [f"images-{frame:05d}.png" for frame in published_frames()]
SEASON_LEVEL = {"spring": 10, "summer": 20, "fall": 30, "winter": 40}
refusal = partial(answer, nordland)


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
    dataset = nordland("mine", str(tiny_root), ["winter", "spring"], "fall", tolerance=1, **TINY)
    assert reds(dataset.references) == [40, 41, 42, 43, 44, 45, 10, 11, 12, 13, 14, 15]
    assert reds(dataset.queries) == [32, 33, 34, 35]
    assert rights(dataset) == [[1, 2, 3], [2, 3, 4], [3, 4, 5], [4, 5]]
    assert (reds(dataset.held_out.references), reds(dataset.held_out.queries)) == ([40, 41, 10, 11], [30, 31])
    assert dataset.name == "mine"
    assert dict(dataset.protocol) == {
        **{"protocol": "vprtempo", "references": ["winter", "spring"], "query": "fall", "stride": 2, "places": 6},
        **{"query_places": 4, "first_query_place": 2, "reference_places": 6, "held_out_places": 2},
        **{"tolerance_places": 1, "frame_multiple": 1},
    }
    for folder in dataset.folders:
        assert folder.counts == (35_768, 27_592)  # a whole season, and the frames of the list
        assert {*folder.wrong_counts} == {24_570, 28_865}


@pytest.mark.parametrize(
    ("options", "lacking"), [({}, None), ({"protocol": "vprsnn"}, "summer"), ({"query": "spring"}, "spring")]
)
def test_only_frames_that_some_method_needs_have_to_be_there(tiny_root, options, lacking):
    # numpy's RandomState(42) draws of six places first 0 and 1, so vprsnn needs the first frames of the query season.
    (tiny_root / (lacking or "summer") / "images-00202.png").unlink()
    asked = {"root": str(tiny_root), **TINY, **options}
    if lacking:
        told = f"images-00202.png is missing from {tiny_root / lacking} (1 of 6 "
        assert told in refusal(kind=MissingData, **asked)
    else:
        assert [len(folder.used) for folder in nordland(**asked).folders] == [4, 6, 6]


@pytest.mark.parametrize(
    ("frames", "others", "told"),
    [
        ((208, 212), 0, "{} (2 of 6 expected frames are missing, 4 files are there): copy or download"),
        ((206, 210, 212), 0, "set dataset.root so that <root>/spring/images-00202.png"),
        ((208,), 24_565, "24,570 images are a part of the partition of Olid et al."),
        ((202, 204, 206, 208, 210, 212), -1, "{} does not exist"),
    ],
)
def test_missing_frames_are_counted_with_what_to_do(tiny_root, monkeypatch, frames, others, told):
    for frame in frames:
        (tiny_root / "fall" / f"images-{frame:05d}.png").unlink()
    there, more = frame_folders.list_files, {f"{number}.png" for number in range(others)}
    monkeypatch.setattr(frame_folders, "list_files", lambda folder: there(folder) | more)
    if others < 0:
        (tiny_root / "fall").rmdir()
    elif not others:  # a folder under the name of a frame is no frame
        (tiny_root / "fall" / f"images-{frames[0]:05d}.png").mkdir()
    assert told.format(tiny_root / "fall") in refusal(kind=MissingData, root=str(tiny_root), **TINY)


def test_places_before_the_first_one_are_left_out_and_converted_frames_answered_with_the_suffix_to_set(tiny_root):
    options = {**TINY, "places": 4, "query_places": 3, "first_query_place": 1, "first_place": 2}
    dataset = nordland(root=str(tiny_root), references=["winter"], query="fall", **options)
    assert (reds(dataset.references), reds(dataset.queries)) == ([42, 43, 44, 45], [33, 34, 35])
    assert (rights(dataset), dataset.place_numbers.tolist()) == ([[1], [2], [3]], [2, 3, 4, 5])
    assert dataset.protocol["first_place"] == 2
    assert "dataset.first_place=-1" in refusal(root=str(tiny_root), **{**TINY, "first_place": -1})
    for path in [*tiny_root.rglob("*.png")]:
        path.rename(path.with_suffix(".jpg"))
    assert "images-00206.jpg is there: pass dataset.suffix=.jpg" in refusal(
        kind=MissingData, root=str(tiny_root), **TINY
    )
    assert nordland(root=str(tiny_root), suffix=".jpg", **TINY).queries.names[0] == "images-00206.jpg"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"references": ["spring", "spring"]}, "dataset.references=['spring', 'spring']"),
        ({"query": "tea"}, "dataset.query=tea: Nordland has spring, summer, fall, winter"),
        ({"places": 3450}, "dataset.places=3450: the list of 27592 names at dataset.stride=8 has 3449 places"),
        ({"stride": 0}, "dataset.stride=0"),
        ({"frame_multiple": 0}, "dataset.frame_multiple=0"),
    ],
)
def test_a_bad_option_is_named_in_one_line(arguments, message):
    assert message in refusal(**arguments)


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({}, "nordland (which holds no frames yet: a download was not finished)"),
        ({"default_root": "../no/such/folder"}, "dataset.root is not set"),
        ({"root": "/no/such"}, "dataset.root=/no/such is no folder"),
        ({"name": "nordland_64x32", "download": "nordland_64x32"}, "or call that folder {}/nordland_64x32"),
    ],
)
def test_no_root_is_answered_with_where_the_frames_are(no_downloads, options, told):
    (no_downloads / "nordland" / "archives").mkdir(parents=True)
    (no_downloads / "nordland" / ".fetch.lock").touch()
    message = refusal(kind=MissingData, **options)
    assert told.format(no_downloads) in message
    assert "Somayeh-h/Nordland" in message


def test_the_list_is_byte_for_byte_the_published_one():
    published = "".join(f"{name}\n" for name in FRAMES).encode()  # nordland_imageNames.txt of VPRSNN
    assert hashlib.sha256(published).hexdigest() == "6b1dcf6a8ccf2860f5b473dce84941fff87735bcb94face0af66d14fba49ff73"
    places = chosen_names(8, 3300, 1)
    assert [places[place][7:12] for place in (0, 1, 599, 600, 3299)] == ["00202", "00210", "07021", "07029", "34160"]
    assert chosen_names(3, 5, 10) == [name for name in FRAMES if name[11] == "0"][:15:3]
    assert len(chosen_names(8, 3449, 1)) == 3449


DRAWN = {*np.random.RandomState(42).permutation(3300)[:600].tolist()}  # that VPRSNN's authors set aside
EIGHTH = FRAMES[::8][:3300]
LEFT = [name for place, name in enumerate(EIGHTH) if place not in DRAWN]
# References, query, names of the map and of the queries, and tolerance in places.
PUBLISHED = {
    "nordland": (["spring", "fall"], "summer", EIGHTH, EIGHTH[600:], 0),
    "nordland_vprsnn": (["spring", "fall"], "summer", LEFT, LEFT, 0),
    "nordland_patchnetvlad": (["summer"], "winter", FRAMES, FRAMES, 7),
    "nordland_27k": (["summer"], "winter", FRAMES, FRAMES, 10),
    "nordland_vprbench": (["winter"], "summer", FRAMES, FRAMES[::10], 1),
}


@pytest.mark.extended
@pytest.mark.parametrize("name", PUBLISHED)
def test_each_way_asks_the_frames_and_seasons_that_are_published(tmp_path, monkeypatch, name):
    for season in SEASON_LEVEL:
        (tmp_path / season).mkdir()
    monkeypatch.setattr(frame_folders, "list_files", lambda _: {*FRAMES})  # that seem to be there: nothing is read
    config = make_request([f"dataset={name}"]).dataset
    dataset = registry.make_dataset({**config, "root": str(tmp_path)})
    references, query, mapped, queried, tolerance = PUBLISHED[name]
    assert [*dataset.references.names] == mapped * len(references)
    assert [*dataset.queries.names] == queried
    assert dataset.places.tolist() == [*range(len(mapped))] * len(references)
    assert [folder.path.name for folder in dataset.folders] == [query, *references]
    assert dataset.protocol["protocol"] == name.removeprefix("nordland_").replace("nordland", "vprtempo")
    if name == "nordland_vprsnn":
        assert [*dataset.held_out.queries.names] == [EIGHTH[place] for place in sorted(DRAWN)]
    elif name != "nordland":
        assert dataset.held_out is None
    for asked, right in zip(queried[:3], dataset.positives, strict=False):
        at = mapped.index(asked)
        assert right.tolist() == [*range(max(0, at - tolerance), at + tolerance + 1)]
