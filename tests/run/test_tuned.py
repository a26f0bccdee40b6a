"""What a yaml says of the places its settings were chosen on stands with every run, wherever that is shown."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from pathlib import Path

import pytest
from small_plan import RUN, install

from vprbench.cli import main
from vprbench.paper.page import words
from vprbench.paper.selection import Series
from vprbench.plugins import registry
from vprbench.run.record import Run
from vprbench.run.store import Store

NOT_TUNED = "# Mine\n_target_: vprbench.methods.sad.SAD\npatch: 5\n"
MINE = f"{NOT_TUNED}tuned_on: {{dataset: synthetic, places: every second place}}\n"
UPPER = "# On mine\ndefaults: [mine, _self_]\nwidth: 14\n"
NOTE = "tuned on every second place of synthetic, so in no contest on synthetic"
QUICK = ["dataset.places=12", "dataset.first_query_place=0", *RUN]
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


@pytest.mark.parametrize("asked", [["method=mine", "method.patch=7"], ["method=upper"]])
def test_a_run_prints_and_keeps_on_what_its_method_was_tuned(printed: Print, asked: list[str]) -> None:
    assert f"note: {NOTE}" in printed(asked).splitlines()
    told = json.loads(printed([*asked, "output=json"]))
    assert (told["notes"][0], told["from_store"]) == ({"kind": "tuned", "text": NOTE}, True)
    declared = {"dataset": "synthetic", "places": "every second place", "also_in": []}
    assert told["tuned_on"] == only_run().tuned_on == declared
    assert "tuned_on" not in only_run().config["method"]
    told = json.loads(printed(["method=sad", "output=json"]))
    assert (told["tuned_on"], [note for note in told["notes"] if note["kind"] == "tuned"]) == (None, [])


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


def test_it_stands_in_every_format_of_the_table_and_on_the_page(printed: Print) -> None:
    assert main(["table", "rows=[SAD]", "methods=[mine]", "columns=[route]", "name=told", *RUN]) == 0
    for form in ("md", "tex"):
        text = Path(f"results/told.{form}").read_text(encoding="utf-8")
        assert NOTE in text.replace("\\_\\allowbreak{}", "_")
    with Path("results/told.csv").open(encoding="utf-8", newline="") as file:
        lines = [line for line in csv.DictReader(file) if line["row"] == "mine" and line["value"]]
    assert lines
    assert all(NOTE in line["notes"] and line["best"] == "False" for line in lines)
    with Path("results/told-runs.csv").open(encoding="utf-8", newline="") as file:
        assert {line["method"]: line["tuned_on"] for line in csv.DictReader(file)} == {"mine": NOTE, "sad": ""}
    (run,) = (run for run in Store(Path("results"), read_only=True).runs() if run.method == "mine")
    assert words.notes([("Route", Series("mine", False, (run,)))])[0] == ("Route: mine", NOTE)
    assert main(["report", "rows=[SAD]", "methods=[mine]", "columns=[route]", "name=told", "stored=true"]) == 0
    assert Path("results/report-told.html").read_text(encoding="utf-8").count(NOTE) >= 2  # of the table and of the run


def test_the_tuned_settings_of_vprtempo_say_where_they_were_found() -> None:
    for name in (f"vprtempo_{kind}{size}" for kind in ("tuned", "oriented") for size in ("", "_ensemble")):
        assert registry.entries("method")[name].tuned_on["dataset"] == "nordland_64x32"
    assert registry.entries("method")["vprtempo"].tuned_on == {}
