"""What `new` writes keeps every rule at once, and nothing is overwritten."""

import re
import sys
import tomllib

import pytest
from PIL import Image

from vprbench.cli import main
from vprbench.plugins import entries


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.setattr(entries, "_LOOSE", {"method": {}, "dataset": {}})
    yield tmp_path
    for name in [name for name in sys.modules if name.startswith(("my_", "vprbench_my_"))]:
        del sys.modules[name]


def counted(printed):
    kept, broken = re.findall(r"rules: (\d+) kept, \d+ excepted, (\d+) broken", printed)[0]
    return int(kept), int(broken)


@pytest.mark.parametrize(
    ("words", "asked"),
    [
        (["method", "MyMeans"], "method=./my_means.py:MyMeans"),
        (["method", "my-means", "folder=below"], "method=./below/my_means.py:MyMeans"),
        (["dataset", "my_walk"], "dataset=./my_walk.py:my_walk"),
    ],
)
def test_a_loose_file_keeps_every_rule_by_the_option_that_is_printed(here, words, asked, capsys):
    assert main(["new", *words]) == 0
    assert f"vprbench check {asked}\n" in capsys.readouterr().out
    assert main(["check", asked]) == 0
    kept, broken = counted(capsys.readouterr().out)
    assert (kept >= 14, broken) == (True, 0)
    before = {path: path.read_text() for path in here.rglob("*.py")}
    assert main(["new", *words]) == 2
    assert {path: path.read_text() for path in here.rglob("*.py")} == before


@pytest.mark.parametrize("group", ["method", "dataset"])
def test_a_package_brings_its_yaml_and_keeps_every_rule_by_its_name(here, group, monkeypatch, capsys):
    assert main(["new", group, "my_own", "package=true"]) == 0
    top = here / "vprbench-my-own"
    told = tomllib.loads((top / "pyproject.toml").read_text())
    assert told["project"]["entry-points"]["vprbench.conf"] == {"my_own": "vprbench_my_own.conf"}
    sys.path.append(str(top))
    folders = {**entries.conf_folders(), "my_own": top / "vprbench_my_own" / "conf"}
    monkeypatch.setattr("vprbench.plugins.entries.conf_folders", lambda: folders)
    assert "my_own" in entries.entries(group)
    capsys.readouterr()
    assert main(["check", f"{group}=my_own"]) == 0
    assert counted(capsys.readouterr().out)[1] == 0


def test_a_new_dataset_reads_folders(here):
    assert main(["new", "dataset", "my_walk"]) == 0
    for part in ("references", "queries"):
        (here / part).mkdir()
        for number in range(3):
            Image.new("RGB", (8, 8), (len(part), number, 0)).save(here / part / f"{number}.png")
    assert main(["method=sad", "dataset=./my_walk.py", "dataset.root=.", "timing=none", "threads=1"]) == 0


def test_names_that_cannot_be_used_are_refused(here):
    names = ("method", "methods mine", "method a b", "method sad", "dataset 3d", "method class", "method mine folder")
    for words in ("", *names):
        assert main(["new", *words.split()]) == 2
        assert [*here.iterdir()] == []
