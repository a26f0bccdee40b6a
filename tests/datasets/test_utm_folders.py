"""Folders of VPR-datasets-downloader: where they are found, in which order, and what queries without a match become."""

import pytest
from image_folders import answer, fill, reds, rights, used

from vprbench.datasets.utm_folders import utm_folders
from vprbench.errors import BadInput, NotThere


def at(*positions):
    return [f"@{east}@{north}@10@S@@@{i}@.jpg" for i, (east, north) in enumerate(positions)]


@pytest.fixture
def root(tmp_path):
    """Three places 20 m apart and three queries: at the first, between the others, and 900 m off."""
    fill(tmp_path / "images" / "test" / "database", at((0, 0), (20, 0), (40, 0)))
    fill(tmp_path / "images" / "test" / "queries", at((0, 5), (30, 0), (900, 0)))
    return tmp_path


def test_a_reference_within_the_radius_is_right_and_a_query_without_one_counts_as_a_miss(root):
    dataset = utm_folders(root=str(root))
    assert rights(dataset) == [[0, 1], [1, 2], []]
    assert dataset.notes == (
        "1 of 3 queries have no reference within 25 m; they count as misses (dataset.unmatched=keep)",
    )


def test_a_query_without_a_right_reference_is_left_out_or_an_error_where_asked(root):
    dataset = utm_folders(root=str(root), unmatched="drop")
    assert (reds(dataset.queries), rights(dataset)) == ([0, 1], [[0, 1], [1, 2]])
    assert (len(used(dataset)), "are left out" in dataset.notes[0]) == (6, True)
    message = answer(utm_folders, root=str(root), unmatched="error")
    assert "1 of 3 queries have no reference within 25 m (first: " in message
    assert "@900@0@" in message
    assert "leaves none" in answer(utm_folders, root=str(root), radius_metres=1, unmatched="drop")


@pytest.mark.parametrize("way", ["images/val", "val", "."])
def test_both_folders_are_found_in_each_of_the_three_layouts(tmp_path, way):
    fill(tmp_path / way / "database", at((0, 0)))
    fill(tmp_path / way / "queries", at((1, 1)))
    dataset = utm_folders(root=str(tmp_path), split="val")
    assert rights(dataset) == [[0]]
    assert dataset.protocol["split"] == (None if way == "." else "val")


def test_the_split_asked_for_is_taken_before_folders_of_the_root(root):
    fill(root / "database", at((500, 0)))
    fill(root / "queries", at((500, 0)))
    assert len(utm_folders(root=str(root)).queries) == 3


def test_an_at_sign_in_the_path_does_not_matter(tmp_path):
    fill(tmp_path / "me@7@8" / "gallery" / "@9@9", at((0, 0)))
    fill(tmp_path / "me@7@8" / "queries", at((3, 4)))
    assert rights(utm_folders(root=str(tmp_path / "me@7@8"), database="gallery", radius_metres=5)) == [[0]]


def test_images_come_in_the_order_of_their_whole_paths(tmp_path):
    names = ["b/@1@0@.jpg", "a/@9@0@.jpg", "@5@0@.jpg", "a/@10@0@.jpg"]
    fill(tmp_path / "database", names)
    fill(tmp_path / "queries", at((0, 0)))
    dataset = utm_folders(root=str(tmp_path))
    assert dataset.references.names == ("@5@0@.jpg", "@10@0@.jpg", "@9@0@.jpg", "@1@0@.jpg")


def test_a_list_beside_the_folder_says_which_images_and_in_which_order(root):
    names = at((0, 0), (20, 0), (40, 0))
    (root / "images" / "test" / "database_images_paths.txt").write_text(f"\ufeff{names[2]}\n{names[0]}\n", "utf-8")
    dataset = utm_folders(root=str(root))
    assert reds(dataset.references) == [2, 0]
    assert rights(dataset) == [[1], [0], []]
    assert dataset.protocol["lists"] == ["database_images_paths.txt"]


@pytest.mark.parametrize(
    ("content", "kind", "told"),
    [
        ("@20@0@.jpg\n".encode("utf-16"), BadInput, "is no text in UTF-8"),
        (b"\n", NotThere, "names no image"),
        (b"@0@5@.jpg\n", NotThere, "@0@5@.jpg does not exist (1 of 1 images in "),
    ],
)
def test_a_list_that_does_not_fit_its_folder_is_named(root, content, kind, told):
    (root / "images" / "test" / "queries_images_paths.txt").write_bytes(content)
    message = answer(utm_folders, root=str(root), kind=kind)
    assert "queries_images_paths.txt" in message
    assert told in message


def test_without_a_root_the_download_folder_is_taken_and_else_the_source_named(root, monkeypatch):
    monkeypatch.setenv("VPRBENCH_DATA", str(root.parent))
    assert len(utm_folders(name=root.name).queries) == 3
    assert "VPR-datasets-downloader" in answer(utm_folders, name="pitts30k", kind=NotThere)


def test_a_root_without_the_split_is_answered_with_where_it_was_looked_for(root):
    message = answer(utm_folders, root=str(root), split="val", kind=NotThere)
    assert str(root / "images" / "val") in message


def test_the_protocol_says_everything_that_was_selected(root):
    assert dict(utm_folders(root=str(root)).protocol) == {
        "protocol": "utm_folders",
        "split": "test",
        "database": "database",
        "queries": "queries",
        "radius_metres": 25.0,
        "zones": "error",
        "unmatched": "keep",
    }
