"""Partial trainings beside full disks, killed processes and others that train the same: nothing costs the training."""

from __future__ import annotations

import errno
import multiprocessing
import shutil
import signal
import threading
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from itertools import count
from pathlib import Path
from typing import Any, NoReturn

import pytest
from partial_worker import (
    FOUR,
    MODULES,
    WHAT,
    Interrupted,
    interrupt,
    interrupted,
    module,
    said,
    train,
    train_and_die,
    train_often,
    whole,
)

from vprbench.api import checkpoints

# A disk that refuses


def test_what_was_kept_before_the_disk_was_full_stays_and_the_training_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def full_disk(*_: Any) -> NoReturn:
        raise OSError(errno.ENOSPC, "No space left on device")

    home = interrupt(tmp_path, **{"module-0": module(0)})
    monkeypatch.setattr(checkpoints, "replace_bytes", full_disk)
    with interrupted(), checkpoints.training(WHAT, tmp_path) as kept:
        for number in range(3):
            kept.put(f"module-{number}", module(number + 1))
        raise Interrupted
    assert [path.name for path in home.iterdir()] == ["module-0.safetensors"]
    assert train(tmp_path) == ([1, 2, 3, 4], True)
    lines = said(caplog)
    assert len(lines) == 2
    assert all("No space left on device" in line for line in lines)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("place", ["file", "file/deeper", "x" * 300])
def test_a_place_that_cannot_be_written_costs_one_line(
    tmp_path: Path, place: str, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "file").touch()
    assert train(tmp_path / place) == ([*range(MODULES)], True)
    assert len(said(caplog)) == 1


# Several processes


@pytest.fixture(scope="module")
def processes() -> multiprocessing.context.ForkServerContext:
    """Processes that start in no time, because one that has imported what they need makes them."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["vprbench.api.checkpoints"])
    return context


def test_a_training_that_was_killed_at_any_point_goes_on_with_what_it_had_kept(tmp_path: Path, processes: Any) -> None:
    numbers_kept = set()
    for step in count():
        root = tmp_path / str(step)
        child = processes.Process(target=train_and_die, args=(root, step))
        child.start()
        child.join()
        if child.exitcode == 0:
            break
        assert child.exitcode == -signal.SIGKILL
        parts = [path.stem for path in root.glob("*/module-*.safetensors")]
        numbers_kept.add(len(parts))
        trained, right = train(root)
        assert right
        assert trained == [number for number in range(MODULES) if f"module-{number}" not in parts]
        assert list(root.iterdir()) == []
    assert numbers_kept == {*range(MODULES + 1)}


def test_several_processes_at_once_train_the_same_without_harm(tmp_path: Path, processes: Any) -> None:
    with ProcessPoolExecutor(4, mp_context=processes) as pool:
        assert list(pool.map(train_often, [tmp_path] * 4, [25] * 4)) == [True] * 4
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_another_process_removes_is_made_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write, removed = checkpoints.replace_bytes, []

    def remove_first(path: Path, content: bytes) -> None:
        if not removed:
            removed.append(path.parent)
            shutil.rmtree(path.parent)
        write(path, content)

    monkeypatch.setattr(checkpoints, "replace_bytes", remove_first)
    interrupt(tmp_path, part=FOUR)
    assert len(removed) == 1
    with checkpoints.training(WHAT, tmp_path) as kept:
        assert kept.get("part") is not None


def test_a_folder_that_is_removed_again_and_again_is_given_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def remove(path: Path, content: bytes) -> None:
        shutil.rmtree(path.parent)
        raise FileNotFoundError(errno.ENOENT, "No such file or directory", str(path))

    monkeypatch.setattr(checkpoints, "replace_bytes", remove)
    assert train(tmp_path) == ([*range(MODULES)], True)
    assert len(said(caplog)) == 1


def test_threads_that_keep_parts_at_once_lose_none(tmp_path: Path) -> None:
    together = threading.Barrier(8)

    def one(number: int) -> None:
        together.wait()
        kept.put(f"module-{number}", module(number))

    with checkpoints.training(WHAT, tmp_path) as kept, ThreadPoolExecutor(8) as pool:
        list(pool.map(one, range(8)))
        found = [kept.get(f"module-{number}") for number in range(8)]
    assert all(arrays is not None and whole(number, arrays) for number, arrays in enumerate(found))
