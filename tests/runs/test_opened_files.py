"""A file that a method reads is part of its run's key, or a note names it; `check` counts it as a broken rule."""

import json
from pathlib import Path

import numpy as np
import pytest

from vprbench.cli import main
from vprbench.plugins import entries
from vprbench.plugins.conformance import FILES_RULE

MINE = """
from dataclasses import dataclass
import numpy as np
from pathlib import Path
from vprbench.api import DescriptorMethod

@dataclass
class {name}(DescriptorMethod):
    weights: str = "weights.npy"
    {files}
    def __post_init__(self):
        self._factor = {built}
    def fit(self, references, places):
        self._more = {fitted}
        return super().fit(references, places)
    def encode(self, images):
        return np.array([[i[..., c].mean() + k for c in range(3) for k in (1, 2)] for i in images], np.float32)
"""
READ, OPEN = 'np.load("weights.npy")', 'Path("weights.npy").read_bytes()'
NAMED = "def files(self): return [Path(self.weights)]"
QUICK = ["dataset=synthetic", "dataset.places=10", "dataset.first_query_place=0", "timing=none", "threads=1"]


@pytest.fixture(autouse=True)
def weights(tmp_path, monkeypatch):
    """Run beside a file of weights; methods of loose files are forgotten afterwards."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(entries, "_LOOSE", {"method": {}, "dataset": {}})
    np.save("weights.npy", np.float32(1))


def run(name, capsys, *options):
    capsys.readouterr()
    assert main([f"method=./{name}.py:{name.title()}", *QUICK, "frames=false", "output=json", *options]) == 0
    told = json.loads(capsys.readouterr().out)
    return told["from_store"], [note["text"] for note in told["notes"] if note["kind"] == "opened"]


def write(name, files="", built="1", fitted="1"):
    text = MINE.format(name=name.title(), files=files, built=built, fitted=fitted)
    Path(f"{name}.py").write_text(text, encoding="utf-8")


@pytest.mark.usefixtures("surroundings")
@pytest.mark.parametrize(
    ("name", "source", "same", "noted"),
    [
        ("said", {"files": NAMED, "built": READ}, False, 0),
        ("built", {"built": READ}, False, 0),
        ("opened", {"built": OPEN}, False, 0),
        ("argument", {"fitted": "np.load(self.weights)"}, False, 0),  # which names the file
        ("hidden", {"fitted": 'Path("other.bin").read_bytes()'}, True, 1),
    ],
)
def test_other_weights_in_a_file_that_a_method_reads_are_another_run_or_a_note_names_it(
    name, source, same, noted, capsys
):
    Path("other.bin").write_bytes(b"1")
    write(name, **source)
    stored, notes = run(name, capsys)
    assert (stored, ["other.bin" in note for note in notes]) == (False, [True] * noted)
    np.save("weights.npy" if not same else "unused.npy", np.float32(2))
    Path("other.bin").write_bytes(b"2")
    assert run(name, capsys)[0] == same


@pytest.mark.parametrize(
    ("name", "source", "broken"),
    [("one", {"fitted": READ}, 1), ("two", {"built": READ}, 1), ("three", {"files": NAMED, "built": READ}, 0)],
)
def test_check_names_the_files_that_a_method_reads_and_does_not_name(name, source, broken, capsys):
    write(name, **source)
    main(["check", f"method=./{name}.py:{name.title()}"])
    lines = [line for line in capsys.readouterr().out.splitlines() if FILES_RULE in line]
    assert (len(lines), ["weights.npy" in line for line in lines]) == (broken, [True] * broken)
