"""Partial trainings: what an interrupted one had done is there again, whole and for the same training alone."""

from __future__ import annotations

import errno
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import platformdirs
import pytest
from partial_worker import FOUR, WHAT, Interrupted, interrupt, interrupted, said
from safetensors.numpy import save_file

from vprbench.api import checkpoints
from vprbench.storage import tensors

DAY = 86400.0


# What is kept


ARRAYS = {
    "float32": np.arange(6, dtype=np.float32).reshape(2, 3),
    "a view": np.arange(24.0).reshape(2, 3, 4).transpose(2, 0, 1)[::2],
    "no axis": np.array(7, np.int64),
    "empty": np.zeros((0, 5), np.int16),
    "bool": np.array([True, False]),
    "big endian": np.arange(3, dtype=">i4"),
    "odd values": np.array([np.nan, -np.inf, -0.0, 5e-324]),
}


def test_an_interrupted_training_finds_its_arrays_as_they_were(tmp_path: Path) -> None:
    interrupt(tmp_path, part=ARRAYS)
    with checkpoints.training(WHAT, tmp_path) as kept:
        found = kept.get("part")
    assert found is not None
    assert found.keys() == ARRAYS.keys()
    for name, array in ARRAYS.items():
        wanted = array.astype(array.dtype.newbyteorder("="))
        assert (found[name].dtype, found[name].shape) == (wanted.dtype, wanted.shape)
        assert found[name].tobytes() == wanted.tobytes()


def test_a_part_is_the_last_that_was_put_each_time_a_copy_and_none_where_none_was_put(tmp_path: Path) -> None:
    with checkpoints.training(WHAT, tmp_path) as kept:
        kept.put("part", {"w": np.ones(2)})
        kept.put("part", FOUR)
        first = kept.get("part")
        assert first is not None
        first["w"] += 1
        again = kept.get("part")
        assert kept.get("second") is None
    assert again is not None
    assert again["w"].tolist() == [0.0, 1.0, 2.0, 3.0]


def test_a_training_that_ends_leaves_nothing(tmp_path: Path) -> None:
    with checkpoints.training(WHAT, tmp_path) as kept:
        kept.put("part", FOUR)
        assert list(tmp_path.rglob("*.safetensors"))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("end", [ValueError, KeyboardInterrupt, SystemExit])
def test_whatever_ends_a_training_early_leaves_its_parts(tmp_path: Path, end: type[BaseException]) -> None:
    with interrupted(end), checkpoints.training(WHAT, tmp_path) as kept:
        kept.put("part", FOUR)
        raise end
    with checkpoints.training(WHAT, tmp_path) as kept:
        assert kept.get("part") is not None


def test_the_order_of_what_is_trained_says_nothing(tmp_path: Path) -> None:
    interrupt(tmp_path, {"seed": 1, "rates": (0.1, 0.2)}, part=FOUR)
    with checkpoints.training({"rates": [0.1, 0.2], "seed": 1}, tmp_path) as kept:
        assert kept.get("part") is not None


@pytest.mark.parametrize("other", [{"seed": 2, "rates": [0.1]}, {"seed": 1, "rates": [0.2]}, {"seed": 1}])
def test_another_training_finds_nothing_and_leaves_what_is_there(tmp_path: Path, other: dict[str, Any]) -> None:
    home = interrupt(tmp_path, {"seed": 1, "rates": [0.1]}, part=FOUR)
    with checkpoints.training(other, tmp_path) as kept:
        assert kept.get("part") is None
        kept.put("part", FOUR)
    assert list(tmp_path.iterdir()) == [home]


@pytest.mark.parametrize("name", ["", "../part", "a/b", ".part", "a b", "part\n"])
def test_a_name_that_is_no_files_is_refused(tmp_path: Path, name: str) -> None:
    with checkpoints.training(WHAT, tmp_path) as kept:
        with pytest.raises(ValueError, match="names no part"):
            kept.put(name, FOUR)
        with pytest.raises(ValueError, match="names no part"):
            kept.get(name)


