"""Imports point down: plug-ins see the contract alone, and only the named files know Hydra or matplotlib."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]

FOR_PLUGINS = {
    "compiled",
    "data_folder",
    "search",
    "api",
    "errors",
    "image_formats",
    "images",
    "mat_files",
    "partial",
    "preprocess",
    "progress",
    "weights",
    "resize",
    "neural",
}


def imported(path: Path) -> set[str]:
    """The modules that a file imports, inside functions too, but not those for types alone."""
    found = set()
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for_types = {
        id(inner)
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and getattr(node.test, "id", "") == "TYPE_CHECKING"
        for inner in ast.walk(node)
    }
    for node in ast.walk(tree):
        if id(node) in for_types:
            continue
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            found.add(node.module or "")
            if node.module == "vprbench":
                found |= {f"vprbench.{alias.name}" for alias in node.names}
    return found


def own(path: Path) -> set[str]:
    return {name.split(".")[1] for name in imported(path) if name.startswith("vprbench.")}


@pytest.mark.parametrize(("library", "home"), [("matplotlib", "figures"), ("optuna", "tuning")])
def test_a_library_is_imported_in_one_package(library: str, home: str) -> None:
    knowing = {
        path.relative_to(ROOT / "vprbench").parts[0]
        for path in (ROOT / "vprbench").rglob("*.py")
        if any(name.split(".")[0] == library for name in imported(path))
    }
    assert knowing == {home}


PLUG_INS = [*(ROOT / "methods").rglob("*.py"), *(ROOT / "datasets").rglob("*.py")]


@pytest.mark.parametrize("path", PLUG_INS, ids=lambda path: str(path.relative_to(ROOT)))
def test_a_plug_in_imports_only_the_contract(path: Path) -> None:
    assert own(path) <= FOR_PLUGINS


def test_only_registry_and_command_line_know_hydra() -> None:
    knowing = [p.stem for p in (ROOT / "vprbench").glob("*.py") if any(n.startswith("hydra") for n in imported(p))]
    assert sorted(knowing) == ["cli", "composing", "registry"]


def test_runner_and_tables_meet_only_in_records() -> None:
    assert "runner" not in own(ROOT / "vprbench" / "tables.py")
    assert "tables" not in own(ROOT / "vprbench" / "runner.py")
