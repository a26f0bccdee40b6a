"""The example plug-in brings a method and a dataset that keep every rule, and their run is right."""

import sys

import pytest
from checkout import ROOT

from vprbench.cli import main
from vprbench.plugins import entries
from vprbench.run.store import Store

FOLDER = ROOT / "tests" / "example_plugin"


@pytest.fixture(autouse=True)
def installed(tmp_path, monkeypatch):
    folders = {**entries.conf_folders(), "example": FOLDER / "vprbench_example" / "conf"}
    monkeypatch.setattr("vprbench.plugins.entries.conf_folders", lambda: folders)
    monkeypatch.syspath_prepend(FOLDER)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    monkeypatch.chdir(tmp_path)


def test_its_method_and_dataset_keep_every_rule_and_find_each_others_places(tmp_path, capsys):
    for asked in (["method=thumbnail"], ["dataset=panorama"], ["dataset=panorama", "dataset.overlap=0"]):
        assert main(["check", *asked]) == 0
        assert ", 0 broken" in capsys.readouterr().out.splitlines()[-1]
    assert main(["check", "dataset=panorama", "dataset.overlap=1"]) == 2
    assert "dataset.overlap=1" in capsys.readouterr().err
    assert main(["method=thumbnail", "dataset=panorama", "dataset.places=12", "timing=none", "threads=1"]) == 0
    (run,) = Store(tmp_path / "results").runs()
    assert (run.method, run.dataset, len(run.outcome), run.outcome.n_places) == ("thumbnail", "panorama", 12, 12)
