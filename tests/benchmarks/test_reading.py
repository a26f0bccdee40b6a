"""Reading files: frames in order, names and positions of a large dataset, an hour of an event camera."""

import os
from collections import deque

import cv2
import numpy as np
import pytest

import vprbench
from vprbench.api import Images
from vprbench.api.decoding import read_image
from vprbench.runs.identity import compute_fingerprint


def photograph(number, height, width):
    """Return a frame that costs a decoder what a photograph does: large and small shapes, and a camera's noise."""
    drawn = np.random.default_rng(number)
    frame = 128 + drawn.normal(0, 3, (height, width, 1))
    for cell, levels in ((64, 90), (16, 40), (4, 15)):
        coarse = drawn.uniform(-levels, levels, (height // cell + 2, width // cell + 2, 3))
        frame = frame + cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    return np.clip(frame, 0, 255).astype(np.uint8)


def test_frames(measure, size, tmp_path):
    paths = [tmp_path / f"{number:04}.png" for number in range(size(300, 3))]
    for number, path in enumerate(paths):
        cv2.imwrite(str(path), photograph(number, *size((360, 640), (24, 40))))
    beside = {"a bare loop": lambda: deque(map(read_image, paths), maxlen=0)}
    measure(
        "PNG files of 640x360, ahead and in order",
        lambda: deque(Images.from_files(paths), maxlen=0),
        len(paths),
        beside,
    )


@pytest.mark.parametrize("full", [10_000, 100_000])
def test_names_positions_and_hashes(full, measure, size, tmp_path, monkeypatch):
    n = size(full, full // 1000)
    shots = [tmp_path / f"{number}.png" for number in range(4)]  # a file may have 65,000 names
    for number, shot in enumerate(shots):
        cv2.imwrite(str(shot), photograph(number, 16, 16))
    east, north = np.random.default_rng(0).uniform(0, 12_000, (2, n))
    for part, count in (("database", n), ("queries", min(n, 1000))):
        for number in range(count):
            folder = tmp_path / part / f"{number // 1000:05}"
            folder.mkdir(parents=True, exist_ok=True)
            place = f"@{543_000 + east[number]:010.2f}@{4_173_000 + north[number]:010.2f}@10@S"
            os.link(shots[number % len(shots)], folder / f"{place}@@@{number:08}@@0@@@@@@.png")
    monkeypatch.setenv("VPRBENCH_HASHES", str(tmp_path / "hashes"))
    dataset = vprbench.dataset("utm_folders", root=str(tmp_path))
    measure(f"{n:,} files with positions in their names, hashes known", lambda: compute_fingerprint(dataset.build()), n)
