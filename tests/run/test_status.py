"""What goes on in a results folder, told from another terminal."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest
from little import a_failure, a_run

from vprbench import cli
from vprbench.run.claims import Claims
from vprbench.run.store import Store

ABOUT = {"method": "little", "dataset": "journey", "seed": 3, "device": "cpu", "corruption": "shift-1"}


@pytest.fixture
def results(tmp_path: Path) -> Path:
    """A folder with two runs and three failures, among damaged ones and what nobody reads."""
    store = Store(tmp_path / "results")
    store.prepare()
    for seed in range(2):
        (store.save(a_run(key=f"{seed}")) / "run.json").stat()
    for seed in range(3):
        store.save_failure(a_failure(config={"seed": seed}))
    for path in (".partial-1/run.json", "journey/.damaged-1/run.json", "descriptors/1/2/run.json"):
        (store.root / path).parent.mkdir(parents=True)
        (store.root / path).write_text("{}")
    return store.root


def printed(capsys: pytest.CaptureFixture[str], *options: str) -> str:
    assert cli.main(["status", *options]) == 0
    return capsys.readouterr().out


def test_stored_runs_and_failures_are_counted(results: Path, capsys: pytest.CaptureFixture[str]) -> None:
    store = Store(results)
    assert (len([*store.runs()]), len([*store.failures()])) == (2, 3)
    assert printed(capsys, f"results={results}").splitlines() == [
        f"{results}: 2 runs and 3 failures are stored",
        "no run is being made",
    ]


def test_a_run_that_is_being_made_stands_there_with_its_stage_and_its_owner(
    results: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with Claims(results).take("journey/little-1", ABOUT) as claim:
        claim.tell("fit, reading images", 0.25)
        head, row = printed(capsys, f"results={results}", "wide=true").splitlines()[1:]
        told = json.loads(printed(capsys, f"results={results}", "output=json"))
    assert head.split()[:3] == ["run", "stage", "%"]
    assert row.startswith("little on journey, shift-1  fit")
    assert str(os.getpid()) in row.split()
    assert (told["runs"], told["failures"]) == (2, 3)
    (made,) = told["claims"]
    assert {name: made[name] for name in ABOUT} == ABOUT
    assert (made["stage"], made["done"], made["process"]) == ("fit, reading images", 0.25, os.getpid())
    assert made["alive"]
    assert made["silent_seconds"] < 30


def test_the_claim_of_a_dead_owner_and_one_that_is_not_all_there_stand_there_too(
    results: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = results / ".claims"
    folder.mkdir()
    (folder / "half").write_text('{"about": {"met')
    (folder / "odd").write_text('{"about": 3, "since": "x", "done": "x", "owner": "\\u001b[2J"}')
    (folder / "old").write_text("")
    os.utime(folder / "old", (1.0, 1.0))
    lines = printed(capsys, f"results={results}", "wide=true").splitlines()
    assert len(lines) == 5
    assert ["dead" in line for line in lines[2:]].count(True) == 1
    assert "\x1b" not in "".join(lines)


def test_of_a_folder_that_is_not_there_nothing_is_told_or_made(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["status", f"results={tmp_path}/nowhere"]) == 2
    assert "/nowhere is no folder: " in capsys.readouterr().err
    assert [*tmp_path.iterdir()] == []
