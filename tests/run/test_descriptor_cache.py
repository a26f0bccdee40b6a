"""Descriptors come back from disk as they were written, and a disk that fails costs nothing but the disk."""

from __future__ import annotations

import json
import os
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from little import pictures

from vprbench.api.images import Images
from vprbench.run.descriptors import Described

Array = npt.NDArray[np.float32]
N = 10


def some(images: Images, n_dimensions: int = 4) -> Array:
    return np.arange(len(images) * n_dimensions, dtype=np.float32).reshape(len(images), n_dimensions)


def describe(
    folder: Path, encode: Callable[[Images], Array] = some, images: Images | None = None
) -> tuple[Array, bool, list[int]]:
    """Return the descriptors of a traverse, whether they were kept, and how many images were told to be done."""
    done: list[int] = []
    images = images or pictures(range(N))
    return *Described(folder, {"method": "m"}).descriptors(images, encode, done.append), done


def test_what_was_kept_is_found_memory_mapped_and_read_only_beside_what_it_came_from(tmp_path: Path) -> None:
    made, kept, done = describe(tmp_path)
    assert (kept, done) == (False, [N])
    found, kept, done = describe(tmp_path)
    assert (kept, done) == (True, [])
    assert np.array_equal(made, some(pictures(range(N))))
    assert np.array_equal(found, made)
    assert isinstance(found, np.memmap)
    assert not found.flags.writeable
    about = json.loads(next(tmp_path.glob("*.json")).read_text())
    assert {name: about[name] for name in about if name != "images"} == {
        **{"method": "m", "n_images": N, "n_dimensions": 4},
        "bytes": 160,
    }
    assert sorted(path.suffix for path in tmp_path.iterdir()) == [".json", ".npy"]


@pytest.mark.parametrize(
    "damage",
    [
        lambda path: path.write_bytes(path.read_bytes()[:-20]),
        lambda path: path.write_bytes(b""),
        lambda path: path.write_bytes(b"<html>"),
        lambda path: np.save(path, np.zeros((9, 4), np.float32)),
        lambda path: np.save(path, np.zeros((N, 4))),
        lambda path: np.save(path, np.array([{}] * N), allow_pickle=True),
    ],
    ids=["cut", "empty", "page", "other number", "other type", "pickle"],
)
def test_a_damaged_file_is_named_and_made_anew(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, damage: Callable[[Path], object]
) -> None:
    describe(tmp_path)
    (path,) = tmp_path.glob("*.npy")
    damage(path)
    again, kept, _ = describe(tmp_path)
    assert (kept, path.name in caplog.text) == (False, True)
    assert np.array_equal(again, some(pictures(range(N))))


def test_an_error_while_encoding_reaches_the_caller_and_leaves_nothing(tmp_path: Path) -> None:
    calls: list[int] = []

    def broken(images: Images) -> Array:
        calls.append(len(images))
        if len(calls) == 2:
            raise ZeroDivisionError
        return some(images)

    with pytest.raises(ZeroDivisionError):
        describe(tmp_path, broken, pictures(range(1000)))
    assert not list(tmp_path.iterdir())


def full(*_: object) -> None:
    raise OSError(28, "No space left on device")


@pytest.mark.parametrize("folder", ["file", "full"])
def test_a_folder_that_takes_nothing_leaves_the_descriptors_in_memory(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch, folder: str
) -> None:
    if folder == "file":
        (tmp_path / folder).write_text("")
    else:
        monkeypatch.setattr(os, "posix_fallocate", full)  # before the first descriptor is written
    made, kept, _ = describe(tmp_path / folder)
    assert (made.tolist(), kept) == (some(pictures(range(N))).tolist(), False)
    assert "no descriptors are kept" in caplog.text
    assert not [path for path in tmp_path.rglob("*") if path.is_file() and path.name != "file"]


def test_descriptors_go_through_memory_block_by_block_into_room_that_was_taken_before(tmp_path: Path) -> None:
    taken: list[int] = []

    def wide(images: Images) -> Array:
        taken.append(sum(512 * path.stat().st_blocks for path in tmp_path.iterdir()))
        return np.ones((len(images), 10_000), np.float32)

    images = pictures([i % 100 for i in range(2000)])
    images.content_hash()
    tracemalloc.start()
    try:
        describe(tmp_path, wide, images)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert len(taken) > 10
    assert taken[1] >= 2000 * 10_000 * 4
    assert peak < 2000 * 10_000 * 4 / 3


def test_what_nobody_touched_for_a_day_is_removed_and_what_another_writes_is_not(tmp_path: Path) -> None:
    old, new = (tmp_path / f".partial-{name}.npy" for name in ("old", "new"))
    for path in (old, new):
        path.write_bytes(b"half")
    os.utime(old, (0, 0))
    describe(tmp_path)
    assert (old.exists(), new.exists()) == (False, True)
