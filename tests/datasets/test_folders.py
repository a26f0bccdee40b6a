"""Your own folders: natural order, matching by number or by position, and what is said where that fails."""

import os
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
from image_folders import REAL, answer, needs_real_frames, rights

from vprbench.datasets.folders import folders
from vprbench.datasets.readers.image_files import images_in
from vprbench.errors import BadInput, NotThere
from vprbench.methods.sad import SAD


@pytest.fixture
def fill(tmp_path):
    """A function that makes a folder of empty image files and returns its path."""

    def fill(folder, names):
        for name in names:
            path = tmp_path / folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.touch()
        return str(tmp_path / folder)

    return fill


def numbered(n):
    return [f"{i}.png" for i in range(n)]


def at(*positions):
    return [f"@{east}@{north}@{i}@.png" for i, (east, north) in enumerate(positions)]


def test_sub_folders_are_included_in_natural_order(fill):
    names = ["run10/10.png", "run10/9.png", "run2/7.png", "run2/deep/3.png", ".thumbnails/2.png"]
    dataset = folders(references=[fill("a", names)], queries=fill("b", numbered(1)))
    assert dataset.references.names == ("7.png", "3.png", "9.png", "10.png")


@pytest.mark.parametrize("backwards", [False, True])
def test_names_that_differ_in_leading_zeros_alone_do_not_depend_on_the_file_system(fill, monkeypatch, backwards):
    references, queries = fill("a", ["1.png", "01.png", "001.png"]), fill("b", numbered(1))
    listed = os.scandir

    def ordered(folder):
        return nullcontext(sorted(listed(folder), key=lambda entry: entry.name, reverse=backwards))

    monkeypatch.setattr(os, "scandir", ordered)
    dataset = folders(references=[references], queries=queries)
    assert dataset.references.names == ("001.png", "01.png", "1.png")


def test_linked_sub_folders_are_included_and_one_that_leads_back_ends(fill, tmp_path):
    references = Path(fill("a", ["1.png"]))
    (references / "2").symlink_to(fill("elsewhere", ["5.png"]))
    (references / "again").symlink_to(tmp_path / "a")
    names = folders(references=[str(references)], queries=fill("b", numbered(1))).references.names
    assert names == ("1.png", "5.png")


def test_a_link_to_an_image_that_is_gone_keeps_its_place(fill, tmp_path):
    references = Path(fill("a", ["1.png", "3.png"]))
    (references / "2.png").symlink_to(tmp_path / "gone.png")
    dataset = folders(references=[str(references)], queries=fill("b", numbered(3)))
    assert dataset.references.names == ("1.png", "2.png", "3.png")
    assert dataset.folders[0].used == ("1.png", "2.png", "3.png")


def test_a_sub_folder_that_cannot_be_read_is_refused_by_name(fill, monkeypatch):
    references = fill("a", ["1.png", "closed/2.png"])
    listed = os.scandir

    def scandir(folder):
        if Path(folder).name == "closed":
            raise PermissionError(13, "Permission denied", str(folder))
        return listed(folder)

    monkeypatch.setattr(os, "scandir", scandir)
    message = answer(folders, kind=NotThere, references=[references], queries=fill("b", numbered(1)))
    assert f"{Path(references) / 'closed'} cannot be read (Permission denied)" in message


def test_lists_documents_and_what_systems_add_are_left_out(fill):
    beside = ["poses.txt", "GT.npz", "ground_truth.csv", "1.json", "README", "Thumbs.db", "._1.png", "@eaDir/1.jpg"]
    dataset = folders(
        references=[fill("a", ["1.png", "2.JPG", "3.jpe", "4.pnm", *beside])], queries=fill("b", numbered(4))
    )
    assert dataset.references.names == ("1.png", "2.JPG", "3.jpe", "4.pnm")


@pytest.mark.parametrize("deep", [True, False])
@pytest.mark.parametrize("kind", ["2.heic", "2.gif", "2.png~", "2.exr", "2", "a folder", "a pipe", "a linked folder"])
def test_what_may_be_a_frame_and_cannot_be_read_is_refused_by_name(fill, tmp_path, kind, deep):
    top = Path(fill("a", ["1.png", "3.png"]))
    stranger = top / (kind if kind.startswith("2") else "2.png")
    if kind == "a folder":
        fill("a/2.png", ["2.png"])
    elif kind == "a linked folder":
        stranger.symlink_to(fill("b", ["2.png"]))
    elif kind == "a pipe":
        os.mkfifo(stranger)
    else:
        stranger.touch()
    with pytest.raises(BadInput) as error:
        images_in(top, "dataset.queries", "", deep=deep)
    assert str(error.value).startswith(f"dataset.queries: {stranger} is ")


@needs_real_frames
@pytest.mark.parametrize(
    ("name", "count"), [("corridor", 222), ("nordland_64x32", 7152), ("brisbane_events_7x7", 1365)]
)
def test_what_lies_beside_real_frames_is_known(name, count):
    assert len(images_in(REAL / name, "", "")) == count


def test_a_folder_that_links_lead_to_twice_is_refused_by_name(fill):
    top = Path(fill("a", ["1.png", "inner/2.png"]))
    (top / "link").symlink_to(top / "inner")
    assert str(top / "link") in answer(folders, references=[str(top)], queries=fill("b", numbered(1)))


def test_folders_of_unequal_counts_are_each_named_with_theirs(fill):
    first, second = fill("a", numbered(3)), fill("b", numbered(4))
    message = answer(folders, references=[first, second], queries=fill("c", numbered(3)))
    assert "dataset.references" in message
    assert f"{first} 3, {second} 4" in message


