"""Raw RobotCar frames: processed when they are looked at, kept, and made anew where what was kept is something else."""

from __future__ import annotations

import json
import logging
from concurrent.futures import ThreadPoolExecutor
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest
from PIL import Image as PillowImage
from robotcar_download import (
    RECORDINGS,
    SMALL,
    STAMPS,
    TABLE,
    TINY,
    colour_of,
    grid,
    raw_folder,
    uniform,
    write_download,
    write_raw,
    write_table,
)

import vprbench.datasets.oxford_robotcar as robotcar
from vprbench.api.dataset import Dataset
from vprbench.cli import main
from vprbench.datasets.oxford_robotcar import kept
from vprbench.errors import BadInput
from vprbench.run.identity import fingerprint


@pytest.fixture(autouse=True)
def _small_camera(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(robotcar, "STEREO_LEFT", SMALL)
    monkeypatch.setenv("VPRBENCH_DATA", str(tmp_path / "no-downloads"))


@pytest.fixture
def root(tmp_path: Path) -> Path:
    return write_download(tmp_path / "robotcar")


@pytest.fixture
def processings(monkeypatch: pytest.MonkeyPatch) -> list[None]:
    """Grows by one whenever a raw frame is processed."""
    seen: list[None] = []
    process = kept.processed

    def counted(*arguments):
        seen.append(None)
        return process(*arguments)

    monkeypatch.setattr(kept, "processed", counted)
    return seen


def dataset(root: Path, **arguments) -> Dataset:
    return robotcar.oxford_robotcar(root=str(root), **{**TINY, **arguments})


def frame_path(root: Path, traverse: str, place: int) -> Path:
    return root / RECORDINGS[traverse] / "demosaiced" / f"{STAMPS[traverse][place]}.png"


def shows_all(found: Dataset) -> bool:
    """Whether references and queries are uniform in the colours of their traverses and places."""
    expected = [colour_of(traverse, place) for traverse in ("sun", "rain") for place in range(4)]
    expected += [colour_of("dusk", place) for place in (1, 2, 3)]
    seen = [*found.references, *found.queries]
    return all((image == uniform(colour)).all() for image, colour in zip(seen, expected, strict=True))


def test_nothing_is_processed_or_written_before_a_frame_is_looked_at(root: Path, processings: list[None]) -> None:
    before = sorted(root.rglob("*"))
    dataset(root)
    assert sorted(root.rglob("*")) == before
    assert not processings


def test_a_frame_is_processed_once_and_then_taken_from_where_it_is_kept(root: Path, processings: list[None]) -> None:
    assert shows_all(dataset(root))
    assert len(processings) == 11
    assert shows_all(dataset(root))
    assert len(processings) == 11


def test_kept_frames_are_colour_pngs_of_the_same_name_without_loss(root: Path) -> None:
    image = dataset(root).queries[0]
    path = frame_path(root, "dusk", 1)
    with PillowImage.open(path) as stored:
        assert (stored.format, stored.mode) == ("PNG", "RGB")
        np.testing.assert_array_equal(np.asarray(stored), image)
    assert sorted(entry.name for entry in path.parent.iterdir()) == [path.name, "vprbench.json"]
    record = json.loads((path.parent / "vprbench.json").read_text())
    assert record["calibration_sha256"] == sha256((root / "models" / TABLE).read_bytes()).hexdigest()
    assert (record["width"], record["height"], record["focal_lengths"]) == (16, 12, [9.0, 9.0])
    assert record["code_version"] == kept.VERSION


# What is made anew


def test_a_frame_whose_pixels_are_not_those_that_were_written_is_made_anew(root: Path) -> None:
    dataset(root).queries[0]
    path = frame_path(root, "dusk", 1)
    with PillowImage.open(path) as stored:
        text = kept.PngInfo()
        text.add_text("vprbench", stored.info["vprbench"])
    PillowImage.new("RGB", (16, 12), (1, 2, 3)).save(path, pnginfo=text)
    assert (dataset(root).queries[0] == uniform(colour_of("dusk", 1))).all()


def test_every_flip_of_a_bit_is_noticed_or_changes_no_pixel(root: Path) -> None:
    right = dataset(root).queries[0]
    path = frame_path(root, "dusk", 1)
    content = path.read_bytes()
    for at in range(0, len(content), 7):
        path.write_bytes(content[:at] + bytes([content[at] ^ (1 << at % 8)]) + content[at + 1 :])
        np.testing.assert_array_equal(dataset(root).queries[0], right)


def test_another_distortion_table_makes_the_frames_anew_and_so_does_the_first_one_again(
    root: Path, processings: list[None]
) -> None:
    noise = np.random.default_rng(0).integers(0, 256, (SMALL.height, SMALL.width), dtype=np.uint8)
    PillowImage.fromarray(noise).save(raw_folder(root, "dusk") / f"{STAMPS['dusk'][1]}.png")
    x, y = grid()
    straight = dataset(root).queries[0]
    write_table(root / "models", x + 1, y)
    np.testing.assert_array_equal(dataset(root).queries[0][:, :-1], straight[:, 1:])
    write_table(root / "models", x, y)
    np.testing.assert_array_equal(dataset(root).queries[0], straight)
    assert len(processings) == 3
    np.testing.assert_array_equal(dataset(root).queries[0], straight)
    assert len(processings) == 3


def test_frames_of_an_earlier_version_of_the_code_are_made_anew(
    root: Path, processings: list[None], monkeypatch: pytest.MonkeyPatch
) -> None:
    dataset(root).queries[0]
    monkeypatch.setattr(kept, "VERSION", kept.VERSION + 1)
    dataset(root).queries[0]
    assert len(processings) == 2


def test_the_fingerprint_is_of_the_raw_frames_and_the_table_and_not_of_what_is_kept(root: Path) -> None:
    before = fingerprint(dataset(root))
    [*dataset(root).references]
    assert fingerprint(dataset(root)) == before
    x, y = grid()
    write_table(root / "models", x, y + 1e-3)
    assert fingerprint(dataset(root)) != before


# Disks that refuse, and several at once


def test_a_file_in_the_place_of_the_folder_costs_a_warning_and_no_frame(
    root: Path, caplog: pytest.LogCaptureFixture
) -> None:
    for traverse in ("sun", "rain", "dusk"):
        frame_path(root, traverse, 0).parent.write_text("no folder")
    with caplog.at_level(logging.WARNING):
        found = dataset(root)
        assert shows_all(found)
        assert shows_all(found)
    (told,) = (record.getMessage() for record in caplog.records)
    assert "dataset.processed" in told


def test_another_folder_may_keep_the_frames_and_nothing_is_written_to_the_root(root: Path, tmp_path: Path) -> None:
    before = sorted(root.rglob("*"))
    aside = tmp_path / "aside"
    assert shows_all(dataset(root, processed=str(aside)))
    assert sorted(root.rglob("*")) == before
    assert (aside / RECORDINGS["dusk"] / f"{STAMPS['dusk'][1]}.png").is_file()


def test_many_threads_may_look_at_the_same_frames_at_once(root: Path) -> None:
    several = [dataset(root) for _ in range(4)]
    with ThreadPoolExecutor(8) as readers:
        images = [*readers.map(lambda i: several[i % 4].references[i % 8], range(64))]
    for i, image in enumerate(images):
        assert (image == uniform(colour_of("sun" if i % 8 < 4 else "rain", i % 4))).all()
    left = [path.name for path in frame_path(root, "sun", 0).parent.iterdir()]
    assert sorted(left) == sorted(["vprbench.json", *(f"{stamp}.png" for stamp in STAMPS["sun"])])


# Whose frames are taken


def write_processed(folder: Path, traverse: str, places: range = range(4)) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for place in places:
        PillowImage.new("RGB", (3, 2), (250, place, 0)).save(folder / f"{STAMPS[traverse][place]}.png")


@pytest.mark.parametrize("where", ["demosaiced", "traverse"])
def test_frames_that_somebody_processed_come_before_raw_ones_where_all_are_there(root: Path, where: str) -> None:
    write_processed(frame_path(root, "sun", 0).parent if where == "demosaiced" else root / "sun", "sun")
    found = dataset(root)
    assert [image[0, 0].tolist() for image in found.references[:4]] == [[250, place, 0] for place in range(4)]
    assert (found.references[4] == uniform(colour_of("rain", 0))).all()
    assert any(note.startswith("frames of sun: ") and "by somebody else" in note for note in found.notes)


def test_where_some_are_missing_raw_frames_are_taken_and_those_of_somebody_else_stay_as_they_are(root: Path) -> None:
    theirs = frame_path(root, "sun", 0).parent
    write_processed(theirs, "sun", range(2))
    before = {path: path.read_bytes() for path in theirs.iterdir()}
    assert shows_all(dataset(root))
    assert shows_all(dataset(root))
    assert {path: path.read_bytes() for path in theirs.iterdir() if path.is_file()} == before


def test_frames_that_were_kept_are_enough_without_the_raw_ones(root: Path) -> None:
    assert shows_all(dataset(root))
    for traverse in RECORDINGS:
        raw_folder(root, traverse).rename(root / f"moved-{traverse}")
    found = dataset(root)
    assert shows_all(found)
    assert "here before" in found.notes[0]


def test_kept_frames_of_two_tables_are_not_taken_for_one_set(root: Path) -> None:
    assert shows_all(dataset(root))
    x, y = grid()
    write_table(root / "models", x, y + 0.25)
    dataset(root).queries[0]
    raw_folder(root, "dusk").rename(root / "moved")
    with pytest.raises(BadInput, match="2 of 3 frames in"):
        dataset(root)


def test_a_colour_file_among_raw_frames_is_named_when_it_is_read(root: Path) -> None:
    path = raw_folder(root, "sun") / f"{STAMPS['sun'][2]}.png"
    PillowImage.new("RGB", (16, 12)).save(path)
    found = dataset(root)
    with pytest.raises(BadInput, match=f"{path} is of mode RGB"):
        list(found.references)


def test_raw_frames_of_a_traverse_that_is_map_and_query_are_read_for_both(tmp_path: Path) -> None:
    write_raw(tmp_path, "sun")
    write_table(tmp_path / "models", *grid())
    found = dataset(tmp_path, references=["sun"], query="sun")
    assert (found.queries[0] == found.references[1]).all()


def test_a_run_on_raw_frames_tells_tolerances_calibration_and_ceiling(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    quick = ["timing.minimum_seconds=0", "timing.sample=3", "timing.minimum_queries=3", "threads=1"]
    small = [f"dataset.{name}={value}" for name, value in TINY.items()]
    asked = ["method=sad", "dataset=oxford_robotcar", f"dataset.root={root}", f"results={tmp_path / 'results'}"]
    assert main([*asked, *small, *quick]) == 0
    told = capsys.readouterr().out
    assert "R@1 within 1, 2, 3 places: " in told
    assert "note: frames of sun, rain, dusk: " in told
    assert "can reach 100.00 %" in told


def test_a_raw_frame_that_was_replaced_is_processed_anew(root: Path) -> None:
    dataset(root).queries[0]
    source = raw_folder(root, "sun") / f"{STAMPS['sun'][3]}.png"
    (raw_folder(root, "dusk") / f"{STAMPS['dusk'][1]}.png").write_bytes(source.read_bytes())
    assert (dataset(root).queries[0] == uniform(colour_of("sun", 3))).all()
