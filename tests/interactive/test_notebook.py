"""The notebook of the documentation runs from its first cell to its last, and keeps small outputs."""

from __future__ import annotations

from pathlib import Path

import nbformat
import pytest
from checkout import ROOT
from nbclient import NotebookClient

NOTEBOOK = ROOT / "docs/first_steps.ipynb"


@pytest.mark.extended
def test_the_first_steps_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    book = nbformat.read(NOTEBOOK, as_version=4)  # type: ignore[no-untyped-call]
    stored = [_shown(cell) for cell in book.cells]
    NotebookClient(book, timeout=120, kernel_name="python3", resources={"metadata": {"path": str(tmp_path)}}).execute()
    assert [_shown(cell) for cell in book.cells] == stored
    assert "R@1 95.0 [76.4, 99.1] %" in book.cells[1].outputs[-1]["data"]["text/plain"]
    assert len(list(tmp_path.rglob("run.json"))) == 5
    assert NOTEBOOK.stat().st_size < 200_000


def _shown(cell: nbformat.NotebookNode) -> list[str]:
    """Return the kinds of what a cell shows."""
    return [sorted(output["data"]) for output in cell.get("outputs", []) if output["output_type"] != "stream"]