def test_queries_beyond_the_last_place_are_counted_and_the_first_is_named(fill):
    queries = fill("b", numbered(7))
    message = answer(folders, references=[fill("a", numbered(4))], queries=queries, tolerance=1)
    assert "2 of 7 queries have no reference within 1 places" in message  # query 4 still has place 3
    assert str(Path(queries) / "5.png") in message
    assert "dataset.unmatched=keep" in message


# 7-24-25, 15-20-25 and the axis: exactly 25 m away.


@pytest.mark.parametrize(
    "name", ["1.png", "@12@.png", "@east@north@.png", "@12.png", "@@@.png", "@nan@4@.png", "@1@-1e308@.png"]
)
@pytest.mark.parametrize("side", ["references", "queries"])
def test_a_name_without_a_position_is_named(fill, name, side):
    names = {"references": at((0, 0)), "queries": at((0, 0))} | {side: [name]}
    references, queries = fill("references", names["references"]), fill("queries", names["queries"])
    message = answer(folders, references=[references], queries=queries, ground_truth="utm")
    assert str(Path(references).parent / side / name) in message


def test_a_negative_tolerance_is_refused(fill):
    message = answer(folders, references=[fill("a", numbered(2))], queries=fill("b", numbered(2)), tolerance=-1)
    assert "dataset.tolerance=-1" in message


@pytest.mark.parametrize("option", ["references", "queries"])
@pytest.mark.parametrize("kind", ["missing", "empty", "without images", "a file"])
def test_a_folder_without_images_is_named_with_its_option(fill, tmp_path, option, kind):
    bad = tmp_path / "bad"
    if kind in ("empty", "without images"):
        bad.mkdir()
    if kind == "without images":
        (bad / "notes.txt").touch()
    if kind == "a file":
        bad.touch()
    good = fill("good", numbered(2))
    given = {"references": [good], "queries": good} | {option: [str(bad)] if option == "references" else str(bad)}
    assert f"dataset.{option}: {bad}" in answer(folders, kind=NotThere, **given)


@pytest.mark.parametrize("given", [(), ("references",), ("queries",)])
def test_unset_options_are_both_named(fill, given):
    folder = fill("a", numbered(2))
    arguments = {"references": [folder], "queries": folder}
    message = answer(folders, kind=NotThere, **{option: arguments[option] for option in given})
    assert "dataset.references and dataset.queries" in message


def test_the_protocol_of_an_index_says_everything_that_was_selected(fill):
    references, queries = fill("a", numbered(2)), fill("b", numbered(2))
    dataset = folders("mine", [references], queries, tolerance=1)
    assert dataset.name == "mine"
    assert dict(dataset.protocol) == {
        "protocol": "folders",
        "references": ["a"],
        "queries": "b",
        "ground_truth": "index",
        "unmatched": "error",
        "tolerance_places": 1,
    }


RIGHT = np.array([[1, 0, 0], [0, 1, 1], [0, 0, 0], [1, 0, 1]], bool)  # of four queries, the third has no place


@pytest.fixture
def with_matrix(fill, tmp_path):
    """A function that reads two folders with a matrix of these arrays."""

    def read(**arrays):
        np.savez_compressed(tmp_path / "truth.npz", **arrays)
        references, queries = [fill("a", numbered(2)), fill("b", numbered(1))], fill("c", numbered(4))
        return folders("mine", references, queries, str(tmp_path / "truth.npz"), unmatched="keep")

    return read


def test_rows_of_a_matrix_are_queries_and_its_columns_the_images_of_all_reference_folders(with_matrix):
    dataset = with_matrix(positives=RIGHT.astype(np.float32))
    assert rights(dataset) == [[0], [1, 2], [], [0, 2]]
    assert dataset.places.tolist() == [0, 1, 2]
    assert dataset.notes == (
        "1 of 4 queries have no right reference in truth.npz; they count as misses (dataset.unmatched=keep)",
    )
    assert dict(dataset.protocol) == {
        "protocol": "folders",
        "references": ["a", "b"],
        "queries": "c",
        "ground_truth": "truth.npz",
        "unmatched": "keep",
    }


@pytest.mark.parametrize(
    ("arrays", "told"),
    [
        ({"positives": RIGHT.T}, "(3, 4) (it is transposed); wanted is (4, 3), queries by references"),
        ({"truth": RIGHT}, "holds no positives"),
    ],
)
def test_another_matrix_is_refused(with_matrix, arrays, told):
    assert told in answer(with_matrix, **arrays)


def test_a_ground_truth_that_is_no_word_and_no_matrix_is_refused_with_what_is_possible(fill, tmp_path):
    given = {"references": [fill("a", numbered(2))], "queries": fill("b", numbered(2))}
    assert "dataset.ground_truth=idx: give index, utm or an .npz" in answer(folders, **given, ground_truth="idx")
    missing = str(tmp_path / "gone.npz")
    assert f"{missing} is no file" in answer(folders, kind=NotThere, **given, ground_truth=missing)


@needs_real_frames
def test_sad_of_raw_event_counts_finds_the_share_of_brisbane_that_independent_code_found():
    # Source: the README beside the frames, R@1 0.105 of all 724 queries, 4 of which have no right place.
    root = REAL / "brisbane_events_7x7"
    dataset = folders(
        "brisbane",
        [str(root / "sunset2")],
        str(root / "sunset1"),
        ground_truth=str(root / "ground_truth.npz"),
        unmatched="keep",
    )
    sad = SAD("grey", height=7, width=7).fit(dataset.references, dataset.places)
    found = sad.query(dataset.queries).argmax(1)
    hits = [place in right for place, right in zip(found.tolist(), dataset.positives, strict=True)]
    assert (len(hits), np.mean(hits)) == (724, pytest.approx(0.105, abs=0.0005))
