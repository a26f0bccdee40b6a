"""What tests of runs share: surroundings that cost no time, and a clock that only tests move."""

import pytest
from little_runs import quiet_surroundings
from stopped_clock import Clock, ReadersThatWait

from vprbench.api import images
from vprbench.runs import run
from vprbench.runs.store import Store


@pytest.fixture(scope="module")
def surroundings():
    """The surroundings that the runs of a module see."""
    with quiet_surroundings() as stand_in:
        yield stand_in


@pytest.fixture
def clock(monkeypatch):
    """The clock of runs and of reading."""
    clock = Clock()
    clock.replaces_those_of([run, images], monkeypatch)
    monkeypatch.setattr(images, "ThreadPoolExecutor", ReadersThatWait)
    return clock


@pytest.fixture
def store(tmp_path):
    """A store of runs in which nothing is."""
    store = Store(tmp_path / "results")
    store.prepare()
    return store
