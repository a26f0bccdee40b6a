"""Partial trainings: what an interrupted one had done is there again, whole and for the same training alone."""

import errno
import logging
import multiprocessing
import os
import shutil
import signal
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from contextvars import Context
from itertools import count

import numpy as np
import platformdirs
import pytest
from partial_worker import MODULES, WHAT, module, train, train_and_die, whole
from safetensors.numpy import save_file
from stopped_clock import Clock

from vprbench.api import checkpoints
from vprbench.storage import tensors

FOUR = {"w": np.arange(4.0)}


class Interrupted(Exception):
    """In place of whatever ends a training."""


def interrupt(root, what=WHAT, **parts):
    """Leave a training with some parts; returns its folder."""
    before = set(root.iterdir())
    with suppress(Interrupted), checkpoints.training(what, root) as kept:
        for name, arrays in parts.items():
            kept.put(name, arrays)
        raise Interrupted
    (home,) = set(root.iterdir()) - before
    return home


def spend(root, clock, *steps, then=0.0):
    """Spend seconds on parts, be interrupted after some more; returns what had been spent when this began."""
    with suppress(Interrupted), checkpoints.training(WHAT, root, clock.seconds) as kept:
        for path in root.glob("*/*.safetensors"):
            kept.get(path.stem)
        before = kept.seconds
        for name, seconds in steps:
            kept.get(name)
            clock.spend(seconds)
            kept.put(name, FOUR)
        clock.spend(then)
        raise Interrupted
    return before


def said(caplog):
    """The warnings so far."""
    return [record.getMessage() for record in caplog.records if record.levelno >= logging.WARNING]


def aged(path, days):
    moment = time.time() - days * 86400.0
    os.utime(path, (moment, moment))
    return path


ARRAYS = {
    "float32": np.arange(6, dtype=np.float32).reshape(2, 3),
    "a view": np.arange(24.0).reshape(2, 3, 4).transpose(2, 0, 1)[::2],
    "no axis": np.array(7, np.int64),
    "empty": np.zeros((0, 5), np.int16),
    "bool": np.array([True, False]),
    "big endian": np.arange(3, dtype=">i4"),
    "odd values": np.array([np.nan, -np.inf, -0.0, 5e-324]),
}


@pytest.mark.parametrize("end", [ValueError, KeyboardInterrupt, SystemExit])
def test_whatever_ends_a_training_early_leaves_its_arrays_as_they_were(tmp_path, end):
    with suppress(end), checkpoints.training({"seed": 1, "rates": (0.1, 0.2)}, tmp_path) as kept:
        kept.put("part", ARRAYS)
        raise end
    with checkpoints.training({"rates": [0.1, 0.2], "seed": 1}, tmp_path) as kept:
        found = kept.get("part")
    assert found.keys() == ARRAYS.keys()
    for name, array in ARRAYS.items():
        wanted = array.astype(array.dtype.newbyteorder("="))
        assert (found[name].dtype, found[name].shape) == (wanted.dtype, wanted.shape)
        assert found[name].tobytes() == wanted.tobytes()


def test_a_part_is_the_last_that_was_put_each_time_a_copy_and_nothing_is_left_in_the_end(tmp_path):
    with checkpoints.training(WHAT, tmp_path) as kept:
        kept.put("part", {"w": np.ones(2)})
        kept.put("part", FOUR)
        kept.get("part")["w"] += 1
        assert kept.get("part")["w"].tolist() == [0.0, 1.0, 2.0, 3.0]
        assert kept.get("second") is None
        assert list(tmp_path.rglob("*.safetensors"))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("other", [{"seed": 2, "rates": [0.1]}, {"seed": 1}])
def test_another_training_finds_nothing_and_leaves_what_is_there(tmp_path, other):
    home = interrupt(tmp_path, {"seed": 1, "rates": [0.1]}, part=FOUR)
    with checkpoints.training(other, tmp_path) as kept:
        assert kept.get("part") is None
        kept.put("part", FOUR)
    assert list(tmp_path.iterdir()) == [home]


def test_names_that_are_no_files_and_anything_but_arrays_of_numbers_are_refused(tmp_path):
    with checkpoints.training(WHAT, tmp_path) as kept:
        for name in ("", "../part", "a/b", ".part", "a b", "part\n"):
            for use in (kept.get, lambda name: kept.put(name, FOUR)):
                with pytest.raises(ValueError, match="names no part"):
                    use(name)
        for thing in (np.array([None]), np.array(["a"]), np.array([1j]), [1.0]):
            with pytest.raises(TypeError, match=r"weights is .*; wanted"):
                kept.put("part", {"weights": thing})


