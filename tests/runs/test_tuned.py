"""What a yaml says of the places its settings were chosen on stands with every run, wherever that is shown."""

import hashlib
import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from figure_runs import run
from PIL import Image as PillowImage
from plugged_in import see_yamls

import vprbench
from vprbench.cli import main
from vprbench.config import make_request
from vprbench.datasets.nordland import published_frames
from vprbench.runs.store import Store
from vprbench.runs.tuned import describe_tuning, overlaps_tuning_places, without_tuning_places
from vprbench.runs.views import replace_scores

NOT_TUNED = "_target_: vprbench.methods.sad.SAD\npatch: 5\n"
QUICK = ["dataset.places=20", "dataset.first_query_place=2", "timing=none", "threads=1", "frames=false"]


@pytest.fixture
def plug_in(tmp_path, monkeypatch):
    """Return what registers a yaml of another package; runs are made in an empty folder."""
    monkeypatch.chdir(tmp_path)
    write = see_yamls(tmp_path / "conf", monkeypatch)
    write("mine", NOT_TUNED)
    write("upper", "defaults: [mine, _self_]\nwidth: 14\n")
    return write


def printed(capsys, *options):
    capsys.readouterr()
    assert main(["method=upper", *options, *QUICK]) == 0
    return capsys.readouterr().out


def told_elsewhere(text):
    """Return how many queries of other places a note names."""
    found = re.search(r"queries elsewhere: (\d+) of", text)
    return found and int(found[1])


@pytest.mark.usefixtures("surroundings")
def test_a_run_prints_and_keeps_on_what_its_method_was_tuned(plug_in, capsys):
    told = json.loads(printed(capsys, "output=json"))
    assert (told["tuned_on"], [note for note in told["notes"] if note["kind"] == "tuned"]) == (None, [])
    assert {told[name] for name in told if "elsewhere" in name} == {None}
    shutil.rmtree("results")
    plug_in("mine", f"{NOT_TUNED}tuned_on: {{dataset: synthetic, places: 5-11}}\n")
    lines = printed(capsys, "wide=true").splitlines()
    line = next(line for line in lines if line.startswith("note: tuned on places 5-11 of synthetic"))
    told = json.loads(printed(capsys, "output=json"))
    assert (told["notes"][0], told["from_store"]) == ({"kind": "tuned", "text": line[6:]}, True)
    (now,) = Store(Path("results")).runs()
    assert told["tuned_on"] == now.tuned_on == {"dataset": "synthetic", "places": "5-11", "also_in": {}}
    assert "tuned_on" not in now.config["method"]
    there = []  # the chance of each query of no tuned place that its best place is right
    for number, scores, right in zip(range(2, 20), now.scores, now.positives, strict=True):
        best = np.flatnonzero(scores == scores.max())
        there += [] if number in range(5, 12) else [np.isin(best, right).mean()]
    numbers = [told[f"recall_at_1_elsewhere{end}"] for end in ("", "_low", "_high")]
    assert (numbers[0], told["queries_elsewhere"]) == (pytest.approx(np.mean(there)), len(there))
    assert told_elsewhere(line) == 11
    row = "{:.1f} [{:.1f}, {:.1f}]".format(*(100 * number for number in numbers))
    assert any(f" elsewhere {row} " in line for line in lines)


def test_the_command_line_cannot_change_it_and_what_is_no_declaration_is_refused_by_its_yaml(plug_in, capsys):
    for options, declared, named in (
        (["method=upper", "method.tuned_on=null"], "{dataset: a, places: b}", "method.tuned_on"),
        (["method=mine"], "nordland", "mine"),
        (["method=mine"], "{dataset: a, places: b, colour: red}", "mine"),
    ):
        plug_in("mine", f"{NOT_TUNED}tuned_on: {declared}\n")
        assert main([*options, *QUICK]) == 2
        error = capsys.readouterr().err
        assert (named in error, "tuned_on" in error, error.count("\n")) == (True, True, 1)
        assert list(Store(Path("results")).runs()) == []


