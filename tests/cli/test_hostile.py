"""Plug-ins that leave, fail, move or share a name: each ends in one line, or in a run that is stored once."""

import shutil
import sys
from pathlib import Path

import pytest
from plugged_in import forget_loose_files, plugin, see_plugins
from small_plan import RUN

from vprbench.cli import main
from vprbench.errors import BadInput
from vprbench.plugins import entries, registry
from vprbench.runs.frame import tabulate_runs
from vprbench.runs.store import Store

METHODS = ("leaving", "silent", "colourful", "rootless", "moving")
QUICK = ["dataset.places=12", "dataset.first_query_place=0", "dataset.query_places=4", "frames=false", *RUN]


@pytest.fixture
def here(tmp_path, monkeypatch):
    """Work in a folder of its own with the hostile methods plugged in, for other processes too."""
    methods = {name: f"_target_: hostile.{name.capitalize()}" for name in METHODS}
    plugin(tmp_path / "plugins", "hostile", "hostile", methods)
    forget_loose_files(monkeypatch)
    see_plugins(tmp_path / "plugins", monkeypatch)
    monkeypatch.chdir(tmp_path)
    yield tmp_path
    sys.modules.pop("needy", None)


NEEDY = """import numpy as np
from vprbench.api import DescriptorMethod
class Needy(DescriptorMethod):
    def __init__(self):
        self.weights = np.load("weights.npy")
    def encode(self, images): return self.weights
"""


def test_a_file_that_a_method_lacks_is_one_line_with_the_traceback_in_the_record_and_with_debug(here, capsys):
    (here / "needy.py").write_text(NEEDY)
    asked = ["method=./needy.py:Needy", *QUICK]
    assert main(asked) == 1
    printed = capsys.readouterr().err.splitlines()
    (line,) = (line for line in printed if line.startswith("vprbench: "))
    assert [part for part in ("weights.npy", "(needy.py, line 5)", "debug=true") if part not in line] == []
    (failure,) = Store(Path("results")).failures()
    assert [*tabulate_runs([failure])["error"]] == [failure.error]
    last = failure.traceback.splitlines()[-1]
    assert ("FileNotFoundError" in last, last.strip() in "\n".join(printed[:-1])) == (True, False)
    assert main([*asked, "debug=true"]) == 1
    assert last in capsys.readouterr().err


@pytest.mark.parametrize(
    ("method", "code"),
    [("leaving", 1), ("silent", 2), ("colourful", 1), ("rootless", 1), ("moving save=net.safetensors", 0)],
)
def test_any_error_of_a_method_ends_in_one_line_that_no_terminal_obeys_and_a_changed_folder_moves_nothing(
    method, code, capsys, here
):
    assert main([*f"method={method}".split(), *QUICK]) == code
    printed = capsys.readouterr().err
    lines = [line for line in printed.splitlines() if line.startswith("vprbench")]
    assert [line[:10] for line in lines if len(line) > len("vprbench: ")] == ["vprbench: "] * (code > 0)
    assert "\x1b" not in printed
    store = Store(here / "results")
    assert (len(list(store.failures())), len(list(store.runs()))) == (code == 1, code == 0)
    written = {path.name for path in here.iterdir()} - {"plugins", "results"}
    assert written == ({"net.safetensors"} if code == 0 else set())


def test_a_name_of_several_plug_ins_is_one_error_that_names_them_and_a_package_without_its_folder_is_named(
    here, capsys
):
    others = ("north", "pole"), ("south", "pole"), ("shadow", "sad"), ("leaver", "gone")
    for package, method in others:
        plugin(here / "plugins", package, package, {method: "_target_: leaving_at_import.Method"})
    plugin(here / "plugins", "empty", "empty", {})
    shutil.rmtree(here / "plugins" / "empty_conf")
    (here / "plugins" / "leaving_at_import.py").write_text("raise SystemExit\n")
    assert [package for package, _ in entries.list_broken_plugins()] == ["empty_conf"]
    with pytest.raises(BadInput, match="SystemExit"):
        registry.find_entries("method")["gone"].target()
    for asked_for, owners in (("pole", "north south"), ("'pole'", "north south"), ("sad", "vprbench shadow")):
        assert main([f"method={asked_for}", *QUICK]) == 2
        printed = capsys.readouterr().err
        assert [owner for owner in owners.split() if owner not in printed] == []
    assert main(["list"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert {line.split()[0] for line in lines if "BROKEN" in line} >= {"pole", "sad", "plug-in"}
    assert main(["method=hog", *QUICK]) == 0
