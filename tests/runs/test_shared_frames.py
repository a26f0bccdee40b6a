"""A run whose queries are among its references says how many, and nothing is encoded before somebody allows it."""

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

import vprbench
from vprbench.cli import main
from vprbench.errors import BadInput

PLACES = 12
QUICK = ["method=sad", "timing=none", "threads=1", "frames=false", "output=json"]


def textures():
    """Return frames of a day and the same frames at night, with noise, (12, 48, 64) each."""
    drawn = np.random.default_rng(0)
    cells = [drawn.integers(0, 256, (6, 8)).astype(np.float32) for _ in range(PLACES)]
    day = np.clip([cv2.resize(each, (64, 48), interpolation=cv2.INTER_CUBIC) for each in cells], 0, 255)
    night = np.clip(day + drawn.normal(0, 20, day.shape), 0, 255)
    return day.astype(np.uint8), night.astype(np.uint8)


DAY, NIGHT = textures()


def written(folder, frames, name="@{east}@4180000.0@{k}@.png"):
    folder.mkdir(parents=True, exist_ok=True)
    for k, frame in enumerate(frames):
        cv2.imwrite(str(folder / name.format(k=f"{k:02}", east=500_000.0 + 100 * k)), frame)
    return folder


@pytest.fixture(autouse=True)
def drive(tmp_path, monkeypatch):
    """Run in a folder with the frames of a day and of a night."""
    monkeypatch.chdir(tmp_path)
    written(Path("data/day"), DAY)
    written(Path("data/night"), NIGHT)


def folder_twice():
    return ["dataset=folders", "dataset.references=[data/day]", "dataset.queries=data/day"]


def copies_under_other_names():
    for k, file in enumerate(sorted(Path("data/day").iterdir())):
        Path("copies").mkdir(exist_ok=True)
        shutil.copy(file, f"copies/frame{k:03}.png")
    return ["dataset=folders", "dataset.references=[data/night,data/day]", "dataset.queries=copies"]


@pytest.mark.usefixtures("surroundings")
@pytest.mark.parametrize(
    "made",
    [folder_twice, copies_under_other_names],
)
def test_queries_of_files_in_the_map_are_refused_by_their_number_and_asked_with_a_note_where_allowed(made, capsys):
    options = made()
    assert main([*QUICK, *options]) == 2
    told = capsys.readouterr().err
    assert (f"{PLACES} of {PLACES}" in told, "dataset.shared_frames=allow" in told) == (True, True)
    assert [*Path("results").rglob("run.json")] == []
    assert main([*QUICK, *options, "dataset.shared_frames=allow"]) == 0
    run = json.loads(capsys.readouterr().out)
    assert run["protocol"]["shared_frames"] == "allow"
    assert [f"{PLACES} of {PLACES}" in note["text"] for note in run["notes"] if note["kind"] == "dataset"] == [True]


@pytest.mark.parametrize(
    ("references", "queries", "shared"),
    [
        (DAY, DAY, 12),
        (DAY, np.concatenate([NIGHT[:10], DAY[10:]]), 2),
        (DAY, np.repeat(DAY[..., None], 3, axis=3), 12),  # grey, and the same as colours
        ("data/day", DAY, 12),  # files against arrays of them
        ("data/day", NIGHT, 0),
        (np.concatenate([DAY[:10], np.zeros_like(DAY[:2])]), np.concatenate([NIGHT[:9], np.zeros_like(DAY[:3])]), 0),
        (np.full_like(DAY, 255), np.full_like(DAY, 255), 0),  # say nothing of a place: snow on the lens
    ],
)
def test_shared_images_of_a_program_are_counted_by_their_pixels_and_dark_ones_pass(references, queries, shared):
    def run(**options):
        made = vprbench.dataset_of(references, queries, **options)
        return vprbench.run("sad", made, timing="none", results=None, threads=1).run

    if not shared:
        assert "shared_frames" not in run().protocol
        return
    with pytest.raises(BadInput, match=f"{shared} of 12 .* shared_frames='allow'"):
        run()
    assert any(f"{shared} of 12 " in note.text for note in run(shared_frames="allow").notes)


def test_the_doctor_calls_it_an_error_and_where_it_is_allowed_a_warning(capsys):
    assert main(["doctor", *folder_twice(), "output=json"]) == 1
    assert [one["level"] for one in json.loads(capsys.readouterr().out) if one["check"] == "shared frames"] == ["error"]
    assert main(["doctor", *folder_twice(), "dataset.shared_frames=allow", "output=json"]) == 1
    found = [one["level"] for one in json.loads(capsys.readouterr().out) if one["check"] == "shared frames"]
    assert found == ["warning"]
