"""VPRSNN's own list of RobotCar images: read whatever its head, refused where it is another one, and evaluated."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
import yaml
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
    path.write_text("".join(f"{line}\n" for line in lines))
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


def refusal(kind: type[BadInput], folder: Path) -> str:
    with pytest.raises(BadInput) as error:
        vprsnn_timestamps(folder, "sun")
    assert type(error.value) is kind
    message = str(error.value)
    assert "\n" not in message
    assert str(folder / "ORC_Sun_timestamps.csv") in message
    assert "https://github.com/QVPR/VPRSNN" in message
    return message


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


def test_a_missing_list_is_named_with_where_to_get_it(tmp_path: Path) -> None:
    assert "does not exist" in refusal(NotThere, tmp_path)


@pytest.mark.parametrize("kept", [0, 3369, 3875])
def test_a_list_of_another_length_is_refused_with_both_numbers(tmp_path: Path, kept: int) -> None:
    write_list(tmp_path, "sun", ["head", *column("{stamp}.png")[:kept]])
    assert f"lists {kept} images; VPRSNN's list has 3876" in refusal(BadInput, tmp_path)


def test_a_list_that_repeats_an_image_among_its_places_is_refused(tmp_path: Path) -> None:
    lines = column("{stamp}.png")
    lines[16] = lines[8]
    write_list(tmp_path, "sun", lines)
    assert "every 8th row names 449 distinct images among the first 450" in refusal(BadInput, tmp_path)


@pytest.mark.parametrize("line", ["000007.png,no stamp", "000007.png", "000007.png,143938827604532.png"])
def test_a_line_without_a_timestamp_is_named(tmp_path: Path, line: str) -> None:
    lines = column("{row:06d}.png,{stamp}.png")
    lines[7] = line
    write_list(tmp_path, "sun", lines)
    assert f"line 8: {line} names no image" in refusal(BadInput, tmp_path)


def test_a_file_that_is_no_text_is_refused(tmp_path: Path) -> None:
    write_list(tmp_path, "sun").write_bytes(b"\xff\xfe\x00\xd8" * 9)
    assert "cannot be read as a list" in refusal(BadInput, tmp_path)


# The dataset


def test_375_places_are_mapped_and_queried_and_75_held_out(root: Path) -> None:
    dataset = asked(root=str(root))
    assert (len(dataset.queries), dataset.n_places, len(dataset.references)) == (375, 375, 750)
    assert [right.tolist() for right in dataset.positives] == [[place] for place in range(375)]
    assert dataset.held_out is not None
    assert (len(dataset.held_out.queries), dataset.held_out.in_map) == (75, False)


def test_the_places_are_every_eighth_row_without_those_that_the_authors_set_aside(root: Path) -> None:
    aside = set(np.random.RandomState(42).permutation(450)[:75].tolist())
    wanted = [f"{stamps('dusk')[8 * place]}.png" for place in range(450) if place not in aside]
    assert list(asked(root=str(root)).queries.names) == wanted


def test_the_protocol_names_the_list_so_that_two_lists_are_never_taken_for_one(root: Path) -> None:
    protocol = asked(root=str(root)).protocol
    assert (protocol["protocol"], protocol["image_list"], protocol["stride"]) == ("vprsnn", "vprsnn", 8)
    assert (protocol["reference_places"], protocol["held_out_places"]) == (375, 75)
    assert protocol["also_tolerance_places"] == [1, 2, 3]


def test_the_list_can_be_chosen_by_its_option_too(root: Path) -> None:
    config = yaml.safe_load(registry.entries("dataset")["oxford_robotcar"].path.read_text("utf-8"))
    lists = {"image_list": "vprsnn", "stride": 8, "lists": str(root / "lists")}
    assert {*lists} <= {*config}
    dataset = registry.make_dataset({**config, **lists, "root": str(root)})
    assert dataset.queries.names[0] == f"{stamps('dusk')[8 * 90]}.png"


def test_lists_that_are_named_come_before_those_of_the_root(root: Path, tmp_path: Path) -> None:
    (root / "lists").rename(tmp_path / "mine")
    assert len(asked(root=str(root), lists=str(tmp_path / "mine")).queries) == 375


def test_lists_beside_the_download_serve_a_root_elsewhere(root: Path, tmp_path: Path) -> None:
    (tmp_path / "downloads" / "oxford_robotcar").mkdir(parents=True)
    (root / "lists").rename(tmp_path / "downloads" / "oxford_robotcar" / "lists")
    assert len(asked(root=str(root)).queries) == 375


def test_missing_lists_are_answered_with_where_they_belong(root: Path, tmp_path: Path) -> None:
    (root / "lists").rename(tmp_path / "away")
    with pytest.raises(NotThere, match=r"dataset\.lists") as error:
        asked(root=str(root))
    assert (
        f"ORC_{{Sun,Rain,Dusk}}_timestamps.csv from dataset_imagenames/ of https://github.com/QVPR/VPRSNN to {root}"
        in (str(error.value))
    )
