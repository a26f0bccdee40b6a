"""What a yaml says of the places its settings were chosen on stands with every run, wherever that is shown."""

from __future__ import annotations

import csv
import json
import math
import re
from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from figure_runs import run
from small_plan import RUN, install

from vprbench.cli import main
from vprbench.datasets.nordland import published_frames
from vprbench.plugins import registry
from vprbench.run.record import Run
from vprbench.run.store import Store
from vprbench.run.tuned import other_places, tuned_here, tuned_note
from vprbench.run.views import rescored

NOT_TUNED = "# Mine\n_target_: vprbench.methods.sad.SAD\npatch: 5\n"
MINE = f"{NOT_TUNED}tuned_on: {{dataset: synthetic, places: 5-11}}\n"
UPPER = "# On mine\ndefaults: [mine, _self_]\nwidth: 14\n"
NOTE = "tuned on places 5-11 of synthetic"
QUICK = ["dataset.places=40", "dataset.first_query_place=2", *RUN]
QUERIES = 31  # 2 to 4 and 12 to 39
Print = Callable[[list[str]], str]


@pytest.fixture
def plug_in(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str, str], None]:
    """Return what registers a yaml of another package; runs are made in a folder without a process of their own."""
    folder = tmp_path / "conf"
    (folder / "method").mkdir(parents=True)
    ours = registry.conf_folders()
    monkeypatch.setattr("vprbench.plugins.entries.conf_folders", lambda: {**ours, "other": folder})
    install(monkeypatch, tmp_path)

    def registered(name: str, text: str) -> None:
        (folder / "method" / f"{name}.yaml").write_text(text, encoding="utf-8")

    registered("mine", MINE)
    registered("upper", UPPER)
    return registered


@pytest.fixture
def printed(plug_in: Callable[[str, str], None], capsys: pytest.CaptureFixture[str]) -> Print:
    def of(options: list[str]) -> str:
        assert main([*options, *QUICK]) == 0
        return capsys.readouterr().out

    return of


def only_run() -> Run:
    (run,) = Store(Path("results"), read_only=True).runs()
    return run


def hits(run: Run, numbers: Sequence[int], tuned: Collection[int]) -> list[float]:
    """Return the chance of each query of no tuned place that its best place is right; `numbers` are the queries'."""
    assert run.scores is not None
    found = []
    for number, scores, right in zip(numbers, np.asarray(run.scores), run.positives, strict=True):
        best = [place for place, score in enumerate(scores) if score == scores.max()]
        found += [] if number in tuned else [len({*best} & {*right.tolist()}) / len(best)]
    return found


def wilson(share: float, n: int) -> tuple[float, float]:
    z = 1.959963984540054
    half = z * math.sqrt(share * (1 - share) / n + z * z / (4 * n * n))
    return (share + z * z / (2 * n) - half) / (1 + z * z / n), (share + z * z / (2 * n) + half) / (1 + z * z / n)


def csv_lines(name: str, field: str, value: str) -> list[dict[str, str]]:
    with Path("results", name).open(encoding="utf-8", newline="") as file:
        lines = [line for line in csv.DictReader(file) if line[field] == value]
    assert lines
    return lines


def told_elsewhere(text: str) -> list[float]:
    """Return R@1, the ends of its interval and how many queries a note names."""
    found = re.search(r"([\d.]+) \[([\d.]+), ([\d.]+)\] on the (\d+) queries", text)
    return [] if found is None else [*map(float, found.groups())]


@pytest.mark.parametrize("asked", [["method=mine", "method.patch=7"], ["method=upper"]])
def test_a_run_prints_and_keeps_on_what_its_method_was_tuned(printed: Print, asked: list[str]) -> None:
    lines = printed([*asked, "wide=true"]).splitlines()
    line = next(line for line in lines if line.startswith(f"note: {NOTE}"))
    told = json.loads(printed([*asked, "output=json"]))
    assert (told["notes"][0], told["from_store"]) == ({"kind": "tuned", "text": line[6:]}, True)
    declared = {"dataset": "synthetic", "places": "5-11", "also_in": {}}
    assert told["tuned_on"] == only_run().tuned_on == declared
    assert "tuned_on" not in only_run().config["method"]
    there = hits(only_run(), range(2, 40), range(5, 12))
    numbers = [told[f"recall_at_1_elsewhere{end}"] for end in ("", "_low", "_high")]
    assert (numbers[0], told["queries_elsewhere"]) == (pytest.approx(np.mean(there)), len(there))
    assert told_elsewhere(line) == pytest.approx([*(100 * number for number in numbers), QUERIES], abs=0.051)
    row = "{:.1f} [{:.1f}, {:.1f}]".format(*(100 * number for number in numbers))
    assert any(f" elsewhere {row} " in line for line in lines)
    if told["recall_at_1_interval"] == "independent":
        assert numbers[1:] == pytest.approx(wilson(numbers[0], QUERIES))
    told = json.loads(printed(["method=sad", "output=json"]))
    assert (told["tuned_on"], [note for note in told["notes"] if note["kind"] == "tuned"]) == (None, [])
    assert {told[name] for name in told if "elsewhere" in name} == {None}


