"""What the README shows works as it stands there."""

from __future__ import annotations

import csv
import importlib
import re
import shutil
import subprocess
import tomllib
from itertools import pairwise
from pathlib import Path

import pytest
from checkout import ROOT

from vprbench.cli import main
from vprbench.paper.plan import read_plan
from vprbench.paper.table.quantities import TRAINING_TIME
from vprbench.plugins import registry
from vprbench.run.compose import composed

README = (ROOT / "README.md").read_text(encoding="utf-8")
PLUG_INS = (ROOT / "docs" / "plug-ins.md").read_text(encoding="utf-8")


def committed(path: str) -> str:
    """Return a file as it was committed: make table renews the one that lies there."""
    if shutil.which("git") is None:
        pytest.skip("git is not installed, which knows what was committed")
    told = subprocess.run(["git", "show", f"HEAD:./{path}"], cwd=ROOT, capture_output=True, text=True, check=False)
    if told.returncode:
        pytest.skip(f"no committed {path} here: {told.stderr.strip()}")
    return told.stdout


@pytest.mark.parametrize(("group", "name"), [("method", "darkness"), ("dataset", "lamps")])
def test_what_stands_in_two_files_keeps_the_contract(
    group: str, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for path in (f"{group}s/{name}.py", f"conf/{group}/{name}.yaml"):
        shown = re.search(rf"`{path}`:\n\n```\w+\n(.*?)```", PLUG_INS, re.DOTALL)
        assert shown, path
        (tmp_path / path).parent.mkdir(parents=True)
        (tmp_path / path).write_text(shown.group(1), encoding="utf-8")
    package = importlib.import_module(f"vprbench.{group}s")
    monkeypatch.setattr(package, "__path__", [*package.__path__, str(tmp_path / f"{group}s")])
    folders = {**registry.conf_folders(), "two files": tmp_path / "conf"}
    monkeypatch.setattr("vprbench.plugins.entries.conf_folders", lambda: folders)
    assert main(["check", f"{group}={name}"]) == 0
    assert " 0 broken" in capsys.readouterr().out


DOCUMENTS = ("README.md", "CONTRIBUTING.md", *(f"docs/{path.name}" for path in (ROOT / "docs").glob("*.md")))
EXAMPLES = ("methods/darkness.py", "conf/method/darkness.yaml", "datasets/lamps.py", "conf/dataset/lamps.yaml")
NOT_OURS = {"vprbench/weights", *EXAMPLES}  # a folder of a user


@pytest.mark.parametrize("document", DOCUMENTS)
def test_the_files_that_a_document_names_exist(document: str) -> None:
    text = (ROOT / document).read_text(encoding="utf-8")
    named = set(re.findall(r"`((?:methods|datasets|tests|docs|conf|vprbench)/[\w./-]+)`", text)) - NOT_OURS
    linked = set(re.findall(r"\]\(((?!http)[\w./-]+)\)", text))
    assert [path for path in sorted(named) if "NAME" not in path and not (ROOT / path).exists()] == []
    assert [path for path in sorted(linked) if not (ROOT / document).parent.joinpath(path).exists()] == []


def test_the_picture_of_the_rooms_shows_the_layers_that_are_held() -> None:
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"][
        "contracts"
    ]
    floors = [{room.split(".")[1] for room in floor.split(" | ")} for floor in contracts[0]["layers"]]
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    arrows = re.findall(r"^  (\w+)(?:\[.*?\])? --> (\w+)", text, re.MULTILINE)
    drawn = {tuple("__main__" if room == "main" else room for room in arrow) for arrow in arrows}
    assert drawn == {(upper, lower) for above, below in pairwise(floors) for upper in above for lower in below}


def test_every_target_of_the_makefile_is_explained() -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    (phony,) = re.findall(r"^\.PHONY: (.*)$", makefile, re.MULTILINE)
    assert set(phony.split()) == set(re.findall(r"^([a-z-]+):.*## \S", makefile, re.MULTILINE))


def shown(name: str, readme: str = README) -> str:
    found = re.search(rf"<!-- {name} -->\n(.*?)<!-- /{name} -->", readme, re.DOTALL)
    assert found
    return found.group(1)


def test_the_time_of_training_is_told_in_the_words_of_the_page() -> None:
    assert TRAINING_TIME in " ".join((ROOT / "docs" / "numbers.md").read_text(encoding="utf-8").split())


def test_the_readme_fits_two_screens_and_shows_what_it_tells_of() -> None:
    assert len(README.splitlines()) <= 120
    assert "is best" in shown("compare") or "leads" in shown("compare")


def test_the_table_it_shows_is_the_stored_one_beside_the_papers() -> None:
    table, text = committed("results/table.csv"), shown("table", committed("README.md"))
    cells = {(c["row"], c["column"], c["quantity"]): c for c in csv.DictReader(table.splitlines())}
    lines = [[cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines() if "|" in line]
    assert len(lines) <= 12
    for name, *values in lines[2:]:
        of_row = [
            cells[name.strip("*"), column, quantity]
            for column in ("railway", "street")
            for quantity in ("recall_at_1", "train_cpu", "query_cpu")
        ]
        for cell, value in zip(of_row, values, strict=True):
            published = f"{float(cell['published']):,g}" if cell["published"] else "-"
            assert value.endswith(f"({published})")
            if cell["value"] and cell["mark"] == "measured":
                digits = float(value.split()[0].strip("*~").replace(",", ""))
                assert digits == pytest.approx(float(cell["value"]), rel=0.06)
    assert [name.strip("*") for name, *_ in lines[2:]] == [*read_plan(ROOT / "conf" / "table.yaml").rows]


@pytest.mark.parametrize("group", ["method", "dataset"])
def test_every_method_and_dataset_stands_in_its_table(group: registry.Group) -> None:
    text = (ROOT / "docs" / f"{group}s.md").read_text(encoding="utf-8")
    assert [name for name in registry.entries(group) if f"`{name}`" not in text] == []


def test_the_table_of_methods_names_the_file_that_each_network_takes() -> None:
    text = (ROOT / "docs" / "methods.md").read_text(encoding="utf-8")
    files = {}
    for name, entry in registry.entries("method").items():
        if entry.needs_weights:
            file = entry.values()["weights"]["file"]
            file = file if "${" not in file else composed([f"method={name}"])["method"]["weights"]["file"]
            files[name] = file.removesuffix(".pth.tar")
    assert len(files) >= 15
    assert [name for name, file in files.items() if file not in text] == ["mixvpr_128", "mixvpr_512"]  # "two others"
