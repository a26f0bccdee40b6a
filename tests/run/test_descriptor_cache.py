"""Descriptors come back from disk as they were written, and a disk that fails costs nothing but the disk."""

from __future__ import annotations

import json
import logging
import os
import socket
import subprocess
import tracemalloc

import numpy as np
import pytest

from vprbench.run.descriptors import DescriptorCache


def some(n_images=10, n_dimensions=4, seed=0):
    return np.random.default_rng(seed).normal(size=(n_images, n_dimensions)).astype(np.float32)


def in_blocks(descriptors, size=3):
    return iter([descriptors[start : start + size] for start in range(0, len(descriptors), size)])


def test_what_was_kept_is_found_under_its_key_memory_mapped_and_read_only_beside_what_it_came_from(tmp_path):
    cache = DescriptorCache(tmp_path)
    assert np.array_equal(cache.keep("key", 10, in_blocks(some()), {"method": "m"}), some())
    found = cache.find("key", 10)
    assert np.array_equal(found, some())
    assert isinstance(found, np.memmap)
    assert not found.flags.writeable
    assert cache.find("other", 10) is None
    about = json.loads((tmp_path / "key.json").read_text())
    assert about == {"method": "m", "n_images": 10, "n_dimensions": 4, "bytes": 160}
    assert sorted(path.name for path in tmp_path.iterdir()) == ["key.json", "key.npy"]


@pytest.mark.parametrize(
    "damage",
    [
        lambda path: path.write_bytes(path.read_bytes()[:-20]),
        lambda path: path.write_bytes(b""),
        lambda path: path.write_bytes(b"<html>"),
        lambda path: np.save(path, some(9)),
        lambda path: np.save(path, some().astype(np.float64)),
        lambda path: np.save(path, np.array([{}] * 10), allow_pickle=True),
    ],
    ids=["cut", "empty", "page", "other number", "other type", "pickle"],
)
def test_a_damaged_file_is_named_and_counts_as_absent(tmp_path, caplog, damage):
    cache = DescriptorCache(tmp_path)
    cache.keep("key", 10, in_blocks(some()), {})
    damage(tmp_path / "key.npy")
    with caplog.at_level(logging.WARNING):
        assert cache.find("key", 10) is None
    assert "key.npy" in caplog.text


def test_an_error_while_encoding_reaches_the_caller_and_leaves_nothing(tmp_path):
    def broken():
        yield some(3)
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        DescriptorCache(tmp_path).keep("key", 10, broken(), {})
    assert not list(tmp_path.iterdir())


def test_a_folder_that_cannot_be_made_leaves_the_descriptors_in_memory(tmp_path, caplog):
    (tmp_path / "file").write_text("")
    kept = DescriptorCache(tmp_path / "file").keep("key", 10, in_blocks(some()), {})
    assert np.array_equal(kept, some())
    assert "no descriptors are kept" in caplog.text


def test_a_full_disk_is_seen_before_the_first_descriptor_is_written(tmp_path, caplog, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "posix_fallocate", full)
    kept = DescriptorCache(tmp_path).keep("key", 10, in_blocks(some()), {})
    assert np.array_equal(kept, some())
    assert "No space left on device" in caplog.text
    assert not list(tmp_path.iterdir())


def test_room_on_the_disk_is_taken_before_it_is_filled(tmp_path):
    n_bytes = []

    def blocks():
        yield some(1, 100_000)
        n_bytes.append(sum(512 * path.stat().st_blocks for path in tmp_path.iterdir()))
        yield some(9, 100_000)

    DescriptorCache(tmp_path).keep("key", 10, blocks(), {})
    assert n_bytes[0] >= 10 * 100_000 * 4


def test_descriptors_go_through_memory_block_by_block(tmp_path):
    tracemalloc.start()
    try:
        blocks = (np.ones((100, 1000), np.float32) for _ in range(100))
        DescriptorCache(tmp_path).keep("key", 10_000, blocks, {})
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 10 * 100 * 1000 * 4


def test_what_nobody_touched_for_a_day_is_removed_and_what_another_writes_is_not(tmp_path):
    gone = subprocess.Popen(["true"])
    gone.wait()
    old, new = (tmp_path / f".partial-{socket.gethostname()}-{gone.pid}-{name}.npy" for name in ("old", "new"))
    for path in (old, new):
        path.write_bytes(b"half")
    os.utime(old, (0, 0))
    DescriptorCache(tmp_path).keep("key", 10, in_blocks(some()), {})
    assert not old.exists()
    assert new.exists()