@pytest.mark.parametrize(
    "damage",
    [
        lambda path: path.write_bytes(path.read_bytes()[:-1]),
        lambda path: path.write_bytes(bytes(path.stat().st_size)),
        lambda path: path.write_bytes(path.read_bytes()[:-1] + b"\xff"),
        lambda path: save_file({"w": np.arange(4.0)}, path, {"seconds": "1.0"}),
    ],
    ids=["shorter", "zeroed", "another number", "of somebody else"],
)
def test_a_damaged_part_is_trained_anew_and_the_others_are_not(tmp_path, damage, caplog):
    clock = Clock()
    spend(tmp_path, clock, ("first", 5), ("second", 7))
    (first,) = tmp_path.glob("*/first.safetensors")
    damage(first)
    with checkpoints.training(WHAT, tmp_path) as kept:
        assert kept.get("first") is None
        assert kept.get("second") is not None
        assert kept.seconds == 7
        assert not first.exists()
        kept.put("first", FOUR)
        assert kept.get("first") is not None
    (line,) = said(caplog)
    assert "first.safetensors cannot be used" in line


def test_a_part_that_cannot_be_read_now_is_not_removed(tmp_path, monkeypatch):
    def refuse(*_, **__):
        raise OSError(errno.EMFILE, "Too many open files")

    interrupt(tmp_path, part=FOUR)
    with monkeypatch.context() as patch, suppress(Interrupted), checkpoints.training(WHAT, tmp_path) as kept:
        patch.setattr(tensors, "safe_open", refuse)
        assert kept.get("part") is None
        raise Interrupted
    with checkpoints.training(WHAT, tmp_path) as kept:
        assert kept.get("part") is not None


def test_what_a_killed_process_left_unfinished_is_removed_after_a_day(tmp_path):
    home = interrupt(tmp_path, part=FOUR)
    for name in (".partial-old", ".partial-new"):
        (home / name).touch()
    aged(home / ".partial-old", 1.1)
    with checkpoints.training(WHAT, tmp_path):
        assert sorted(path.name for path in home.iterdir()) == [".partial-new", "part.safetensors"]


