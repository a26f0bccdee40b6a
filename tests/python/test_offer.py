"""What `import vprbench` offers: functions that cost nothing until they are asked for, and rooms that are called."""

import ast
import inspect
import subprocess
import sys
from importlib import import_module

import nbformat
import pytest
from checkout import ROOT
from nbclient import NotebookClient

import vprbench


def test_importing_the_package_imports_nothing_else():
    code = "import sys; before = {*sys.modules}; import vprbench; print(*({*sys.modules} - before))"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    found = done.stdout.split()
    assert {name for name in found if name.startswith("vprbench")} == {"vprbench"}
    assert {name.partition(".")[0] for name in found} <= {"vprbench", "lazy_loader"} | sys.stdlib_module_names


def test_type_checkers_see_the_names_that_programs_find():
    tree = ast.parse((ROOT / "vprbench/__init__.pyi").read_text(encoding="utf-8"))
    imports = [node for node in tree.body if isinstance(node, ast.ImportFrom)]
    assert sorted(alias.name for node in imports for alias in node.names) == sorted(vprbench.__all__)
    for module, name in ((str(node.module), alias.name) for node in imports for alias in node.names):
        found, wanted = getattr(vprbench, name), getattr(import_module(f"vprbench.{module}"), name)
        assert found is wanted or (inspect.ismodule(found) and found().equals(wanted()))


def test_a_room_that_has_the_name_of_a_function_is_both_and_registered_methods_and_datasets_are_tables():
    assert list(inspect.signature(vprbench.run).parameters) == ["method", "dataset", "options"]
    with pytest.raises(AttributeError, match="compre"):
        _ = vprbench.compre
    methods, datasets = vprbench.methods().set_index("name"), vprbench.datasets().set_index("name")
    assert methods.loc[["vprtempo", "netvlad", "sad"], "spiking"].tolist() == [True, False, False]
    assert methods.loc[["vprtempo", "netvlad", "sad"], "needs_weights"].tolist() == [False, True, False]
    assert datasets.loc["synthetic", "provider"] == "vprbench"
    assert datasets["description"].str.len().min() > 0


@pytest.mark.extended
def test_the_notebook_of_the_documentation_runs_from_its_first_cell_to_its_last_and_keeps_small_outputs(
    tmp_path, monkeypatch
):
    def shown():
        """Return the kinds of what each cell shows."""
        outputs = [output for cell in book.cells for output in cell.get("outputs", [])]
        return [sorted(output["data"]) for output in outputs if output["output_type"] != "stream"]

    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    path = ROOT / "docs/first_steps.ipynb"
    book = nbformat.read(path, as_version=4)
    stored = shown()
    NotebookClient(book, timeout=120, kernel_name="python3", resources={"metadata": {"path": str(tmp_path)}}).execute()
    assert shown() == stored
    assert "R@1 95.0 [76.4, 99.1] %" in book.cells[1].outputs[-1]["data"]["text/plain"]
    assert len(list(tmp_path.rglob("run.json"))) == 2  # a class of a cell has no file: its runs are not stored
    assert path.stat().st_size < 200_000
