"""Partial trainings: what an interrupted one had done is there again, whole and for the same training alone."""

import errno
import logging
import os
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress

import numpy as np
import platformdirs
import pytest
from safetensors.numpy import save_file
from stopped_clock import Clock

from vprbench.api import checkpoints
from vprbench.storage import tensors

WHAT = {"method": "walks", "seed": 3}
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
    "a view": np.arange(24.0, dtype=np.float32).reshape(2, 3, 4).transpose(2, 0, 1)[::2],
    "no axis": np.array(7, np.int64),
    "empty": np.zeros((0, 5), np.int16),
    "big endian": np.arange(3, dtype=">i4"),
    "odd values": np.array([np.nan, -np.inf, -0.0, 5e-324]),
}


@pytest.mark.parametrize("end", [ValueError, KeyboardInterrupt, SystemExit])
def test_whatever_ends_a_training_early_leaves_its_arrays_for_the_same_training_alone(tmp_path, end):
    with suppress(end), checkpoints.training({"seed": 1, "rates": (0.1, 0.2)}, tmp_path) as kept:
        kept.put("part", ARRAYS)
        raise end
    with checkpoints.training({"seed": 1}, tmp_path) as kept:
        assert kept.get("part") is None
    with checkpoints.training({"rates": [0.1, 0.2], "seed": 1}, tmp_path) as kept:
        found = kept.get("part")
    assert found.keys() == ARRAYS.keys()
    for name, array in ARRAYS.items():
        wanted = array.astype(array.dtype.newbyteorder("="))
        assert (found[name].dtype, found[name].shape) == (wanted.dtype, wanted.shape)
        assert found[name].tobytes() == wanted.tobytes()


def test_a_part_is_a_copy_of_the_last_that_was_put_under_its_name_and_nothing_is_left_in_the_end(tmp_path):
    with checkpoints.training(WHAT, tmp_path) as kept:
        kept.put("part", {"w": np.ones(2)})
        kept.put("part", FOUR)
        kept.get("part")["w"] += 1
        assert kept.get("part")["w"].tolist() == [0.0, 1.0, 2.0, 3.0]
        assert kept.get("second") is None
        assert list(tmp_path.rglob("*.safetensors"))
    assert list(tmp_path.iterdir()) == []
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


def test_trainings_are_kept_for_thirty_days_unfinished_parts_for_one_and_files_of_others_for_ever(tmp_path):
    old, young = (interrupt(tmp_path, {"seed": seed}, part=FOUR) for seed in (1, 2))
    photo = tmp_path / "photos" / "net.safetensors"
    photo.parent.mkdir()
    for path in (old / "thesis.txt", photo, young / ".partial-old", young / ".partial-new"):
        path.touch()
    for path, days in ((young / ".partial-old", 1.1), (old, 31), (young, 29), (photo.parent, 365)):
        aged(path, days)
    with checkpoints.training({"another": 1}, tmp_path):
        assert [path.name for path in old.iterdir()] == ["thesis.txt"]
        assert (young / "part.safetensors").is_file()
        assert photo.is_file()
    aged(young, 365)
    with checkpoints.training({"seed": 2}, tmp_path) as kept:
        assert sorted(path.name for path in young.iterdir()) == [".partial-new", "part.safetensors"]
        aged(young, 365)
        kept.put("second", FOUR)
        with checkpoints.training({"another": 1}, tmp_path):
            pass
        assert kept.get("part") is not None  # the one that is wanted is resumed however old


def test_the_folder_is_in_the_users_cache(tmp_path, monkeypatch):
    monkeypatch.delenv("VPRBENCH_PARTIAL")
    monkeypatch.setattr(platformdirs, "user_cache_path", lambda *names, **_: tmp_path.joinpath(*names))
    with checkpoints.training(WHAT) as kept:
        kept.put("part", FOUR)
        assert [path.name for path in tmp_path.joinpath("vprbench/partial").glob("*/*")] == ["part.safetensors"]


