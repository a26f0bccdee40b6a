"""No test reaches for the internet or for a person's weights, and none leaves large files behind."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

os.environ["VPRBENCH_OFFLINE"] = "1"
os.environ["VPRBENCH_WEIGHTS"] = tempfile.mkdtemp(prefix="vprbench-no-weights-")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A folder that is emptied in the end: files of weights are large."""
    folder = tmp_path_factory.mktemp("weights")
    yield folder
    for path in folder.iterdir():
        path.unlink()
