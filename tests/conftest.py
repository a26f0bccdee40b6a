"""No test reaches for the internet or for a person's weights and trainings, and none leaves large files behind."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from itertools import count
from pathlib import Path

import pytest

os.environ["VPRBENCH_OFFLINE"] = "1"
os.environ["VPRBENCH_WEIGHTS"] = tempfile.mkdtemp(prefix="vprbench-no-weights-")
PARTIAL = "VPRBENCH_PARTIAL"
NUMBERS = count()


@pytest.fixture(scope="session", autouse=True)
def partial_trainings(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The folder that keeps partial trainings: fixtures that several tests share train before a test has its own."""
    folder = tmp_path_factory.mktemp("partial")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(PARTIAL, str(folder))
        yield folder


@pytest.fixture(autouse=True)
def _own_partial_trainings(partial_trainings: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No test goes on with what another has left."""
    monkeypatch.setenv(PARTIAL, str(partial_trainings / str(next(NUMBERS))))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A folder that is emptied in the end: files of weights are large."""
    folder = tmp_path_factory.mktemp("weights")
    yield folder
    for path in folder.iterdir():
        path.unlink()