def test_a_run_that_was_stored_before_its_yaml_declared_it_is_told_when_it_is_asked_for(
    plug_in: Callable[[str, str], None], printed: Print
) -> None:
    plug_in("mine", NOT_TUNED)
    printed(["method=mine"])
    before = only_run()
    plug_in("mine", MINE)
    assert json.loads(printed(["method=mine", "output=json"]))["from_store"]
    assert (before.tuned_on, only_run().tuned_on) == ({}, registry.entries("method")["mine"].tuned_on)
    assert only_run().environment == before.environment


@pytest.mark.parametrize(
    ("asked", "declared", "named"),
    [
        *(
            (["method=upper", option], "{dataset: a, places: b}", "method.tuned_on=")
            for option in ("method.tuned_on=null", "~method.tuned_on", "method.tuned_on.dataset=street")
        ),
        *(
            (["method=mine"], declared, "mine")
            for declared in ("nordland", "{dataset: nordland}", "{dataset: a, places: b, colour: red}")
        ),
    ],
)
def test_the_command_line_cannot_change_it_and_what_is_no_declaration_is_refused_by_its_yaml(
    plug_in: Callable[[str, str], None],
    capsys: pytest.CaptureFixture[str],
    asked: list[str],
    declared: str,
    named: str,
) -> None:
    plug_in("mine", f"{NOT_TUNED}tuned_on: {declared}\n")
    assert main([*asked, *QUICK]) == 2
    error = capsys.readouterr().err
    assert (named in error, "tuned_on" in error, error.count("\n")) == (True, True, 1)
    assert list(Store(Path("results"), read_only=True).runs()) == []


def test_row_table_comparison_page_and_python_give_one_number_on_the_other_places(
    printed: Print, capsys: pytest.CaptureFixture[str]
) -> None:
    asked = ["rows=[SAD]", "methods=[mine]", "columns=[route]", *RUN]
    assert main(["table", *asked, "name=told"]) == 0
    (run,) = (run for run in Store(Path("results"), read_only=True).runs() if run.method == "mine")
    there = hits(run, range(4, 20), range(5, 12))
    share, ends = float(np.mean(there)), wilson(float(np.mean(there)), 9)  # too few for blocks
    shown = f"{100 * share:.1f} [{100 * ends[0]:.1f}, {100 * ends[1]:.1f}]"
    assert len(there) == 9
    note = f"{NOTE}, in no contest; {shown} on the 9 queries of other places"
    for line in (line for line in csv_lines("told.csv", "row", "mine") if line["value"]):
        assert (line["best"], note in line["notes"]) == ("False", True)
        numbers = [line[name] for name in ("elsewhere", "elsewhere_low", "elsewhere_high")]
        known = [float(number) for number in numbers if number]
        assert known == (pytest.approx([100 * share, *(100 * end for end in ends)]) if line["unit"] == "%" else [])
    assert not any(line["elsewhere"] for line in csv_lines("told.csv", "row", "SAD"))
    (line,) = csv_lines("told-runs.csv", "method", "mine")
    assert (line["tuned_on"], float(line["recall_at_1_elsewhere"])) == (note, pytest.approx(share))
    (line,) = csv_lines("told-runs.csv", "method", "sad")
    assert (line["tuned_on"], line["recall_at_1_elsewhere"]) == ("", "")
    assert main(["report", *asked, "name=told", "stored=true"]) == 0
    for file, times in (("told.md", 2), ("told.tex", 2), ("report-told.html", 3)):  # cell, note, and that of the run
        assert Path("results", file).read_text(encoding="utf-8").count(shown) >= times
    capsys.readouterr()
    data = ["dataset=synthetic", "dataset.places=20", "dataset.first_query_place=4"]
    assert main(["compare", "methods=sad,mine", *data, *RUN, "wide=true", "stored=true"]) == 0
    printed_lines = capsys.readouterr().out.splitlines()
    assert f"note: mine: {note}" in printed_lines
    assert any(line.startswith("mine ") and f"elsewhere {shown}" in line for line in printed_lines)


