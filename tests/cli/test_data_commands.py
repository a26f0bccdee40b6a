"""The commands about data: what they print, and the exit code that a script sees."""

import json

import numpy as np
import pytest
from PIL import Image as PillowImage

from vprbench.cli import main
from vprbench.data import fetch

N_FRAMES = 24


@pytest.fixture
def drives(tmp_path):
    """Two drives of the same places, the second a little lighter."""
    pixels = np.random.default_rng(5).integers(0, 200, (N_FRAMES, 16, 32, 3), dtype=np.uint8)
    for name, light in (("monday", 0), ("friday", 20)):
        (tmp_path / name).mkdir()
        for number, frame in enumerate(pixels):
            PillowImage.fromarray(frame + np.uint8(light)).save(tmp_path / name / f"{number:03}.png")
    return tmp_path


def test_the_doctor_exits_with_0_for_sound_frames_and_names_a_damaged_one_at_which_a_run_stops_too(drives, capsys):
    frames = ["dataset=folders", f"dataset.references=[{drives / 'monday'}]", f"dataset.queries={drives / 'friday'}"]
    assert main(["doctor", *frames]) == 0
    told = capsys.readouterr().out
    assert told.startswith(f"folders: {drives / 'monday'}, {drives / 'friday'}\n")
    assert told.rstrip().splitlines()[-1].startswith("nothing is wrong: 0 errors, 0 warnings")
    frame = drives / "friday" / "007.png"
    frame.write_bytes(frame.read_bytes()[:-40])
    assert main(["doctor", *frames, "output=json"]) == 1
    found = [each for each in json.loads(capsys.readouterr().out) if each["level"] == "error"]
    assert [(each["check"], "007.png" in each["text"]) for each in found] == [("decoding", True)]
    frame.write_bytes(b"")
    assert main(["method=sad", *frames, f"results={drives / 'results'}"]) == 2
    assert "007.png" in capsys.readouterr().err
    assert main(["doctor", "dataset=nordland"]) == 1
    assert "python -m vprbench fetch nordland" in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize(("empty", "code"), [(False, 0), (True, 1)])
def test_fetch_exits_with_1_where_frames_that_came_are_not_right(empty, code, tmp_path, monkeypatch, capsys):
    for folder in ("query", "ref"):
        (tmp_path / folder).mkdir()
        for number in range(3):
            PillowImage.new("RGB", (4, 4), (number, 0, 0)).save(tmp_path / folder / f"{number}.jpg")
    (tmp_path / "ground_truth.csv").write_text("query,matching_refs\n0,0\n1,1\n2,2\n")
    if empty:
        (tmp_path / "ref" / "1.jpg").write_bytes(b"")

    def fetched(arguments, check):
        print("\n".join(check("corridor", tmp_path)))
        return 0

    monkeypatch.setattr(fetch, "fetch_command", fetched)
    assert main(["fetch", "corridor"]) == code
    assert ("1 file" in capsys.readouterr().out) == empty
