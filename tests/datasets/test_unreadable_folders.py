"""Folders of frames that may not be read are missing ones: named, with what to do, never a crash."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from checkout import is_readable

from vprbench.api import NotThere
from vprbench.datasets.nordland import chosen_names, nordland

NOBODY = 65534


@contextmanager
def closed(folder: Path) -> Iterator[None]:
    """Take from this process the right to read a folder, which root has until it acts as somebody else."""
    root = os.geteuid() == 0
    private = [parent for parent in folder.parents if root and parent.stat().st_mode & 0o055 != 0o055]
    modes = {path: path.stat().st_mode for path in (folder, *private)}
    for path, mode in modes.items():
        path.chmod(0 if path == folder else mode | 0o055)
    if root:
        os.seteuid(NOBODY)
    try:
        yield
    finally:
        if root:
            os.seteuid(0)
        for path, mode in modes.items():
            path.chmod(mode)


@pytest.fixture
def seasons(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folders of two seasons, with a file for each of ten places; no season was downloaded."""
    monkeypatch.setenv("VPRBENCH_DATA", str(tmp_path / "none"))
    for season in ("summer", "winter"):
        (tmp_path / "seasons" / season).mkdir(parents=True)
        for name in chosen_names(1, 10, 10):
            (tmp_path / "seasons" / season / name).touch()
    return tmp_path / "seasons"


def ask(**root: str) -> None:
    places = {"places": 10, "query_places": 10, "first_query_place": 0}
    nordland("frames", references=["winter"], stride=1, frame_multiple=10, **places, **root)


@pytest.mark.parametrize("option", ["root", "default_root"])
@pytest.mark.parametrize("which", [".", "winter", ".."])
def test_frames_that_may_not_be_read_are_frames_that_are_not_there(seasons: Path, which: str, option: str) -> None:
    ask(**{option: str(seasons)})
    with closed((seasons / which).resolve()):
        assert not is_readable(seasons / which / "winter")
        with pytest.raises(NotThere, match="winter"):
            ask(**{option: str(seasons)})
    ask(**{option: str(seasons)})


def test_a_name_that_no_folder_can_have_is_a_folder_that_is_not_there(seasons: Path) -> None:
    with pytest.raises(NotThere):
        ask(root=f"{seasons}\0")