def test_the_time_of_interrupted_runs_counts_once_until_the_last_part_of_each(tmp_path):
    clock = Clock()
    assert spend(tmp_path, clock, ("first", 5), ("second", 7), then=3) == 0
    assert spend(tmp_path, clock, ("third", 4), then=100) == 12
    assert spend(tmp_path, clock, ("third", 3), ("third", 2)) == 16  # put again, it keeps what it replaces
    assert spend(tmp_path, clock) == 21


def test_a_ledger_inside_another_is_the_same_and_a_training_opened_twice_in_it_goes_on_with_its_own(tmp_path):
    clock = Clock()
    with suppress(Interrupted), checkpoints.ledger() as outer:
        for name, seconds in (("first", 5), ("second", 7)):
            with checkpoints.ledger() as inner, checkpoints.training(WHAT, tmp_path, clock.seconds) as kept:
                clock.spend(seconds)
                kept.put(name, FOUR)
                assert kept.get("first") is not None
                assert kept.seconds == 0
            assert inner is outer
            clock.spend(100)  # outside of any training
        assert outer.seconds == 0
        assert len([*tmp_path.glob("*/*.safetensors")]) == 2
        raise Interrupted
    assert spend(tmp_path, clock) == 12


def test_a_run_that_is_interrupted_in_its_second_training_keeps_the_first_and_tells_what_it_took_over(tmp_path):
    clock = Clock()
    with suppress(Interrupted), checkpoints.ledger():
        with checkpoints.training(WHAT, tmp_path, clock.seconds) as kept:
            clock.spend(5)
            kept.put("part", FOUR)
        with checkpoints.training({"another": 1}, tmp_path):
            raise Interrupted
    with checkpoints.ledger() as resumed:
        with checkpoints.training(WHAT, tmp_path) as kept:
            assert resumed.seconds == 0  # nothing was asked for yet
            assert kept.get("part") is not None
        with checkpoints.training({"another": 1}, tmp_path) as kept:
            assert kept.get("part") is None
    assert resumed.seconds == 5
    assert list(tmp_path.iterdir()) == []
    with checkpoints.ledger():
        home = interrupt(tmp_path, part=FOUR)
    assert list(tmp_path.iterdir()) == [home]  # whose error was caught


def test_a_full_disk_or_no_place_to_write_costs_one_line_and_nothing_that_was_kept(tmp_path, monkeypatch, caplog):
    def full_disk(*_, **__):
        raise OSError(errno.ENOSPC, "No space left on device")

    home = interrupt(tmp_path, first=FOUR)
    with monkeypatch.context() as patch, suppress(Interrupted), checkpoints.training(WHAT, tmp_path) as kept:
        patch.setattr(checkpoints, "replace_bytes", full_disk)
        kept.put("second", FOUR)
        kept.put("third", FOUR)
        assert "No space left on device" in said(caplog)[0]
        patch.setattr(tensors, "safe_open", full_disk)
        assert kept.get("first") is None
        raise Interrupted
    assert [path.name for path in home.iterdir()] == ["first.safetensors"]
    (tmp_path / "file").touch()
    for number, place in enumerate(("file/deeper", "x" * 300)):
        with checkpoints.training(WHAT, tmp_path / place) as kept:
            kept.put("second", FOUR)
            kept.put("third", FOUR)
            assert kept.get("second") is None
        assert len(said(caplog)) == 3 + number


def test_threads_that_keep_parts_at_once_lose_none_and_their_time_is_that_on_the_wall(tmp_path):
    clock = Clock()
    together = threading.Barrier(8)

    def one(number):
        together.wait()
        kept.put(f"module-{number}", {"w": np.full(3, number)})

    with suppress(Interrupted), checkpoints.training(WHAT, tmp_path, clock.seconds) as kept:
        clock.spend(8)
        with ThreadPoolExecutor(8) as pool:
            list(pool.map(one, range(8)))
        assert all((kept.get(f"module-{number}")["w"] == number).all() for number in range(8))
        raise Interrupted
    assert spend(tmp_path, clock) == 8
