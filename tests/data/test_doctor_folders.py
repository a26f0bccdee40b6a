"""What the doctor finds in folders and frames: codes, numbers and names, and the words that docs/doctor.md shows."""

import json
import re
import shutil

import numpy as np
import pytest
from checkout import ROOT
from doctored import NAMES, PLACES, coded, dataset_of, healthy, save, season
from PIL import Image as PillowImage

from vprbench.data.doctor import as_text, check_dataset, command, examine, look_at_some
from vprbench.errors import BadInput, MissingData

PAGE = b"<!DOCTYPE html><html><body>Sign in to download</body></html>"
DOCUMENT = (ROOT / "docs" / "doctor.md").read_text(encoding="utf-8")
SHOWN = dict(re.findall(r"^## ([^\n]*)\n\n```\n(.*?)```", DOCUMENT, re.MULTILINE | re.DOTALL))
UNNAMED = [f"{place}.png" for place in range(PLACES)]  # 1, 10, 2 in a dictionary
OLID = "the partition of Olid et al., which numbers the frames in another way"


@pytest.fixture
def spoilt(tmp_path):
    """A function that returns the dataset of two healthy folders after some damage."""

    def spoilt(damage):
        winter, summer = healthy(tmp_path)
        besides = damage(winter, summer)
        return dataset_of(winter, summer, **(besides if isinstance(besides, dict) else {}))

    return spoilt


def again(folder, frames, names=None):
    shutil.rmtree(folder)
    save(folder, frames, names)


def change(folder, names, how, **options):
    """Store what becomes of the pixels of frames."""
    for name in names:
        pixels = how(np.asarray(PillowImage.open(folder / name)))
        PillowImage.fromarray(pixels.astype(np.uint8)).save(folder / name, **options)


def tag(folder, names):
    """Store frames upside down, with the EXIF tag that turns them back, in a dataset that ignores it."""
    exif = PillowImage.Exif()
    exif[0x0112] = 3
    change(folder, names, lambda pixels: pixels[::-1, ::-1], exif=exif)
    return {"protocol": {"exif": "ignore"}}


def write(folder, names, how):
    for name in names:
        (folder / name).write_bytes(how((folder / name).read_bytes()))


def of_frames(winter, summer, references, queries, names=None):
    """Store other frames; `names` are those of the places, and the queries come in the order of a dictionary."""
    again(winter, references, names)
    again(summer, queries, names)
    return {"names": names, "query_names": sorted(names)} if names else {}


LONGER = season(1, PLACES + 1)


