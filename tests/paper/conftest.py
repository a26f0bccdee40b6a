"""A table of the small plan, made once for all tests of tables and figures that are made of stored runs."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from small_plan import RUN, Apart, install

from vprbench.cli import main


@pytest.fixture(scope="session")
def made(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Path, Apart, int]]:
    """A folder in which the table was made, what was run for it, and the exit code; nobody writes there."""
    folder = tmp_path_factory.mktemp("made")
    with pytest.MonkeyPatch.context() as monkeypatch:
        apart = install(monkeypatch, folder)
        code = main(["table", "seeds=1", "devices=[cpu]", *RUN])
    yield folder, apart, code
    shutil.rmtree(folder)


@pytest.fixture
def copied(made: tuple[Path, Apart, int], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Apart:
    """A copy of that folder to work in; what stands in for processes remembers what is asked from now on."""
    shutil.copytree(made[0] / "results", tmp_path / "results")
    return install(monkeypatch, tmp_path)
