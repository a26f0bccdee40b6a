"""The timing slot of a host: one cell has it, the others are stopped or gone, and no kill leaves it taken."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from threading import Timer

import psutil
import pytest

from vprbench.run import slot

HOLDER = "from vprbench.run import slot\nwith slot.alone(): print(flush=True), __import__('time').sleep(60)"


@pytest.fixture(autouse=True)
def _host(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Work on a host where nothing runs."""
    monkeypatch.setenv(slot.FOLDER, str(tmp_path / "slot"))


@contextmanager
def held_elsewhere() -> Iterator[psutil.Popen]:
    """Let another process have the slot."""
    with psutil.Popen([sys.executable, "-c", HOLDER], stdout=subprocess.PIPE) as process:
        assert process.stdout.readline()
        try:
            yield process
        finally:
            with suppress(psutil.NoSuchProcess):
                process.kill()


def test_who_wants_to_be_alone_waits_for_the_others() -> None:
    place = slot.Place(1)
    place.enter()
    Timer(0.3, place.leave).start()
    began = time.monotonic()
    with slot.alone() as alone:
        assert time.monotonic() - began >= 0.3
        assert slot.taken()
        assert alone()
    assert not slot.taken()


@pytest.mark.parametrize("stays", [True, False])
def test_a_time_beside_what_cannot_be_stopped_is_not_alone(stays: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(slot, "_PATIENCE", 0.0)
    place = slot.Place(1)
    with ExitStack() as until_now:
        if stays:
            place.enter()
        alone = until_now.enter_context(slot.alone())
        time.sleep(0.02)
        place.enter()
        place.end()
        assert not alone()


def test_a_cell_that_came_and_went_has_disturbed_and_one_that_was_killed_is_forgotten() -> None:
    killed = slot.folder() / "running" / "1-0"
    killed.parent.mkdir()
    killed.touch()
    undisturbed = slot.undisturbed()
    assert undisturbed()
    assert not killed.exists()
    time.sleep(0.02)
    place = slot.Place(1)
    place.enter()
    assert not undisturbed()
    place.end()
    assert not undisturbed()
    time.sleep(0.02)
    assert slot.undisturbed()()


def test_a_kill_gives_the_slot_back_and_a_stopped_process_is_not_waited_for() -> None:
    with held_elsewhere() as process:
        assert slot.taken()
        process.suspend()
        while process.status() != psutil.STATUS_STOPPED:
            time.sleep(0.01)
        assert not slot.taken()
        with slot.alone() as alone:
            assert not alone()
        process.kill()
        process.wait()
        with slot.alone() as alone:
            assert alone()


def test_each_cell_of_a_sweep_has_a_gpu_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "GPU-a,GPU-b")
    slot._gpus.cache_clear()
    with slot.turn(["device=cpu", "device=cuda"], lambda: False) as first:
        assert first == {"CUDA_VISIBLE_DEVICES": "GPU-a"}
        with slot.turn(["device=cuda:1"], lambda: False) as numbered, slot.turn(["seed=1"], lambda: False) as none:
            assert numbered == none == {}
            looks = iter([False, True])
            with slot.turn(["device=cuda"], lambda: next(looks)) as given_up:
                assert given_up == {}
        with slot.turn(["device=cuda"], lambda: False) as second:
            assert second == {"CUDA_VISIBLE_DEVICES": "GPU-b"}
    slot._gpus.cache_clear()
