"""What the doctor finds in folders and frames: codes, numbers and names; docs/doctor.md shows the words."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from doctored import NAMES, PLACES, coded, dataset_of, examined, healthy, save, season
from PIL import Image as PillowImage

from vprbench.api.arrays import Image
from vprbench.api.dataset import Dataset
from vprbench.api.images import Images
from vprbench.data.doctor import Finding, as_text, command, examine, insist, quick
from vprbench.errors import BadInput, NotThere
from vprbench.progress import listening

PAGE = b"<!DOCTYPE html><html><body>Sign in to download</body></html>"
ALIGNED = "note alignment"

Damage = Callable[[Path, Path], dict[str, Any] | None]  # of winter and summer; what else the dataset is made of


def gone(winter: Path, summer: Path) -> None:
    shutil.rmtree(winter)


def pages(winter: Path, summer: Path) -> None:
    """Put pages of one size in place of all images."""
    for name in NAMES:
        (summer / name).write_bytes(PAGE)


def beside(winter: Path, summer: Path) -> None:
    for name in ("031.heic", "list.csv"):
        (winter / name).touch()


QUICK: dict[str, tuple[Damage, list[str]]] = {
    "nothing": (lambda winter, summer: None, []),
    "a folder that is gone": (gone, ["error files:"]),
    "pages in place of all images": (pages, ["error files: 60 000 001 002 003 004 55"]),
    "fewer images than a whole copy": (lambda *_: {"counts": (35_768,)}, ["note count: 60 35,768"] * 2),
    "more images than a whole copy": (lambda *_: {"counts": (50, 55)}, ["warning count: 60 50 55"] * 2),
    "a frame that cannot be read and a list": (beside, ["note files: 1 031"]),
}


@pytest.mark.parametrize("damage", QUICK)
def test_the_cheap_checks_find(damage: str, tmp_path: Path) -> None:
    winter, summer = healthy(tmp_path)
    spoil, expected = QUICK[damage]
    assert coded(quick(dataset_of([winter], summer, **(spoil(winter, summer) or {}))), tmp_path) == expected


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
    (found,) = quick(dataset_of([winter], summer))
    assert (found.level, found.check, found.text) == ("error", "files", f"1 file of {summer} is {kind}: 031.png")


def unused(winter: Path, summer: Path) -> None:
    """Leave seven images beside the frames, three of them black, and a list."""
    save(winter.parent / "tunnel", [np.full((32, 64, 3), 3, np.uint8)])
    for number in range(4):
        shutil.copy(winter / "000.png", winter / f"slow{number}.png")
    for number in range(3):
        shutil.copy(winter.parent / "tunnel" / "000.png", winter / f"tunnel{number}.png")
    (winter / "list.txt").write_text("no image")


def large_page(winter: Path, summer: Path) -> None:
    size = (winter / "017.png").stat().st_size
    (winter / "017.png").write_bytes(b"Service unavailable. ".ljust(size))


def no_frame(winter: Path, summer: Path) -> None:
    for name in NAMES:
        (winter / name).write_bytes(b"nothing")


def two_sizes(winter: Path, summer: Path) -> None:
    for name in NAMES[:20]:
        PillowImage.open(summer / name).resize((128, 64)).save(summer / name)


def small_and_red(winter: Path, summer: Path) -> None:
    shutil.rmtree(summer)
    red = np.array([1.0, 0.8, 0.6])
    save(summer, [(frame[::2, ::2] * red).astype(np.uint8) for frame in season(1)])


def uniform(winter: Path, summer: Path) -> None:
    for name in NAMES[20:23]:
        PillowImage.fromarray(np.full((32, 64, 3), 200, np.uint8)).save(summer / name)


def copied(winter: Path, summer: Path) -> None:
    shutil.copy(summer / "011.png", summer / "012.png")
    PillowImage.open(summer / "030.png").save(summer / "031.png", compress_level=0)  # other bytes, the same pixels
    shutil.copy(winter / "044.png", summer / "044.png")


def listed_twice(winter: Path, summer: Path) -> dict[str, Any]:
    return {"query_names": [*NAMES[:59], "010.png"], "right": [[place] for place in [*range(PLACES - 1), 10]]}


EXAMINED: dict[str, tuple[Damage, list[str]]] = {
    "nothing": (lambda winter, summer: None, []),
    "images that are not used": (unused, ["note unused: 67 60 7 3"]),
    "a page as large as an image": (large_page, ["error decoding: 1 60 017"]),
    "no frame of a traverse": (no_frame, ["error decoding: 60 60 000 001 002 003 004 55"]),
    "two sizes in one traverse": (two_sizes, ["note size: 2 64x32 40 128x64 20"]),
    "another size and colour": (small_and_red, ["note size: 64x32 32x16", "note colour:"]),
    "frames of one grey value": (uniform, ["warning black frames: 3 60 3 255 020 021 022"]),
    "frames that are the same": (
        copied,
        ["warning repeated frames: 2 011 012 030 031", "warning shared frames: 1 60 044 044"],
    ),
    "a name that the list repeats": (
        listed_twice,
        ["note names: 1 1 60 010", "note ground truth: 1 60", "note ground truth: 1 010", "note unused: 60 59 1"],
    ),
}


@pytest.mark.parametrize("damage", EXAMINED)
def test_the_look_at_every_frame_finds(damage: str, tmp_path: Path) -> None:
    winter, summer = healthy(tmp_path)
    spoil, expected = EXAMINED[damage]
    found = coded(examined(winter, summer, **(spoil(winter, summer) or {})), tmp_path)
    compared = [code for code in found if code.startswith(ALIGNED)]
    assert [code for code in found if code not in compared] == expected
    assert len(compared) == 1
    assert (compared == [f"{ALIGNED}: 0 20"]) == (damage == "no frame of a traverse")  # frames to compare, and needed


def test_two_reference_traverses_of_the_same_frames_are_an_error(tmp_path: Path) -> None:
    winter, summer = healthy(tmp_path)
    fall = save(tmp_path / "fall", season(0))
    first, *_ = coded(examine(dataset_of([winter, fall], summer)), tmp_path)
    assert first.startswith("error shared frames: 60 60 000 000 001 001")


def test_the_cheap_checks_decode_nothing(tmp_path: Path) -> None:
    winter, summer = healthy(tmp_path)
    dataset = dataset_of([winter], summer)

    def refuse(number: int) -> Image:
        raise AssertionError(f"frame {number} was decoded")

    blind = Images(refuse, NAMES)
    places, positives, protocol = dataset.places, dataset.positives, dataset.protocol
    assert quick(Dataset("blind", blind, places, blind, positives, protocol, folders=dataset.folders)) == ()


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
    winter, summer = healthy(tmp_path)
    lines = insist(dataset_of([winter], summer, counts=(55,)))
    assert lines == tuple(f"{folder} holds 60 images; a whole copy has 55" for folder in (winter, summer))


def test_progress_is_reported_for_each_traverse_up_to_its_end(tmp_path: Path) -> None:
    heard: dict[str, float] = {}
    with listening(lambda stage, done: heard.__setitem__(stage, done)):
        examined(*healthy(tmp_path))
    assert heard == {"looking at winter": 1.0, "looking at summer": 1.0}


# What the command prints


def test_long_text_is_broken_between_words_alone() -> None:
    path = "/data/a-very-long-path-that-must-stay-whole/" * 3
    text = as_text("little", [Finding("warning", "files", f"{'word ' * 30}{path}", "")])
    assert path in text
    assert all(len(line) <= 110 or path in line for line in text.splitlines())
    assert as_text("little", []).endswith("nothing is wrong: 0 errors, 0 warnings, 0 notes")


@pytest.mark.parametrize(
    ("damage", "code", "said"),
    [
        (lambda *_: {}, 0, ["note alignment"]),
        (lambda *_: {"counts": (55,)}, 1, ["warning count", "warning count", "note alignment"]),
        (lambda winter, summer: (summer / "007.png").write_bytes(b"") or {}, 1, ["error files", "note alignment"]),
        (lambda winter, summer: {"name": winter}, 1, ["error dataset"]),
    ],
    ids=["healthy", "a warning", "an error", "a dataset that cannot be built"],
)
def test_errors_and_warnings_exit_with_1(tmp_path: Path, damage: Damage, code: int, said: list[str]) -> None:
    winter, summer = healthy(tmp_path)
    changes = damage(winter, summer) or {}

    def build() -> Dataset:
        if "name" in changes:
            raise NotThere("winter/000.png is missing: get the frames")
        return dataset_of([winter], summer, **changes)

    lines: list[str] = []
    assert command("little", build, lines.append, "json") == code
    found = json.loads(lines[0])
    assert [f"{finding['level']} {finding['check']}" for finding in found] == said
    assert all({*finding} == {"level", "check", "text", "advice"} for finding in found)
