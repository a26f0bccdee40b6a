"""What the README shows works as it stands there."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tomllib
from itertools import pairwise
from pathlib import Path

import hydra
import pytest
from checkout import ROOT

from vprbench.paper.plan import read_plan
from vprbench.paper.table.quantities import QUANTITIES, TRAINING_TIME
from vprbench.plugins import registry

README = (ROOT / "README.md").read_text(encoding="utf-8")


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    for part in ("vprbench", "methods", "datasets", "conf"):
        shutil.copytree(ROOT / part, tmp_path / part)
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    return tmp_path


def test_the_method_in_two_files_keeps_the_contract(checkout: Path) -> None:
    for path, language in (("methods/darkness.py", "python"), ("conf/method/darkness.yaml", "yaml")):
        shown = re.search(rf"`{path}`:\n\n```{language}\n(.*?)```", README, re.DOTALL)
        assert shown, path
        (checkout / path).write_text(shown.group(1), encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-m", "vprbench", "check", "method=darkness", "method.cells=4"],
        cwd=checkout,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert "0 broken" in done.stdout, done.stdout + done.stderr


DOCUMENTS = ("README.md", "CONTRIBUTING.md", *(f"docs/{path.name}" for path in (ROOT / "docs").glob("*.md")))
NOT_OURS = {"methods/darkness.py", "conf/method/darkness.yaml", "vprbench/weights"}  # the example; a folder of a user


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


def shown(name: str) -> str:
    found = re.search(rf"<!-- {name} -->\n(.*?)<!-- /{name} -->", README, re.DOTALL)
    assert found
    return found.group(1)


def test_the_time_of_training_is_told_in_the_words_of_the_page() -> None:
    assert TRAINING_TIME in " ".join(README.split())


def test_what_it_shows_of_a_run_is_filled_in() -> None:
    assert "vprtempo" in shown("run")


def test_the_table_it_shows_has_the_columns_and_rows_of_the_plan() -> None:
    plan = read_plan(ROOT / "conf" / "table.yaml")
    heads = ["method", *(f"{quantity.head} {quantity.unit}" for quantity in QUANTITIES)]
    stand_ins = [column for column in plan.columns.values() if column.stand_in_for and not column.on_request]
    published = [column.title for column in stand_ins if column.published]
    sections = dict(re.findall(r"^## (.*)\n((?:(?!## ).*\n)*)", shown("table"), re.MULTILINE))
    assert [*sections][: len(published)] == published
    assert {*sections} <= {column.title for column in stand_ins}  # the smaller ones, where slow rows run
    for title, section in sections.items():
        lines = [[cell.strip() for cell in line.split("|")[1:-1]] for line in section.splitlines() if "|" in line]
        assert lines[0] == heads
        names = [line[0] for line in lines if line[0] in plan.rows]
        assert names == [*plan.rows]
        assert [line[0] for line in lines].count("\u21b3 paper") == (len(names) if title in published else 0)


def test_every_method_stands_in_the_readme_and_in_the_table_of_methods() -> None:
    for document in ("README.md", "docs/methods.md"):
        text = (ROOT / document).read_text(encoding="utf-8")
        assert [name for name in registry.entries("method") if f"`{name}`" not in text] == []


def test_every_dataset_stands_in_the_readme_and_in_the_table_of_datasets() -> None:
    for document in ("README.md", "docs/datasets.md"):
        text = (ROOT / document).read_text(encoding="utf-8")
        assert [name for name in registry.entries("dataset") if f"`{name}`" not in text] == []


def test_the_table_of_methods_names_the_file_that_each_network_takes() -> None:
    text = (ROOT / "docs" / "methods.md").read_text(encoding="utf-8")
    files = {}
    with hydra.initialize_config_module("vprbench.conf", version_base="1.3"):
        for name in registry.entries("method"):
            config = hydra.compose("run", overrides=[f"method={name}"]).method
            if "weights" in config:
                files[name] = config.weights.file.removesuffix(".pth.tar")
    assert len(files) >= 15
    assert [name for name, file in files.items() if file not in text] == ["mixvpr_128", "mixvpr_512"]  # "two others"