DOCUMENTED = {
    "Missing files": lambda winter, summer: [(winter / name).unlink() for name in NAMES[10:17]],
    "Empty file": lambda _, summer: write(summer, NAMES[5:6], lambda _: b""),
    "Web page as .png": lambda _, summer: write(summer, NAMES[31:32], lambda _: PAGE),
    "Truncated": lambda _, summer: write(summer, NAMES[3:10], lambda whole: whole[:900]),
    "Other size": lambda winter, summer: change(summer, NAMES[40:42], lambda pixels: pixels[::2, ::2]),
    "Another partition": lambda *_: {"counts": (70,), "wrong_counts": {PLACES: OLID}},
    "Repeated frame": lambda winter, summer: shutil.copy(summer / "011.png", summer / "012.png"),
    "Black frames": lambda winter, summer: change(summer, NAMES[20:23], np.zeros_like),
    "Few levels": lambda winter, summer: change(summer, NAMES[7:9], lambda p: p // 16 * 16),
    "Tags that are ignored": lambda winter, summer: tag(summer, NAMES[50:]),
    "Shifted by 3": lambda winter, summer: again(summer, [*season(1)[3:], *season(1, PLACES + 3)[PLACES:]]),
    "A frame too few": lambda *both: of_frames(*both, season(0, PLACES + 1)[:PLACES], LONGER[:35] + LONGER[36:]),
    "Reversed": lambda winter, summer: again(summer, season(1)[::-1]),
    "Wrong season folder": lambda winter, summer: again(summer, season(0)),
    "Queries in the map": lambda winter, summer: shutil.copy(winter / "044.png", summer / "044.png"),
    "Lexicographic order": lambda *both: of_frames(*both, season(0), season(1), UNNAMED),
    "Query without right place": lambda *_: {"right": [[] if place in (4, 9) else [place] for place in range(PLACES)]},
}


@pytest.mark.parametrize("title", [*SHOWN, *sorted({*DOCUMENTED} - {*SHOWN})])
def test_the_document_shows_what_the_doctor_says(title, tmp_path, spoilt):
    said = []
    assert command("little", lambda: spoilt(DOCUMENTED[title]), said.append) == 1
    paragraphs = said[0].replace(str(tmp_path), "/data").split("\n\n")[1:]
    told = [" ".join(paragraph.split()) for paragraph in paragraphs]
    shown = [line for line in told if not line.startswith("note alignment: summer and winter are aligned")]
    assert " ".join(shown) == " ".join(SHOWN[title].split())


def copied(winter, summer):
    shutil.copy(summer / "011.png", summer / "012.png")
    PillowImage.open(summer / "030.png").save(summer / "031.png", compress_level=0)  # other bytes, the same pixels
    shutil.copy(winter / "044.png", summer / "044.png")


LFS = b"version https://git-lfs.github.com/spec/v1"
EXAMINED = {
    "a page as large as an image": (
        lambda winter, _: write(winter, ["017.png"], lambda whole: b"Service unavailable. ".ljust(len(whole))),
        ["error decoding: 1 60 017"],
    ),
    "a Git LFS pointer": (lambda winter, _: write(winter, ["031.png"], lambda _: LFS), ["error decoding: 1 60 031"]),
    "no frame of a traverse": (
        lambda winter, _: write(winter, NAMES, lambda _: b"nothing"),
        ["error decoding: 60 60 000 001 002 003 004 55"],
    ),
    "two sizes in one traverse": (
        lambda _, summer: change(summer, NAMES[:20], lambda p: p.repeat(2, 0).repeat(2, 1)),
        ["note size: 20 64x32 40 000 001 002 003 004 15"],
    ),
    "frames of one grey value": (
        lambda _, summer: change(summer, NAMES[20:23], lambda p: 0 * p + 200),
        ["warning black frames: 3 60 3 255 020 021 022"],
    ),
    "frames that are the same": (
        copied,
        ["error shared frames: 1 60 044 044", "warning repeated frames: 2 011 012 030 031"],
    ),
}


@pytest.mark.parametrize("damage", EXAMINED)
def test_the_look_at_every_frame_finds(damage, tmp_path, spoilt):
    spoil, expected = EXAMINED[damage]
    *found, compared = sorted(coded(examine(spoilt(spoil)), tmp_path), key=lambda code: code.startswith("note align"))
    assert found == expected
    assert (compared == "note alignment: 0 20") == (damage == "no frame of a traverse")  # frames to compare, and needed


def test_a_run_is_refused_with_one_line_for_the_first_error_and_given_warnings_but_no_notes(tmp_path, spoilt):
    lines = check_dataset(spoilt(lambda *_: {"counts": (55,)}))
    assert lines == tuple(f"{tmp_path / one} holds 60 images; a whole copy has 55" for one in ("winter", "summer"))
    for folder in ("winter", "summer"):
        write(tmp_path / folder, ["000.png"], lambda _: b"")
    with pytest.raises(BadInput) as refused:
        check_dataset(dataset_of(tmp_path / "winter", tmp_path / "summer"))
    line = str(refused.value)
    assert line.startswith(f"dataset little: 1 file of {tmp_path / 'winter'} is empty (0 bytes): 000.png: ")
    assert line.endswith("(1 more, which the doctor names)")


def test_sound_frames_exit_with_0_and_a_dataset_that_cannot_be_built_with_1(spoilt):
    def nothing():
        raise MissingData("winter/000.png is missing: get the frames")

    for build, code, said in ((lambda: spoilt(lambda *_: {}), 0, "note alignment"), (nothing, 1, "error dataset")):
        lines = []
        assert command("little", build, lines.append, "json") == code
        (finding,) = json.loads(lines[0])
        assert f"{finding['level']} {finding['check']}" == said
        assert {*finding} == {"level", "check", "text", "advice"}
    assert as_text("little", []).endswith("nothing is wrong: 0 errors, 0 warnings, 0 notes")


@pytest.mark.parametrize(
    ("spoil", "counts"),
    [
        (lambda *_: None, []),
        (
            lambda winter, summer: (
                change(winter, NAMES[:4], np.zeros_like),
                change(summer, NAMES[8:9], lambda p: 0 * p + 200),
            ),
            ["4 60", "1 60"],
        ),
        (DOCUMENTED["Truncated"], ["7 60"]),
    ],
)
def test_a_look_at_some_frames_counts_those_that_show_nothing_or_cannot_be_read(spoil, counts, spoilt):
    assert [" ".join(re.findall(r"\d+", line)) for line in look_at_some(spoilt(spoil))] == counts
