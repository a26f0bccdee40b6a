"""Imports point down: plug-ins see the contract alone, and only the named files know Hydra or matplotlib."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]

# From the bottom up; a file may import only what stands before it.
ORDER = [
    "printable",
    "ending",
    "compiled",
    "replacing",
    "search",
    "interface",
    "homes",
    "data_folder",
    "archives",
    "mat_child",
    "mat_files",
    "png_pixels",
    "png",
    "image_formats",
    "spikes",
    "progress",
    "unpacking",
    "file_hashes",
    "download",
    "pickled_numpy",
    "weights",
    "ahead",
    "images",
    "doctor",
    "data_record",
    "frames",
    "resize",
    "neural",
    "preprocess_compiled",
    "preprocess",
    "networks",
    "ranking",
    "block_length",
    "intervals",
    "metrics",
    "tolerance",
    "stopwatch",
    "environment",
    "partial",
    "array_cache",
    "record_rules",
    "records",
    "tuned",
    "store",
    "recall_intervals",
    "sources",
    "harness",
    "descriptor_cache",
    "described",
    "preprocessed",
    "learning",
    "runner",
    "summary",
    "tables",
    "plan",
    "series",
    "cells",
    "belonging",
    "absence",
    "comparison",
    "contests",
    "entries",
    "table_caption",
    "assembly",
    "layout",
    "table_latex",
    "table_html",
    "table_formats",
    "growth_models",
    "growth_series",
    "figures",
    "report",
    "returned_dataset",
    "registry",
    "fetch_entries",
    "fetched",
    "conformance",
    "options",
    "console",
    "sweep",
    "answer",
    "workload",
    "measures",
    "bench_report",
    "bench_reading",
    "fetching",
    "bench_vprsnn",
    "bench",
    "bench_cells",
    "bench_reading_text",
    "bench_vprsnn_text",
    "bench_text",
    "descriptor_bench",
    "gpu_check",
    "tuning",
    "fill",
    "paper",
    "paper_table",
    "paper_figures",
    "paper_report",
    "composing",
    "commands",
    "cli",
    "__main__",
]
FOR_PLUGINS = {
    "compiled",
    "data_folder",
    "search",
    "interface",
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


def test_every_module_has_its_place_in_the_order() -> None:
    modules = {path.stem for path in (ROOT / "vprbench").glob("*.py")} - {"__init__"}
    packages = {path.parent.name for path in (ROOT / "vprbench").glob("*/__init__.py")}
    assert modules | packages == set(ORDER)


@pytest.mark.parametrize("module", ORDER)
def test_a_module_imports_only_what_stands_below_it(module: str) -> None:
    below = set(ORDER[: ORDER.index(module)])
    if (ROOT / "vprbench" / f"{module}.py").exists():
        assert own(ROOT / "vprbench" / f"{module}.py") <= below
    for path in (ROOT / "vprbench" / module).glob("*.py"):
        assert own(path) <= below | {module}


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
