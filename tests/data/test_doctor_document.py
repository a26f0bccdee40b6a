"""What docs/doctor.md shows is what the doctor says of frames with that damage."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from checkout import ROOT
from doctored import NAMES, PLACES, dataset_of, healthy, save, season
from PIL import Image as PillowImage

from vprbench.data.doctor import command

DOCUMENT = (ROOT / "docs" / "doctor.md").read_text(encoding="utf-8")
SHOWN = dict(re.findall(r"^## ([^\n]*)\n\n```\n(.*?)```", DOCUMENT, re.MULTILINE | re.DOTALL))
UNNAMED = [f"{place}.png" for place in range(PLACES)]  # 1, 10, 2 in a dictionary

Damage = Callable[[Path, Path], dict[str, Any] | None]  # of winter and summer; what else the dataset is made of


def again(folder: Path, frames: list[Any], names: list[str] | None = None) -> None:
    shutil.rmtree(folder)
    save(folder, frames, names)


def missing(winter: Path, summer: Path) -> None:
    for name in NAMES[10:17]:
        (winter / name).unlink()


def truncated(winter: Path, summer: Path) -> None:
    for name in NAMES[3:10]:
        (summer / name).write_bytes((summer / name).read_bytes()[:900])


def other_size(winter: Path, summer: Path) -> None:
    for name in NAMES[40:42]:
        PillowImage.open(summer / name).resize((32, 16)).save(summer / name)


def black(winter: Path, summer: Path) -> None:
    for name in NAMES[20:23]:
        PillowImage.fromarray(np.zeros((32, 64, 3), np.uint8)).save(summer / name)


def too_few(winter: Path, summer: Path) -> None:
    again(winter, season(0, PLACES + 1)[:PLACES])
    frames = season(1, PLACES + 1)
    again(summer, frames[:35] + frames[36:])


def dictionary_order(winter: Path, summer: Path) -> dict[str, Any]:
    again(winter, season(0), UNNAMED)
    again(summer, season(1), UNNAMED)
    return {"names": UNNAMED, "query_names": sorted(UNNAMED)}


def other_partition(winter: Path, summer: Path) -> dict[str, Any]:
    meaning = "the partition of Olid et al., which numbers the frames in another way"
    return {"counts": (70,), "wrong_counts": {PLACES: meaning}}


def repeated(winter: Path, summer: Path) -> None:
    shutil.copy(summer / "011.png", summer / "012.png")


def without_right_place(winter: Path, summer: Path) -> dict[str, Any]:
    return {"right": [[] if place in (4, 9) else [place] for place in range(PLACES)]}


def empty(winter: Path, summer: Path) -> None:
    (summer / "005.png").write_bytes(b"")


def web_page(winter: Path, summer: Path) -> None:
    (summer / "031.png").write_bytes(b"<!DOCTYPE html><html>Sign in</html>")


DAMAGES: dict[str, Damage] = {
    "Missing files": missing,
    "Empty file": empty,
    "Web page as .png": web_page,
    "Truncated": truncated,
    "Other size": other_size,
    "Another partition": other_partition,
    "Repeated frame": repeated,
    "Black frames": black,
    "Shifted by 3": lambda winter, summer: again(summer, [*season(1)[3:], *season(1, PLACES + 3)[PLACES:]]),
    "A frame too few": too_few,
    "Reversed": lambda winter, summer: again(summer, season(1)[::-1]),
    "Wrong season folder": lambda winter, summer: again(summer, season(0)),
    "Lexicographic order": dictionary_order,
    "Query without right place": without_right_place,
}


def test_all_that_is_shown_is_made_here() -> None:
    assert [*SHOWN] == [*DAMAGES]


@pytest.mark.parametrize("title", DAMAGES)
def test_the_document_shows_what_the_doctor_says(title: str, tmp_path: Path) -> None:
    winter, summer = healthy(tmp_path)
    besides = DAMAGES[title](winter, summer) or {}
    said: list[str] = []
    assert command("little", lambda: dataset_of([winter], summer, **besides), said.append) == 1
    paragraphs = said[0].replace(str(tmp_path), "/data").split("\n\n")[1:]
    aligned = "note alignment: summer and winter are aligned"
    told = [" ".join(paragraph.split()) for paragraph in paragraphs]
    assert " ".join(line for line in told if not line.startswith(aligned)) == " ".join(SHOWN[title].split())
