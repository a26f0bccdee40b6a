"""Frames of a folder: natural order whatever the file system lists first, links, and what lies beside frames."""

import os
from contextlib import nullcontext
from pathlib import Path

import pytest
from image_folders import REAL, answer, needs_real_frames

from vprbench.datasets.readers.image_files import images_in
from vprbench.errors import NotThere


@pytest.fixture
def fill(tmp_path):
    """A function that makes a folder of empty files and returns its path."""

    def fill(folder, names):
        for name in names:
            path = tmp_path / folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.touch()
        return tmp_path / folder

    return fill


def names_in(folder, **options):
    return images_in(folder, "dataset.queries", "", **options).names


def test_sub_folders_are_included_in_natural_order(fill):
    names = ["run10/10.png", "run10/9.png", "run2/7.png", "run2/deep/3.png", ".thumbnails/2.png", "5.png"]
    assert names_in(fill("a", names)) == ("5.png", "7.png", "3.png", "9.png", "10.png")
    assert names_in(fill("a", names), order="plain") == ("5.png", "10.png", "9.png", "7.png", "3.png")
    assert names_in(fill("a", names), deep=False) == ("5.png",)


def test_names_that_differ_in_leading_zeros_alone_do_not_depend_on_the_file_system(fill, monkeypatch):
    folder, listed = fill("a", ["1.png", "01.png", "001.png"]), os.scandir
    for backwards in (False, True):
        entries = sorted(listed(folder), key=lambda entry: entry.name, reverse=backwards)
        monkeypatch.setattr(os, "scandir", lambda _, entries=entries: nullcontext(entries))
        assert names_in(folder) == ("001.png", "01.png", "1.png")


def test_linked_sub_folders_are_included_one_that_leads_back_ends_and_a_dead_link_keeps_its_place(fill, tmp_path):
    top = fill("a", ["1.png"])
    (top / "2").symlink_to(fill("elsewhere", ["5.png"]))
    (top / "again").symlink_to(tmp_path / "a")
    (top / "0.png").symlink_to(tmp_path / "gone.png")
    assert names_in(top) == ("0.png", "1.png", "5.png")


def test_a_sub_folder_that_cannot_be_read_is_refused_by_name(fill, monkeypatch):
    top, listed = fill("a", ["1.png", "closed/2.png"]), os.scandir

    def scandir(folder):
        if Path(folder).name == "closed":
            raise PermissionError(13, "Permission denied", str(folder))
        return listed(folder)

    monkeypatch.setattr(os, "scandir", scandir)
    assert f"{top / 'closed'} cannot be read (Permission denied)" in answer(names_in, top, kind=NotThere)


def test_lists_documents_and_what_systems_add_are_left_out(fill):
    beside = ["poses.txt", "GT.npz", "ground_truth.csv", "1.json", "README", "Thumbs.db", "._1.png", "@eaDir/1.jpg"]
    images = ("1.png", "2.JPG", "3.jpe", "4.pnm")
    assert names_in(fill("a", [*images, *beside])) == images


@pytest.mark.parametrize("kind", ["2.heic", "2.png~", "2", "a folder", "a pipe", "a linked folder"])
def test_what_may_be_a_frame_and_cannot_be_read_is_refused_by_name(fill, kind):
    top = fill("a", ["1.png", "3.png"])
    stranger = top / (kind if kind.startswith("2") else "2.png")
    if kind == "a folder":
        fill("a/2.png", ["2.png"])
    elif kind == "a linked folder":
        stranger.symlink_to(fill("b", ["2.png"]))
    elif kind == "a pipe":
        os.mkfifo(stranger)
    else:
        stranger.touch()
    for deep in (True, False):
        assert answer(names_in, top, deep=deep).startswith(f"dataset.queries: {stranger} is ")


def test_a_folder_that_links_lead_to_twice_is_refused_by_name(fill):
    top = fill("a", ["1.png", "inner/2.png"])
    (top / "link").symlink_to(top / "inner")
    assert str(top / "link") in answer(names_in, top)


@needs_real_frames
def test_what_lies_beside_real_frames_is_known():
    counts = {"corridor": 222, "nordland_64x32": 7152, "brisbane_events_7x7": 1365}
    assert {name: len(names_in(REAL / name)) for name in counts} == counts
