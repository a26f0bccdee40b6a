"""Folders of frames that may not be read are missing ones: named, with what to do, never a crash."""

import ctypes
import os
from contextlib import contextmanager, nullcontext

import pytest
from checkout import is_readable

from vprbench.api import NotThere
from vprbench.datasets.nordland import chosen_names, nordland

LINUX_CAPABILITIES_3 = 0x20080522
READ_EVERYTHING = 1 << 1 | 1 << 2  # CAP_DAC_OVERRIDE and CAP_DAC_READ_SEARCH of capabilities(7)


@contextmanager
def closed(folder):
    """Take from this process the right to read a folder, and from root the right to read it nevertheless."""
    mode = folder.stat().st_mode
    folder.chmod(0)
    try:
        with without_the_rights_of_root() if os.geteuid() == 0 else nullcontext():
            yield
    finally:
        folder.chmod(mode)


@contextmanager
def without_the_rights_of_root():
    """Take from this thread, and give back, the capabilities that let root read every file."""
    system = ctypes.CDLL(None, use_errno=True)
    if not hasattr(system, "capset"):
        pytest.skip("root can read every folder here: run the tests as another user")
    header = (ctypes.c_uint32 * 2)(LINUX_CAPABILITIES_3, 0)
    rights = (ctypes.c_uint32 * 6)()
    system.capget(header, rights)
    fewer = (ctypes.c_uint32 * 6)(rights[0] & ~READ_EVERYTHING, *rights[1:])
    assert system.capset(header, fewer) == 0, os.strerror(ctypes.get_errno())
    try:
        yield
    finally:
        system.capset(header, rights)


@pytest.fixture
def seasons(tmp_path, monkeypatch):
    """The folders of two seasons, with a file for each of ten places; no season was downloaded."""
    monkeypatch.setenv("VPRBENCH_DATA", str(tmp_path / "none"))
    for season in ("summer", "winter"):
        (tmp_path / "seasons" / season).mkdir(parents=True)
        for name in chosen_names(1, 10, 10):
            (tmp_path / "seasons" / season / name).touch()
    return tmp_path / "seasons"


def ask(**root):
    places = {"places": 10, "query_places": 10, "first_query_place": 0}
    nordland("frames", references=["winter"], stride=1, frame_multiple=10, **places, **root)


@pytest.mark.parametrize("option", ["root", "default_root"])
@pytest.mark.parametrize("which", [".", "winter", ".."])
def test_frames_that_may_not_be_read_are_frames_that_are_not_there(seasons, which, option):
    ask(**{option: str(seasons)})
    with closed((seasons / which).resolve()):
        assert not is_readable(seasons / which / "winter")
        with pytest.raises(NotThere, match="winter"):
            ask(**{option: str(seasons)})
    ask(**{option: str(seasons)})


def test_a_name_that_no_folder_can_have_is_a_folder_that_is_not_there(seasons):
    with pytest.raises(NotThere):
        ask(root=f"{seasons}\0")