@pytest.mark.parametrize(
    ("changes", "tuned", "others"),
    [
        ({}, True, 32),
        ({"tuned_on": {"dataset": "synthetic", "places": "0-3, 36-39"}}, True, 32),
        ({"tuned_on": {"dataset": "street", "places": "0-99", "also_in": {"synthetic": "8-11"}}}, True, 36),
        ({"positives": [[i - 1, i] for i in range(1, 41)], "place_numbers": np.arange(41)}, True, 32),
        ({"positives": [[i, i + 1] for i in range(40)], "place_numbers": np.arange(41)}, True, 32),
        ({"positives": [[i + 2] for i in range(40)], "place_numbers": np.arange(42)}, True, 34),
        ({"place_numbers": np.arange(4, 44)}, True, 36),
        ({"place_numbers": 2 * np.arange(40)}, True, 36),
        ({"dataset_arguments": {"references": ["winter"], "places": 99, "root": "/a"}}, True, 32),
        ({"dataset_arguments": {"seed": 1}}, True, None),
        ({"dataset_arguments": {"query_shift": 3}}, True, None),
        ({"dataset": "synthetic_2"}, False, None),
        ({"dataset": "railway", "tuned_on": {"dataset": "railway", "places": "0-7"}}, True, None),  # of nobody's yaml
        ({"tuned_on": {"dataset": "synthetic", "places": "every second place"}}, True, None),
        ({"tuned_on": {"dataset": "street", "places": "0-7", "also_in": ["synthetic"]}}, True, None),
        ({"tuned_on": {"dataset": "synthetic", "places": "0-39"}}, True, None),
        ({"tuned_on": {"dataset": "synthetic", "places": "40-99"}}, False, None),
        ({"tuned_on": {"dataset": "street", "places": "0-39"}}, False, None),
        ({"tuned_on": {}}, False, None),
    ],
)
def test_queries_of_tuned_places_are_told_by_their_numbers_and_all_are_suspected_where_these_are_not_known(
    changes: dict[str, Any], tuned: bool, others: int | None
) -> None:
    given = {"dataset": "synthetic", "tuned_on": {"dataset": "synthetic", "places": "0-7"}, **changes}
    right = given.pop("positives", [[i] for i in range(40)])
    made = run("mine", 0.5, 40, 40, **given, positives=tuple(map(np.array, right)))
    left = other_places(made)
    assert (tuned_here(made), left and len(left.outcome)) == (tuned, others)
    assert bool(tuned_note([made])) == tuned
    assert (len(told_elsewhere(tuned_note([made]))) == 4) == (others is not None)


def test_an_answer_that_rests_on_neighbours_is_of_a_tuned_place_if_one_of_them_is() -> None:
    made = run("mine", 0.5, 40, 40, dataset="synthetic", tuned_on={"dataset": "synthetic", "places": "10-19"})
    left = other_places(rescored(made, np.asarray(made.scores), {"sequence": 4}, window=4))
    assert left is not None
    assert [int(right[0]) for right in left.positives] == [*range(7), *range(23, 40)]


@pytest.mark.parametrize(
    "name",
    [
        *(f"vprtempo_{kind}{size}" for kind in ("tuned", "oriented") for size in ("", "_ensemble")),
        "hyperdimensional_oriented",
        "gabor",
        "gabor_binary",
        "oriented_binary",
    ],
)
def test_tuned_settings_say_where_they_were_found(name: str) -> None:
    declared = registry.entries("method")[name].tuned_on
    listed = published_frames()
    last = [frame for frame in listed if frame % 10 == 0][999]
    assert (declared["dataset"], declared["places"]) == ("nordland_64x32", "0-999")
    for dataset, stride in (
        ("nordland", 8),
        ("nordland_27k", 1),
        ("nordland_patchnetvlad", 1),
        ("nordland_vprbench", 1),
    ):
        shown = [place for place, frame in enumerate(listed[::stride]) if frame <= last]
        assert declared["also_in"].pop(dataset) == f"0-{shown[-1]}"
    assert declared["also_in"] == {}
    assert registry.entries("method")["vprtempo"].tuned_on == {}
