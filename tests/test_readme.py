"""What the README shows works as it stands there."""

import csv
import importlib
import re
import shutil
import subprocess
from itertools import product

import pytest
from checkout import ROOT

from vprbench.cli import main
from vprbench.plugins import registry
from vprbench.report.plan import read_plan
from vprbench.report.table.quantities import TRAINING_TIME

README = (ROOT / "README.md").read_text(encoding="utf-8")
PLUG_INS = (ROOT / "docs" / "plug-ins.md").read_text(encoding="utf-8")


def committed(path):
    """Return a file as it was committed: make table renews the one that lies there."""
    if shutil.which("git") is None:
        pytest.skip("git is not installed, which knows what was committed")
    told = subprocess.run(["git", "show", f"HEAD:./{path}"], cwd=ROOT, capture_output=True, text=True, check=False)
    if told.returncode:
        pytest.skip(f"no committed {path} here: {told.stderr.strip()}")
    return told.stdout


@pytest.mark.parametrize(("group", "name"), [("method", "darkness"), ("dataset", "lamps")])
def test_what_stands_in_two_files_keeps_the_contract(group, name, tmp_path, monkeypatch, capsys):
    for path in (f"{group}s/{name}.py", f"conf/{group}/{name}.yaml"):
        shown = re.search(rf"`{path}`:\n\n```\w+\n(.*?)```", PLUG_INS, re.DOTALL)
        assert shown, path
        (tmp_path / path).parent.mkdir(parents=True)
        (tmp_path / path).write_text(shown.group(1), encoding="utf-8")
    package = importlib.import_module(f"vprbench.{group}s")
    monkeypatch.setattr(package, "__path__", [*package.__path__, str(tmp_path / f"{group}s")])
    folders = {**registry.find_conf_folders(), "two files": tmp_path / "conf"}
    monkeypatch.setattr("vprbench.plugins.entries.find_conf_folders", lambda: folders)
    assert main(["check", f"{group}={name}"]) == 0
    assert " 0 broken" in capsys.readouterr().out


DOCUMENTS = ("README.md", "CONTRIBUTING.md", *(f"docs/{path.name}" for path in (ROOT / "docs").glob("*.md")))
EXAMPLES = ("methods/darkness.py", "conf/method/darkness.yaml", "datasets/lamps.py", "conf/dataset/lamps.yaml")
NOT_OURS = {"vprbench/weights", *EXAMPLES}  # a folder of a user


@pytest.mark.parametrize("document", DOCUMENTS)
def test_the_files_that_a_document_names_exist(document):
    text = (ROOT / document).read_text(encoding="utf-8")
    named = set(re.findall(r"`((?:methods|datasets|tests|docs|conf|vprbench)/[\w./-]+)`", text)) - NOT_OURS
    linked = set(re.findall(r"\]\(((?!http)[\w./-]+)\)", text))
    assert [path for path in sorted(named) if "NAME" not in path and not (ROOT / path).exists()] == []
    assert [path for path in sorted(linked) if not (ROOT / document).parent.joinpath(path).exists()] == []


def shown(name, readme=README):
    found = re.search(rf"<!-- {name} -->\n(.*?)<!-- /{name} -->", readme, re.DOTALL)
    assert found
    return found.group(1)


def test_the_readme_fits_two_screens_and_the_documents_say_what_the_page_does():
    assert len(README.splitlines()) <= 110
    assert "is best" in shown("compare") or "leads" in shown("compare")
    assert TRAINING_TIME in " ".join((ROOT / "docs" / "numbers.md").read_text(encoding="utf-8").split())


def test_the_table_it_shows_is_the_stored_one_beside_the_papers():
    table, text = committed("results/table.csv"), shown("table", committed("README.md"))
    cells = {(c["row"], c["column"], c["quantity"]): c for c in csv.DictReader(table.splitlines())}
    lines = [[cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines() if "|" in line]
    assert len(lines) <= 12
    for name, *values in lines[2:]:
        numbers = product(("railway", "railway_winter"), ("recall_at_1", "train_cpu", "query_cpu"))
        of_row = [cells[name.strip("*"), *number] for number in numbers]
        for cell, value in zip(of_row, values, strict=True):
            published = f"{float(cell['published']):,g}" if cell["published"] else "-"
            assert value.endswith(f"({published})")
            if cell["value"] and cell["mark"] == "measured":
                digits = float(value.split()[0].strip("*~").replace(",", ""))
                assert digits == pytest.approx(float(cell["value"]), rel=0.06)
    assert [name.strip("*") for name, *_ in lines[2:]] == [*read_plan(ROOT / "conf" / "paper" / "table2.yaml").rows]


@pytest.mark.parametrize("group", ["method", "dataset"])
def test_every_method_and_dataset_stands_in_its_table(group):
    text = (ROOT / "docs" / f"{group}s.md").read_text(encoding="utf-8")
    assert [name for name in registry.find_entries(group) if f"`{name}`" not in text] == []
