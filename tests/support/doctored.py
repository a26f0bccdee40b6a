"""Little traverses on disk for the doctor: healthy ones, to be damaged by a test."""

import re

import cv2
import numpy as np
from PIL import Image as PillowImage

from vprbench.api.dataset import Dataset, FrameFolder
from vprbench.api.images import Images

PLACES = 60
NAMES = [f"{place:03d}.png" for place in range(PLACES)]

_STEP = 24  # pixels from place to place; a frame is 64 wide
_NUMBER = re.compile(r"\d+x\d+|\d[\d,.]*(?<![,.])")


def season(number, places=PLACES):
    """Return frames of a ride past a made-up landscape; each season has its own light and noise, all are aligned."""
    width = _STEP * places + 64
    rough = np.random.default_rng(0).random((6, width // 10), np.float32)
    land = cv2.resize(rough, (width, 32), interpolation=cv2.INTER_CUBIC)
    weather = np.random.default_rng(1 + number)
    light = land * (150 - 20 * number) + 40 + 10 * number
    seen = np.clip(light + weather.normal(0, 15, light.shape), 30, 255).astype(np.uint8)
    frames = [seen[:, _STEP * place : _STEP * place + 64] for place in range(places)]
    return [np.repeat(frame[:, :, None], 3, axis=2) for frame in frames]


def save(folder, frames, names=None):
    """Write frames as PNG files; they are named by their number where no names come."""
    folder.mkdir(parents=True)
    for number, frame in enumerate(frames):
        PillowImage.fromarray(frame).save(folder / (names[number] if names else f"{number:03d}.png"))
    return folder


def healthy(tmp_path):
    """Write a winter and a summer of the same places; returns both folders."""
    return save(tmp_path / "winter", season(0)), save(tmp_path / "summer", season(1))


def dataset_of(references, queries, names=NAMES, query_names=None, right=None, protocol=None, **counts):
    """Return the dataset of two folders; the i-th query shows the i-th place unless `right` says otherwise."""
    asked = names if query_names is None else query_names
    known = {"references": [references.name], "query": queries.name, "tolerance_places": 0}
    return Dataset(
        name="little",
        references=Images.from_files([references / name for name in names]),
        places=np.arange(len(names)),
        queries=Images.from_files([queries / name for name in asked]),
        positives=tuple(np.array(places, np.int64) for places in right or [[i] for i in range(len(asked))]),
        protocol={**known, **(protocol or {})},
        folders=tuple(FrameFolder(at, tuple(used), **counts) for at, used in ((references, names), (queries, asked))),
    )


def coded(found, folder):
    """Return level, check, numbers and numbered names of every finding, without the path of the tests' `folder`."""
    return [
        f"{one.level} {one.check}: {' '.join(re.findall(_NUMBER, one.text.replace(str(folder), '')))}".rstrip()
        for one in found
    ]
