"""A broken plug-in ends check, list and run in one line that names what is wrong, its file and its line."""

import sys

import pytest

from vprbench.cli import main
from vprbench.plugins import entries

METHOD = "from vprbench.api import DescriptorMethod\nclass Made(DescriptorMethod):\n"
DATASET = "from vprbench.api import Dataset\ndef Made(places: int = 3) -> Dataset:\n"
TARGET = "# Broken\n_target_: broken_code.Made\n"


@pytest.fixture
def here(tmp_path, monkeypatch):
    folders = {**entries.conf_folders(), "other": tmp_path / "conf"}
    monkeypatch.setattr("vprbench.plugins.entries.conf_folders", lambda: folders)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.chdir(tmp_path)
    for group in ("method", "dataset"):
        (tmp_path / "conf" / group).mkdir(parents=True)
    return tmp_path


@pytest.mark.parametrize(
    ("group", "yaml", "code", "named"),
    [
        ("method", "# Broken\ncells: 3\n", "", "_target_"),
        ("dataset", "# Broken\ncells: 3\n", "", "_target_"),
        ("method", "# Broken\n_target_: [\n", "", "broken.yaml"),
        ("method", TARGET, "import no_such_module\n", "no_such_module"),
        ("method", TARGET, "\n\nclass Made(\n", "(broken_code.py, line 3)"),
        ("dataset", TARGET, "x = 1\nx.y = 2\n", "(broken_code.py, line 2)"),
        ("method", TARGET, METHOD + "    pass\n", "abstract"),
        ("method", TARGET, METHOD + "    encode = 1\n    def __init__(self): [][0]\n", "(broken_code.py, line 4)"),
        ("dataset", TARGET, DATASET + "    return {}[places]\n", "(broken_code.py, line 3)"),
        ("dataset", TARGET, DATASET + "    return places\n", "gave int"),
        ("method", TARGET, "def Made(cells: int = 2): return cells\n", "made a int"),
        ("method", TARGET + "cells: 2\n", "def Made(cells: 'Unknown'): pass\n", "type hints"),
        ("method", TARGET, "Made = 5\n", "is a int"),
    ],
)
def test_it_is_told_in_one_line(here, group, yaml, code, named, capsys):
    (here / "conf" / group / "broken.yaml").write_text(yaml)
    (here / "broken_code.py").write_text(code)
    for command in (["check"], []):
        sys.modules.pop("broken_code", None)
        assert main([*command, f"{group}=broken"]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert named in line


def test_the_others_are_listed_beside_it(here, capsys):
    (here / "conf" / "method" / "broken.yaml").write_text("# Broken\n_target_: [\n")
    (here / "conf" / "dataset" / "unnamed.yaml").write_text("# Unnamed\n")
    assert main(["list"]) == 0
    lines = capsys.readouterr().out.splitlines()
    for name in ("broken", "unnamed"):
        assert sum("BROKEN" in line and line.split()[0] == name for line in lines) == 1
    assert sum(line.split()[:1] == ["sad"] for line in lines) == 1
