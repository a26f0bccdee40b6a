"""A run whose queries are among its references says how many, and nothing is encoded before somebody allows it."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

import vprbench
from vprbench.cli import main
from vprbench.errors import BadInput

PLACES = 12
QUICK = ["method=sad", "timing=none", "threads=1", "frames=false", "output=json"]


DAY = np.random.default_rng(0).integers(0, 256, (PLACES, 24, 32), np.uint8)
NIGHT = DAY[:, ::-1]
TWICE = ["dataset=folders", "dataset.references=[day]", "dataset.queries=day"]
COPIES = ["dataset=folders", "dataset.references=[night,day]", "dataset.queries=copies"]  # under other names


@pytest.fixture(autouse=True)
def drive(tmp_path, monkeypatch):
    """Run in a folder with the frames of a day and of a night."""
    monkeypatch.chdir(tmp_path)
    for folder, name, frames in (("day", "", DAY), ("night", "", NIGHT), ("copies", "other", DAY)):
        Path(folder).mkdir()
        for k, frame in enumerate(frames):
            cv2.imwrite(f"{folder}/{name}{k:02}.png", frame)


@pytest.mark.usefixtures("surroundings")
@pytest.mark.parametrize("options", [TWICE, COPIES])
def test_queries_of_files_in_the_map_are_refused_by_their_number_and_asked_with_a_note_where_allowed(options, capsys):
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
        ("day", DAY, 12),  # files against arrays of them
        ("day", NIGHT, 0),
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
    assert main(["doctor", *TWICE, "output=json"]) == 1
    assert [one["level"] for one in json.loads(capsys.readouterr().out) if one["check"] == "shared frames"] == ["error"]
    assert main(["doctor", *TWICE, "dataset.shared_frames=allow", "output=json"]) == 1
    found = [one["level"] for one in json.loads(capsys.readouterr().out) if one["check"] == "shared frames"]
    assert found == ["warning"]
