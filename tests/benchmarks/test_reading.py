"""Reading files: frames in order, names and positions of a large dataset, an hour of an event camera."""

import os
from collections import deque
from pathlib import Path

import cv2
import h5py
import numpy as np
import pytest
from PIL import Image as PillowImage

import vprbench
from vprbench.api import Images, Paths
from vprbench.api.decoding import Decoding, read_image
from vprbench.datasets.readers.positions import Positions, match_positions
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


def test_tags(measure, size, tmp_path):
    exif = PillowImage.Exif()
    paths = {tag: [tmp_path / f"{tag}-{number}.jpg" for number in range(size(100, 3))] for tag in (1, 6)}
    for tag, files in paths.items():
        exif[0x0112] = tag
        for number, path in enumerate(files):
            PillowImage.fromarray(photograph(number, *size((360, 640), (24, 40)))).save(path, exif=exif)

    def by_pillow():
        for path in paths[1]:
            with PillowImage.open(path) as image:
                np.asarray(image)

    ignored = Decoding(exif="ignore")
    beside = {
        "on its side, tag ignored": lambda: deque((read_image(path, ignored) for path in paths[6]), maxlen=0),
        "upright": lambda: deque(map(read_image, paths[1]), maxlen=0),
        "upright, Pillow alone": by_pillow,
    }
    what = "JPEG files of 640x360 that a tag turns"
    measure(what, lambda: deque(map(read_image, paths[6]), maxlen=0), len(paths[6]), beside)


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


def test_positions(measure, size):
    n = size(100_000, 100)
    drives = np.random.default_rng(0).normal(0, 1, (2, n, 2)) + np.stack([543_000 + np.arange(n), np.full(n, 4.1e6)], 1)
    files = Paths.below(Path("drive"), [f"{number}.png" for number in range(n)])
    mapped, asked = (Positions(files, metres) for metres in drives)
    measure(f"{n:,} positions looked for among as many, within 25 m", lambda: match_positions([mapped], asked, 25.0), n)


def test_events(measure, size, tmp_path, monkeypatch):
    n, hour = size(20_000_000, 20_000), 3600 * 1_000_000
    drawn = np.random.default_rng(0)
    columns = {"t": np.sort(drawn.integers(hour, size=n)), "p": drawn.integers(2, size=n, dtype=np.uint8)}
    columns |= {name: drawn.integers(most, size=n, dtype=np.uint16) for name, most in (("x", 346), ("y", 260))}
    with h5py.File(tmp_path / "hour.h5", "w") as file:
        for name, values in columns.items():
            file[f"events/{name}"] = values
    tries = iter(range(1000))
    options = {
        "references": [str(tmp_path / "hour.h5")],
        "queries": str(tmp_path / "hour.h5"),
        "height": 260,
        "width": 346,
    }

    def counted():  # each time anew: frames are kept
        monkeypatch.setenv("VPRBENCH_EVENTS", str(tmp_path / str(next(tries))))
        vprbench.dataset("event_folders", **options).build()

    measure("an hour of a DAVIS346 in HDF5, counted into frames of a second", counted, n)