def test_trainings_are_kept_for_thirty_days_since_they_last_went_on_and_files_of_others_for_ever(tmp_path):
    old, young = (interrupt(tmp_path, {"seed": seed}, part=FOUR) for seed in (1, 2))
    (old / "thesis.txt").touch()
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "net.safetensors").touch()
    for path, days in ((old, 31), (young, 29), (tmp_path / "photos", 365)):
        aged(path, days)
    with checkpoints.training({"another": 1}, tmp_path):
        left = [path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*") if path.is_file()]
    assert sorted(left) == sorted(
        [f"{old.name}/thesis.txt", f"{young.name}/part.safetensors", "photos/net.safetensors"]
    )
    aged(young, 365)
    with checkpoints.training({"seed": 2}, tmp_path) as kept:
        assert kept.get("part") is not None  # the one that is wanted is resumed however old
        aged(young, 365)
        kept.put("second", FOUR)
        with checkpoints.training({"another": 1}, tmp_path):
            pass
        assert kept.get("part") is not None


@pytest.mark.parametrize(
    ("chosen", "folder"), [("~/trainings", "trainings"), ("", "vprbench/partial"), (None, "vprbench/partial")]
)
def test_the_folder_is_the_one_that_was_chosen_or_in_the_users_cache(tmp_path, monkeypatch, chosen, folder):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.delenv("VPRBENCH_PARTIAL", raising=False)
    if chosen is not None:
        monkeypatch.setenv("VPRBENCH_PARTIAL", chosen)
    monkeypatch.setattr(platformdirs, "user_cache_path", lambda *names, **_: tmp_path.joinpath(*names))
    with checkpoints.training(WHAT) as kept:
        kept.put("part", FOUR)
        assert [path.name for path in tmp_path.joinpath(folder).glob("*/*")] == ["part.safetensors"]


def test_the_time_of_interrupted_runs_counts_once_until_the_last_part_of_each(tmp_path):
    clock = Clock()
    assert spend(tmp_path, clock, ("first", 5), ("second", 7), then=3) == 0
    assert spend(tmp_path, clock, ("third", 4), then=100) == 12
    assert spend(tmp_path, clock, ("third", 3), ("third", 2)) == 16  # put again, it keeps what it replaces
    assert spend(tmp_path, clock) == 21


def test_a_part_that_another_run_finishes_meanwhile_counts_where_it_is_taken(tmp_path):
    clock = Clock()
    with checkpoints.training(WHAT, tmp_path, clock.seconds) as kept:
        Context().run(spend, tmp_path, clock, ("first", 5), ("second", 7))
        assert kept.seconds == 0
        assert kept.get("first") is not None
        assert kept.seconds == 5


def test_a_ledger_tells_what_was_taken_over(tmp_path):
    clock = Clock()
    spend(tmp_path, clock, ("first", 5), ("second", 7))
    with checkpoints.ledger() as resumed:
        with checkpoints.training(WHAT, tmp_path) as kept:
            assert resumed.seconds == 0  # nothing was asked for yet
            assert kept.get("second") is not None
            assert resumed.seconds == 7
            assert kept.get("first") is not None
        with checkpoints.training({"another": 1}, tmp_path) as kept:
            assert kept.get("first") is None
    assert resumed.seconds == 12


def test_a_ledger_inside_another_is_the_same_and_its_own_parts_are_no_time_of_others(tmp_path):
    clock = Clock()
    with checkpoints.ledger() as outer:
        for what in (WHAT, {"another": 1}):
            with checkpoints.ledger() as inner, checkpoints.training(what, tmp_path, clock.seconds) as kept:
                clock.spend(5)
                kept.put("part", FOUR)
                assert kept.get("part") is not None
                assert kept.seconds == 0
            assert inner is outer
        assert outer.seconds == 0
        assert len([*tmp_path.glob("*/part.safetensors")]) == 2
    assert list(tmp_path.iterdir()) == []


def test_a_run_that_is_interrupted_in_its_second_training_keeps_the_first(tmp_path):
    clock = Clock()
    with suppress(Interrupted), checkpoints.ledger():
        with checkpoints.training(WHAT, tmp_path, clock.seconds) as kept:
            clock.spend(5)
            kept.put("part", FOUR)
        with checkpoints.training({"another": 1}, tmp_path):
            raise Interrupted
    with checkpoints.ledger() as resumed, checkpoints.training(WHAT, tmp_path) as kept:
        assert kept.get("part") is not None
    assert resumed.seconds == 5
    assert list(tmp_path.iterdir()) == []
    with checkpoints.ledger():
        home = interrupt(tmp_path, part=FOUR)
    assert list(tmp_path.iterdir()) == [home]  # whose error was caught


def test_a_training_that_is_opened_twice_in_a_ledger_goes_on_with_its_own(tmp_path):
    clock = Clock()
    with suppress(Interrupted), checkpoints.ledger() as resumed:
        with checkpoints.training(WHAT, tmp_path, clock.seconds) as kept:
            clock.spend(5)
            kept.put("first", FOUR)
        clock.spend(100)  # outside of any training
        with checkpoints.training(WHAT, tmp_path, clock.seconds) as kept:
            assert kept.get("first") is not None
            clock.spend(7)
            kept.put("second", FOUR)
        assert resumed.seconds == 0
        raise Interrupted
    assert spend(tmp_path, clock) == 12


def test_what_was_kept_before_the_disk_was_full_stays_and_the_training_goes_on(tmp_path, monkeypatch, caplog):
    def full_disk(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    home = interrupt(tmp_path, **{"module-0": module(0)})
    monkeypatch.setattr(checkpoints, "replace_bytes", full_disk)
    with suppress(Interrupted), checkpoints.training(WHAT, tmp_path) as kept:
        for number in range(3):
            kept.put(f"module-{number}", module(number + 1))
        raise Interrupted
    assert [path.name for path in home.iterdir()] == ["module-0.safetensors"]
    assert train(tmp_path) == ([1, 2, 3, 4], True)
    lines = said(caplog)
    assert len(lines) == 2
    assert all("No space left on device" in line for line in lines)
    assert list(tmp_path.iterdir()) == []


def test_a_place_that_cannot_be_written_costs_one_line(tmp_path, caplog):
    (tmp_path / "file").touch()
    for number, place in enumerate(("file", "file/deeper", "x" * 300)):
        assert train(tmp_path / place) == ([*range(MODULES)], True)
        assert len(said(caplog)) == number + 1


def test_a_training_that_was_killed_at_any_point_goes_on_with_what_it_had_kept(tmp_path):
    processes = multiprocessing.get_context("forkserver")  # one that has imported what they need makes them
    processes.set_forkserver_preload(["vprbench.api.checkpoints"])
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
        assert train(root) == ([number for number in range(MODULES) if f"module-{number}" not in parts], True)
        assert list(root.iterdir()) == []
    assert numbers_kept == {*range(MODULES + 1)}


def test_a_folder_that_another_process_removes_is_made_again_and_given_up_in_the_end(tmp_path, monkeypatch, caplog):
    write, removed = checkpoints.replace_bytes, []

    def remove_first(path, content):
        if len(removed) < times:
            removed.append(path.parent)
            shutil.rmtree(path.parent)
        write(path, content)

    monkeypatch.setattr(checkpoints, "replace_bytes", remove_first)
    times = 4
    interrupt(tmp_path, part=FOUR)
    assert len(removed) == 4
    with checkpoints.training(WHAT, tmp_path) as kept:
        assert kept.get("part") is not None
    times = 100
    assert train(tmp_path) == ([*range(MODULES)], True)
    assert len(said(caplog)) == 1


def test_threads_that_keep_parts_at_once_lose_none_and_their_time_is_that_on_the_wall(tmp_path):
    clock = Clock()
    together = threading.Barrier(8)

    def one(number):
        together.wait()
        kept.put(f"module-{number}", module(number))

    with suppress(Interrupted), checkpoints.training(WHAT, tmp_path, clock.seconds) as kept:
        clock.spend(8)
        with ThreadPoolExecutor(8) as pool:
            list(pool.map(one, range(8)))
        assert all(whole(number, kept.get(f"module-{number}")) for number in range(8))
        raise Interrupted
    assert spend(tmp_path, clock) == 8
