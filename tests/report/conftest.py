"""A table of the small plan, made once for all tests of tables and figures that are made of stored runs."""

import shutil

import pytest
from small_plan import RUN, install

from vprbench.cli import main


@pytest.fixture(scope="session")
def made(tmp_path_factory):
    """A folder in which the table was made, what was run for it, and the exit code; nobody writes there."""
    folder = tmp_path_factory.mktemp("made")
    with pytest.MonkeyPatch.context() as monkeypatch:
        apart = install(monkeypatch, folder)
        code = main(["table", "rows=[SAD,PCA,Nobody]", "seeds=1", "devices=[cpu]", *RUN])
    yield folder, apart, code
    shutil.rmtree(folder)


@pytest.fixture
def copied(made, tmp_path, monkeypatch):
    """A copy of that folder to work in; what stands in for processes remembers what is asked from now on."""
    shutil.copytree(made[0] / "results", tmp_path / "results")
    return install(monkeypatch, tmp_path)