@pytest.mark.parametrize("thing", [np.array([None]), np.array(["a"]), np.array([1j]), [1.0]])
def test_anything_but_an_array_of_numbers_is_refused(tmp_path: Path, thing: Any) -> None:
    with (
        checkpoints.training(WHAT, tmp_path) as kept,
        pytest.raises(TypeError, match=r"weights is .*; wanted"),
    ):
        kept.put("part", {"weights": thing})


# Damaged files


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
def test_a_damaged_part_is_trained_anew_and_the_others_are_not(
    tmp_path: Path, damage: Callable[[Path], Any], caplog: pytest.LogCaptureFixture
) -> None:
    home = interrupt(tmp_path, first=FOUR, second=FOUR)
    damage(home / "first.safetensors")
    with checkpoints.training(WHAT, tmp_path) as kept:
        assert kept.get("first") is None
        assert kept.get("second") is not None
        assert not (home / "first.safetensors").exists()
        kept.put("first", FOUR)
        assert kept.get("first") is not None
    (line,) = said(caplog)
    assert "first.safetensors cannot be used" in line


def test_a_part_that_cannot_be_read_now_is_not_removed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any, **__: Any) -> NoReturn:
        raise OSError(errno.EMFILE, "Too many open files")

    interrupt(tmp_path, part=FOUR)
    with monkeypatch.context() as patch, interrupted(), checkpoints.training(WHAT, tmp_path) as kept:
        patch.setattr(tensors, "safe_open", refuse)
        assert kept.get("part") is None
        raise Interrupted
    with checkpoints.training(WHAT, tmp_path) as kept:
        assert kept.get("part") is not None


def test_what_a_killed_process_left_unfinished_is_removed_after_a_day(tmp_path: Path) -> None:
    home = interrupt(tmp_path, part=FOUR)
    for name in (".partial-old", ".partial-new"):
        (home / name).touch()
    aged(home / ".partial-old", 1.1)
    with checkpoints.training(WHAT, tmp_path):
        assert sorted(path.name for path in home.iterdir()) == [".partial-new", "part.safetensors"]


# Where they are, and how long


def aged(folder: Path, days: float) -> Path:
    moment = time.time() - days * DAY
    os.utime(folder, (moment, moment))
    return folder


@pytest.mark.parametrize(("days", "there"), [(29, True), (31, False)])
def test_trainings_are_kept_for_thirty_days(tmp_path: Path, days: int, there: bool) -> None:
    home = aged(interrupt(tmp_path, part=FOUR), days)
    with checkpoints.training({"another": 1}, tmp_path):
        assert home.exists() is there


def test_an_old_training_is_still_resumed_and_one_that_goes_on_is_not_old(tmp_path: Path) -> None:
    home = aged(interrupt(tmp_path, part=FOUR), 365)
    with checkpoints.training(WHAT, tmp_path) as kept:
        assert kept.get("part") is not None
        aged(home, 365)
        kept.put("second", FOUR)
        with checkpoints.training({"another": 1}, tmp_path):
            pass
        assert kept.get("part") is not None


def test_files_of_others_are_never_removed(tmp_path: Path) -> None:
    home = interrupt(tmp_path, part=FOUR)
    (home / "thesis.txt").touch()
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "net.safetensors").touch()
    aged(home, 365)
    aged(tmp_path / "photos", 365)
    with checkpoints.training({"another": 1}, tmp_path):
        pass
    left = [path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*") if path.is_file()]
    assert sorted(left) == sorted([f"{home.name}/thesis.txt", "photos/net.safetensors"])


@pytest.mark.parametrize(
    ("chosen", "folder"), [("~/trainings", "trainings"), ("", "vprbench/partial"), (None, "vprbench/partial")]
)
def test_the_folder_is_the_one_that_was_chosen_or_in_the_users_cache(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, chosen: str | None, folder: str
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.delenv("VPRBENCH_PARTIAL", raising=False)
    if chosen is not None:
        monkeypatch.setenv("VPRBENCH_PARTIAL", chosen)
    monkeypatch.setattr(platformdirs, "user_cache_path", lambda *names, **_: tmp_path.joinpath(*names))
    with checkpoints.training(WHAT) as kept:
        kept.put("part", FOUR)
        assert [path.name for path in tmp_path.joinpath(folder).glob("*/*")] == ["part.safetensors"]
