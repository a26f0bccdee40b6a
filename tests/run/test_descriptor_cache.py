"""Descriptors come back from disk as they were written, and a disk that fails costs nothing but the disk."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from little import number_in, pictures

from vprbench.api.images import Images
from vprbench.errors import BadInput
from vprbench.run.descriptors import Described
from vprbench.storage import shards

Array = npt.NDArray[np.float32]
N = 10


def some(images: Images, n_dimensions: int = 4) -> Array:
    return np.arange(len(images) * n_dimensions, dtype=np.float32).reshape(len(images), n_dimensions)


def describe(
    folder: Path, encode: Callable[[Images], Array] = some, images: Images | None = None
) -> tuple[Array, int, list[int]]:
    """Return the descriptors of a traverse, how many were kept, and how many images were told to be done."""
    done: list[int] = []
    images = images or pictures(range(N))
    made, kept = Described(folder, {"method": "m"}).descriptors(images, encode, done.append)
    return made[:], kept, done


def test_what_was_kept_is_found_memory_mapped_and_read_only_beside_what_it_came_from(tmp_path: Path) -> None:
    made, kept, done = describe(tmp_path)
    assert (kept, done) == (0, [N])
    found, kept, done = describe(tmp_path)
    assert (kept, done) == (N, [])
    assert np.array_equal(made, some(pictures(range(N))))
    assert np.array_equal(found, made)
    assert isinstance(found, np.memmap)
    assert not found.flags.writeable
    about = json.loads(next(tmp_path.glob("*/about.json")).read_text())
    assert {name: about[name] for name in about if name != "images"} == {"method": "m", "shape": [N, 4], "bytes": 160}
    assert sorted(path.suffix for path in tmp_path.glob("*/*")) == [".json", ".npy"]


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
    (path,) = tmp_path.glob("*/*.npy")
    damage(path)
    again, kept, _ = describe(tmp_path)
    assert (kept, path.name in caplog.text) == (0, True)
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
    assert not list(tmp_path.glob("*/*"))


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
    assert (made.tolist(), kept) == (some(pictures(range(N))).tolist(), 0)
    assert "no descriptors are kept" in caplog.text
    assert not [path for path in tmp_path.rglob("*") if path.is_file() and path.name != "file"]


def test_descriptors_go_through_memory_block_by_block_into_room_that_was_taken_before(tmp_path: Path) -> None:
    taken: list[int] = []

    def wide(images: Images) -> Array:
        taken.append(sum(512 * path.stat().st_blocks for path in tmp_path.glob("*/*")))
        return np.ones((len(images), 10_000), np.float32)

    images = pictures([i % 100 for i in range(2000)])
    images.content_hash()
    tracemalloc.start()
    try:
        Described(tmp_path, {}).descriptors(images, wide, lambda done: None)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert len(taken) > 10
    assert taken[1] >= 1024 * 10_000 * 4  # of one shard
    assert peak < 2000 * 10_000 * 4 / 3


def test_what_nobody_touched_for_a_day_is_removed_and_what_another_writes_is_not(tmp_path: Path) -> None:
    describe(tmp_path)
    (path,) = tmp_path.glob("*/*.npy")
    path.unlink()
    old, new = (path.parent / f".partial-{name}.npy" for name in ("old", "new"))
    for partial in (old, new):
        partial.write_bytes(b"half")
    os.utime(old, (0, 0))
    describe(tmp_path)
    assert (old.exists(), new.exists()) == (False, True)


def test_more_than_fits_into_memory_is_refused_where_the_disk_is_full_and_what_is_done_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    images = pictures([i % 100 for i in range(2000)])
    monkeypatch.setattr(shards, "LARGE_BYTES", 1000)
    described: list[int] = []

    def until_it_is_full(images: Images) -> Array:
        described.append(len(images))
        if sum(described) > 1024:
            monkeypatch.setattr(os, "posix_fallocate", full)
        return some(images)

    with pytest.raises(BadInput, match=r"No space left"):
        describe(tmp_path, until_it_is_full, images)
    monkeypatch.undo()
    made, kept, done = describe(tmp_path, some, images)
    assert (len(made), kept, done[-1]) == (2000, 1024, 976)


def test_a_killed_encoding_goes_on_with_the_shard_that_it_had_not_finished(tmp_path: Path) -> None:
    killed = subprocess.Popen([sys.executable, "-c", KILLED, str(tmp_path)], stdout=subprocess.PIPE, text=True)
    assert killed.stdout is not None
    assert killed.stdout.readline() == "1088\n"  # one shard of 1024 images, and 64 of the next
    killed.kill()
    killed.wait()
    encoded: list[int] = []

    def counted(images: Images) -> Array:
        encoded.extend(number_in(image) for image in images)
        return some(images)

    images = pictures([i % 100 for i in range(2000)])
    made, kept, _ = describe(tmp_path, counted, images)
    assert (kept, len(encoded)) == (1024, 976)
    assert encoded == [i % 100 for i in range(1024, 2000)]
    assert np.array_equal(made, np.concatenate([some(images[first : first + 64]) for first in range(0, 2000, 64)]))
    assert describe(tmp_path, counted, images)[1] == 2000


#: Encodes 17 blocks of 64 images, says how many are done, and waits to be killed.
KILLED = f"""
import sys, time
from pathlib import Path
sys.path[:0] = {[str(Path(__file__).parent), *sys.path]}
from test_descriptor_cache import Described, pictures, some

done = 0
def encode(images):
    global done
    if done == 1088:
        print(done, flush=True)
        time.sleep(600)
    done += len(images)
    return some(images)

images = pictures([i % 100 for i in range(2000)])
Described(Path(sys.argv[1]), {{"method": "m"}}).descriptors(images, encode, lambda done: None)
"""
