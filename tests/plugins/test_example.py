"""The example plug-in brings a method and a dataset that keep every rule, and their run is right."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from checkout import ROOT

from vprbench.cli import main
from vprbench.plugins import entries
from vprbench.run.store import Store

FOLDER = ROOT / "tests" / "example_plugin"


@pytest.fixture(autouse=True)
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folders = {**entries.conf_folders(), "example": FOLDER / "vprbench_example" / "conf"}
    monkeypatch.setattr("vprbench.plugins.entries.conf_folders", lambda: folders)
    monkeypatch.syspath_prepend(FOLDER)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize(
    ("asked", "counted"),
    [
        (["method=thumbnail"], "16 rules: 15 kept, 1 excepted, 0 broken"),
        (["dataset=panorama"], "17 rules: 17 kept, 0 excepted, 0 broken"),
        (["dataset=panorama", "dataset.overlap=0", "dataset.places=2"], "17 rules: 17 kept, 0 excepted, 0 broken"),
    ],
)
def test_it_keeps_every_rule(asked: list[str], counted: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", *asked]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == counted


def test_its_method_finds_the_places_of_its_dataset(tmp_path: Path) -> None:
    asked = ["method=thumbnail", "dataset=panorama", "dataset.places=12", "timing=none", "threads=1"]
    assert main(asked) == 0
    (run,) = Store(tmp_path / "results").runs()
    assert (run.method, run.dataset, len(run.outcome)) == ("thumbnail", "panorama", 12)
    assert run.outcome.n_places == 12


def test_values_that_show_nothing_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", "dataset=panorama", "dataset.overlap=1"]) == 2
    assert "dataset.overlap=1" in capsys.readouterr().err
