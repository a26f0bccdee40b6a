"""The doctor's cheap checks of folders: what is missing, empty, no image, of another copy, or not used."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from doctored import NAMES, PLACES, dataset_of, examined, healthy, notes, save, season, wrong

from vprbench.api.arrays import Image
from vprbench.api.dataset import Dataset
from vprbench.api.images import Images
from vprbench.data.doctor import insist, quick
from vprbench.errors import BadInput

PAGE = b"<!DOCTYPE html><html><body>Sign in to download</body></html>"


def test_a_healthy_dataset_has_nothing_but_the_note_that_it_is_aligned(tmp_path: Path) -> None:
    found = examined(*healthy(tmp_path))

    assert [(finding.level, finding.check) for finding in found] == [("note", "alignment")]


def test_the_cheap_checks_find_nothing_in_a_healthy_dataset(tmp_path: Path) -> None:
    winter, summer = healthy(tmp_path)

    assert quick(dataset_of([winter], summer)) == ()


def test_missing_files_are_counted_and_five_are_named(tmp_path: Path) -> None:
    winter, summer = healthy(tmp_path)
    dataset = dataset_of([winter], summer)
    for name in NAMES[10:17]:
        (winter / name).unlink()

    (missing,) = quick(dataset)

    assert (missing.level, missing.check) == ("error", "files")
    assert missing.text == (
        f"7 of 60 frames are missing from {winter}: 010.png, 011.png, 012.png, 013.png, 014.png and 2 more"
    )


def test_a_folder_that_is_gone_is_named(tmp_path: Path) -> None:
    winter, summer = healthy(tmp_path)
    dataset = dataset_of([winter], summer)
    shutil.rmtree(winter)

    assert wrong(quick(dataset)) == [("error", "files", f"{winter} is no folder")]


def test_empty_files_are_found_by_their_size(tmp_path: Path) -> None:
    winter, summer = healthy(tmp_path)
    (summer / "005.png").write_bytes(b"")
    (summer / "050.png").write_bytes(b"")

    found = quick(dataset_of([winter], summer))

    assert wrong(found) == [("error", "files", f"2 files of {summer} are empty (0 bytes): 005.png, 050.png")]


@pytest.mark.parametrize(
    ("content", "kind"),
    [
        (PAGE, "a web page"),
        (b"\xef\xbb\xbf\r\n<html>", "a web page"),
        (b'{"error": "quota exceeded"}', "a message of a server"),
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:00", "a Git LFS pointer, not the file it stands for"),
    ],
)
def test_what_a_failed_download_leaves_is_told_from_an_image(tmp_path: Path, content: bytes, kind: str) -> None:
    winter, summer = healthy(tmp_path)
    (summer / "031.png").write_bytes(content)

    assert wrong(quick(dataset_of([winter], summer))) == [("error", "files", f"1 file of {summer} is {kind}: 031.png")]


def test_web_pages_in_place_of_all_images_are_found_though_their_size_is_the_usual_one(tmp_path: Path) -> None:
    winter, summer = healthy(tmp_path)
    for name in NAMES:
        (summer / name).write_bytes(PAGE)

    ((_, check, text),) = wrong(quick(dataset_of([winter], summer)))

    assert check == "files"
    assert text.startswith(f"60 files of {summer} are a web page: 000.png, ")


def test_a_count_that_is_known_to_be_another_partition_is_an_error(tmp_path: Path) -> None:
    winter, summer = healthy(tmp_path)
    known = {"counts": (70,), "wrong_counts": {PLACES: "the partition of Olid et al., numbered otherwise"}}

    found = quick(dataset_of([winter], summer, **known))

    assert wrong(found) == [
        ("error", "count", f"{folder} holds 60 images: the partition of Olid et al., numbered otherwise")
        for folder in (winter, summer)
    ]


def test_fewer_images_than_a_whole_copy_are_only_noted(tmp_path: Path) -> None:
    winter, summer = healthy(tmp_path)

    found = quick(dataset_of([winter], summer, counts=(35_768,)))

    assert not wrong(found)
    assert notes(found, "count")[0] == f"{winter} holds 60 images; a whole copy has 35,768"


def test_more_images_than_a_whole_copy_are_a_warning(tmp_path: Path) -> None:
    winter, summer = healthy(tmp_path)

    found = quick(dataset_of([winter], summer, counts=(50, 55)))

    assert wrong(found)[0] == ("warning", "count", f"{winter} holds 60 images; a whole copy has 50 or 55")


def test_images_that_are_not_used_are_counted_and_the_black_ones_among_them(tmp_path: Path) -> None:
    winter, summer = healthy(tmp_path)
    tunnel = np.full((32, 64, 3), 3, np.uint8)
    for number in range(4):
        shutil.copy(winter / "000.png", winter / f"slow{number}.png")
    save(tmp_path / "tunnel", [tunnel] * 3)
    for number in range(3):
        shutil.copy(tmp_path / "tunnel" / "000.png", winter / f"tunnel{number}.png")
    (winter / "list.txt").write_text("no image")

    found = examined(winter, summer)

    assert not wrong(found)
    assert notes(found, "unused") == [
        "winter holds 67 images, of which the dataset uses 60 and leaves 7 out; of these 3 are black, as in tunnels"
    ]


def test_a_file_that_cannot_be_read_as_a_frame_and_is_not_used_is_noted(tmp_path: Path) -> None:
    winter, summer = healthy(tmp_path)
    (winter / "031.heic").touch()
    (winter / "list.csv").touch()

    found = quick(dataset_of([winter], summer))

    assert notes(found, "files") == [f"1 file of {winter} is no image that can be read, and not used: 031.heic"]


def test_the_cheap_checks_decode_nothing(tmp_path: Path) -> None:
    winter, summer = healthy(tmp_path)
    dataset = dataset_of([winter], summer)

    def refuse(number: int) -> Image:
        raise AssertionError(f"frame {number} was decoded")

    blind = Dataset(
        name="blind",
        references=Images(refuse, NAMES),
        places=dataset.places,
        queries=Images(refuse, NAMES),
        positives=dataset.positives,
        protocol=dataset.protocol,
        folders=dataset.folders,
    )

    assert quick(blind) == ()


def test_a_run_is_refused_with_one_line_for_the_first_error(tmp_path: Path) -> None:
    winter, summer = healthy(tmp_path)
    (winter / "000.png").write_bytes(b"")
    (summer / "000.png").write_bytes(PAGE)

    with pytest.raises(BadInput) as refused:
        insist(dataset_of([winter], summer))

    line = str(refused.value)
    assert line.startswith(f"dataset little: 1 file of {winter} is empty (0 bytes): 000.png: ")
    assert line.endswith("(1 more, which the doctor names)")
    assert "\n" not in line


def test_a_run_is_given_the_warnings_as_lines_and_no_notes(tmp_path: Path) -> None:
    folders = save(tmp_path / "winter", season(0)), save(tmp_path / "summer", season(1))

    lines = insist(dataset_of([folders[0]], folders[1], counts=(55,)))

    assert lines == tuple(f"{folder} holds 60 images; a whole copy has 55" for folder in folders)