@pytest.mark.parametrize(
    ("changes", "tuned", "others"),
    [
        ({}, True, 32),
        ({"tuned_on": {"dataset": "nordland", "places": "0-99", "also_in": {"synthetic": "8-11"}}}, True, 36),
        ({"positives": [[i + 2] for i in range(40)], "place_numbers": np.arange(42)}, True, 34),
        ({"place_numbers": 2 * np.arange(40)}, True, 36),
        ({"dataset_arguments": {"references": ["winter"], "places": 99, "root": "/a", "on_disk": ["root"]}}, True, 32),
        ({"dataset": "synthetic_2"}, False, None),
        ({"tuned_on": {"dataset": "synthetic", "places": "every second place"}}, True, None),
        ({"tuned_on": {}}, False, None),
    ],
)
def test_queries_of_tuned_places_are_told_by_their_numbers_and_all_are_suspected_where_these_are_not_known(
    changes, tuned, others
):
    given = {"dataset": "synthetic", "tuned_on": {"dataset": "synthetic", "places": "0-7"}, **changes}
    right = given.pop("positives", [[i] for i in range(40)])
    made = run("mine", 0.5, 40, 40, **given, positives=tuple(map(np.array, right)))
    left = without_tuning_places(made)
    assert (overlaps_tuning_places(made), left and len(left.outcome)) == (tuned, others)
    assert bool(describe_tuning([made])) == tuned
    assert (told_elsewhere(describe_tuning([made])) or None) == others


def test_an_answer_that_rests_on_neighbours_is_of_a_tuned_place_if_one_of_them_is():
    made = run("mine", 0.5, 40, 40, dataset="synthetic", tuned_on={"dataset": "synthetic", "places": "10-19"})
    left = without_tuning_places(replace_scores(made, np.asarray(made.scores), {"sequence": 4}, window=4))
    assert [int(right[0]) for right in left.positives] == [*range(7), *range(23, 40)]


RIDE = {
    season: np.random.default_rng(number).integers(0, 256, (8, 24, 32, 3), np.uint8)
    for number, season in enumerate(("winter", "summer"))
}


@pytest.fixture
def ride(tmp_path, plug_in):
    """Return the folder of two traverses of eight places, of which the first three tuned the method `mine`."""
    lines = ["# file and pixels of winter and summer"]
    for place in range(8):
        codes = []
        for season, frames in RIDE.items():
            path = tmp_path / season / f"{place}.png"
            path.parent.mkdir(exist_ok=True)
            PillowImage.fromarray(frames[place]).save(path)
            codes += [path.read_bytes(), b"(24, 32, 3)" + frames[place].tobytes()]
        lines += [" ".join(hashlib.sha256(code).hexdigest()[:12] for code in codes)] * (place < 3)
    (tmp_path / "conf" / "shared" / "tuned_frames").mkdir(parents=True)
    (tmp_path / "conf" / "shared" / "tuned_frames" / "ride.txt").write_text("\n".join(lines), encoding="utf-8")
    plug_in("mine", f"{NOT_TUNED}tuned_on: {{dataset: ride, places: 0-2}}\n")
    return tmp_path


def copies(folder, season):
    """Copy frames under other names, in another order of places, into a folder."""
    folder.mkdir()
    for place in range(8):
        shutil.copy(folder.parent / season / f"{place}.png", folder / f"frame{7 - place}.png")
    return folder


@pytest.mark.usefixtures("surroundings")
@pytest.mark.parametrize(
    ("made", "others"),
    [
        (lambda at: (at / "winter", at / "summer"), 5),
        (lambda at: (copies(at / "a", "winter"), copies(at / "b", "summer")), 5),
        (lambda at: ([*RIDE["winter"]], [*RIDE["summer"]]), 5),
        (lambda at: ([255 - frame for frame in RIDE["winter"]], [255 - frame for frame in RIDE["summer"]]), None),
        (lambda at: (RIDE["winter"][3:], RIDE["summer"][3:]), None),
    ],
)
def test_frames_of_the_tuning_are_known_by_their_content_in_folders_lists_and_arrays(ride, made, others):
    options = {"timing": "none", "results": None, "threads": 1}
    (row,) = vprbench.compare(["mine"], vprbench.dataset_of(*made(ride)), **options).results
    left = without_tuning_places(row.run)
    assert (left and len(left.outcome), bool(describe_tuning([row.run]))) == (others, others is not None)


def test_tuned_settings_say_where_they_were_found():
    listed = published_frames()
    last = [frame for frame in listed if frame % 10 == 0][999]
    also = {
        f"nordland{dataset}": f"0-{sum(frame <= last for frame in listed[::stride]) - 1}"
        for dataset, stride in (("", 8), ("_27k", 1), ("_patchnetvlad", 1), ("_vprbench", 1))
    }
    for name in (
        *(f"vprtempo_{kind}{size}" for kind in ("tuned", "oriented") for size in ("", "_ensemble")),
        *("hyperdimensional_oriented", "gabor", "gabor_binary", "oriented_binary"),
    ):
        declared = make_request([f"method={name}"]).tuned_on
        assert declared == {"dataset": "nordland_64x32", "places": "0-999", "also_in": also}
    assert make_request(["method=vprtempo"]).tuned_on == {}
