"""VPRSNN's own list of RobotCar images: read whatever its head, refused where it is another one, and evaluated."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
import yaml
from image_folders import answer, rights
from PIL import Image as PillowImage

from vprbench.api.dataset import Dataset
from vprbench.datasets.oxford_robotcar.lists import RECORDINGS, vprsnn_timestamps
from vprbench.errors import BadInput, NotThere
from vprbench.plugins import registry

START = {"sun": 1439388276045321, "rain": 1446121117630140, "dusk": 1416586027583964}
ROWS = 3876


@pytest.fixture(autouse=True)
def _no_downloads(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("VPRBENCH_DATA", str(tmp_path / "downloads"))


def stamps(traverse: str) -> list[int]:
    """The timestamps of a made-up list: a row repeats the one before it now and then, but none of every eighth."""
    return [START[traverse] + 1000 * (row - (row % 8 == 3)) for row in range(ROWS)]


def write_list(folder: Path, traverse: str, lines: list[str] | None = None) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"ORC_{traverse.capitalize()}_timestamps.csv"
    named = [f"{row:06d}.png,{stamp}.png" for row, stamp in enumerate(stamps(traverse))]
    lines = ["Image from this repo,Image from ORC", *named] if lines is None else lines
    path.write_text("".join(f"{line}\n" for line in lines), errors="surrogateescape")
    return path


def column(lines: str) -> list[str]:
    """Lines of the same stamps in other words."""
    return [lines.format(row=row, stamp=stamp) for row, stamp in enumerate(stamps("sun"))]


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """The lists, and one processed frame under all the names that are wanted."""
    root = tmp_path / "robotcar"
    for traverse in RECORDINGS:
        write_list(root / "lists", traverse)
        (root / traverse).mkdir()
        PillowImage.new("RGB", (3, 2)).save(root / traverse / "frame.png")
        for stamp in stamps(traverse)[:3600:8]:
            os.link(root / traverse / "frame.png", root / traverse / f"{stamp}.png")
    return root


def asked(**arguments) -> Dataset:
    config = yaml.safe_load(registry.entries("dataset")["oxford_robotcar_vprsnn"].path.read_text("utf-8"))
    return registry.make_dataset({**config, **arguments})


# Reading


@pytest.mark.parametrize(
    "lines",
    [
        ["Image from this repo,Image from ORC", *column("{row:06d}.png,{stamp}.png")],
        column("{stamp}"),
        ["", "stamp", *column(" {stamp}.png "), ""],
        ["a,b,c", *column('{row},"{stamp}",x')],
        ["\ufeffname,index", *column("{stamp}.png,{row}")],
    ],
    ids=["as published", "no head", "blanks", "quoted", "byte order mark"],
)
def test_the_column_of_timestamps_is_found_whatever_stands_beside_and_above_it(
    tmp_path: Path, lines: list[str]
) -> None:
    write_list(tmp_path, "sun", lines)
    assert vprsnn_timestamps(tmp_path, "sun") == stamps("sun")


NAMED = column("{row:06d}.png,{stamp}.png")
PLAIN = column("{stamp}.png")


@pytest.mark.parametrize(
    ("lines", "told"),
    [
        (["head", *PLAIN[:3875]], "lists 3875 images; VPRSNN's list has 3876"),
        (["head"], "lists 0 images"),
        ([*PLAIN[:16], PLAIN[8], *PLAIN[17:]], "every 8th row names 449 distinct images among the first 450"),
        ([*NAMED[:7], "000007.png,no stamp", *NAMED[8:]], "line 8: 000007.png,no stamp names"),
        ([*NAMED[:7], "000007.png", *NAMED[8:]], "line 8: 000007.png names"),
        ([*NAMED[:7], "000007.png,143938827604532.png", *NAMED[8:]], "line 8: "),
        (["\0\udcff"], "cannot be read as a list"),
        (None, "does not exist"),
    ],
    ids=["too short", "empty", "a repeat", "no stamp", "a cell", "a short stamp", "no text", "missing"],
)
def test_another_list_is_refused_with_where_to_get_the_right_one(
    tmp_path: Path, lines: list[str] | None, told: str
) -> None:
    if lines:
        write_list(tmp_path, "sun", lines)
    message = answer(vprsnn_timestamps, tmp_path, "sun", kind=BadInput if lines else NotThere)
    assert f"{tmp_path / 'ORC_Sun_timestamps.csv'}" in message
    assert told in message
    assert "https://github.com/QVPR/VPRSNN" in message


# The dataset


def test_the_places_are_every_eighth_row_without_those_that_the_authors_set_aside(root: Path) -> None:
    dataset = asked(root=str(root))
    aside = set(np.random.RandomState(42).permutation(450)[:75].tolist())
    wanted = [f"{stamps('dusk')[8 * place]}.png" for place in range(450) if place not in aside]
    assert list(dataset.queries.names) == wanted
    assert (len(dataset.queries), dataset.n_places, len(dataset.references)) == (375, 375, 750)
    assert rights(dataset) == [[place] for place in range(375)]
    assert (dataset.protocol["protocol"], dataset.protocol["image_list"]) == ("vprsnn", "vprsnn")
    assert (dataset.protocol["held_out_places"], dataset.protocol["also_tolerance_places"]) == (75, [1, 2, 3])


@pytest.mark.parametrize("named", [True, False], ids=["named", "beside the download"])
def test_lists_may_lie_outside_of_the_root(root: Path, tmp_path: Path, named: bool) -> None:
    elsewhere = tmp_path / "downloads" / "oxford_robotcar" / "lists"
    elsewhere.parent.mkdir(parents=True)
    (root / "lists").rename(elsewhere)
    assert len(asked(root=str(root), lists=str(elsewhere) if named else None).queries) == 375


def test_missing_lists_are_answered_with_where_they_belong(root: Path, tmp_path: Path) -> None:
    (root / "lists").rename(tmp_path / "away")
    message = answer(asked, root=str(root), kind=NotThere)
    assert "dataset.lists" in message
    assert f"https://github.com/QVPR/VPRSNN to {root}" in message
