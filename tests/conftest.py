"""No test reaches for the internet or for what a person keeps of runs, and none leaves large files behind."""

import os
import signal
import tempfile
from itertools import count

import pytest
from checkout import SHARED
from served_files import serving

os.environ["VPRBENCH_OFFLINE"] = "1"
EMPTY = tempfile.TemporaryDirectory(prefix="vprbench-tests-")
for name in ("VPRBENCH_WEIGHTS", "VPRBENCH_DATA", "VPRBENCH_SLOT", "HYPOTHESIS_STORAGE_DIRECTORY"):
    os.environ[name] = tempfile.mkdtemp(dir=EMPTY.name)
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell lets what runs in its background ignore it
PARTIAL = "VPRBENCH_PARTIAL"
NUMBERS = count()


def pytest_unconfigure():
    """Leave nothing of the tests behind."""
    EMPTY.cleanup()


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """Tests of real frames are extended, and skipped where there are none."""
    for item in items:
        if item.get_closest_marker("real_frames"):
            item.add_marker(pytest.mark.extended)
            if not SHARED.is_dir():
                item.add_marker(pytest.mark.skip(reason="no folder shared/ that can be read lies beside the checkout"))


@pytest.fixture(scope="session", autouse=True)
def partial_trainings(tmp_path_factory):
    """The folder that keeps partial trainings: fixtures that several tests share train before a test has its own."""
    folder = tmp_path_factory.mktemp("partial")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(PARTIAL, str(folder))
        yield folder


@pytest.fixture(autouse=True)
def _own_partial_trainings(partial_trainings, monkeypatch):
    """No test goes on with what another has left."""
    monkeypatch.setenv(PARTIAL, str(partial_trainings / str(next(NUMBERS))))


@pytest.fixture(scope="session", autouse=True)
def _own_file_hashes(tmp_path_factory):
    """No test keeps hashes of files or rendered frames in a person's cache."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("VPRBENCH_FRAMES", str(tmp_path_factory.mktemp("frames")))
        patch.setenv("VPRBENCH_HASHES", str(tmp_path_factory.mktemp("hashes")))
        yield


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder that is emptied in the end: files of weights are large."""
    folder = tmp_path_factory.mktemp("weights")
    yield folder
    for path in folder.iterdir():
        path.unlink()


@pytest.fixture
def on_the_net(monkeypatch):
    """Downloads are allowed, and ask the servers of the tests whatever stands between this machine and the net."""
    monkeypatch.delenv("VPRBENCH_OFFLINE")
    for name in ("no_proxy", "NO_PROXY"):
        monkeypatch.setenv(name, "*")


@pytest.fixture
def server():
    """A server of files; nothing is served yet."""
    with serving() as server:
        yield server
