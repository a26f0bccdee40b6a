"""Query frames as a corruption leaves them: a pure function of the frame, its name and the seed."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np

from vprbench.api.arrays import Image
from vprbench.api.dataset import Dataset
from vprbench.runs.corruption import Corruption, parse_corruption

_GREY = 128  # level of the rectangle that hides a part of a frame


def corrupt_queries(dataset: Dataset, name: str | None) -> Dataset:
    """Return a dataset whose query frames are corrupted when they are read, and whose protocol says so.

    None leaves it as it is. References, and places that a method chooses its settings by, stay clean. Raises BadInput
    for a name that is unknown.
    """
    if name is None:
        return dataset
    wanted = parse_corruption(name)
    text = wanted.protocol()
    queries = dataset.queries.changed(lambda image, frame: corrupt_frame(image, wanted, frame), text)
    return replace(dataset, queries=queries, protocol={**dataset.protocol, "corruption": text})


def corrupt_frame(image: Image, wanted: Corruption, frame: str) -> Image:
    """Return an image, uint8 (height, width, 3), corrupted; random draws follow from seed, kind and the frame's name.

    So it is the same in any order, process and batch, and all strengths of a kind go one way.
    """
    drawn = hashlib.sha256(f"{wanted.seed} {wanted.kind} {frame}".encode(errors="surrogateescape")).digest()
    return _CHANGES[wanted.kind](image, wanted.amount, np.random.default_rng([*drawn]))


def _shifted(image: Image, pixels: float, random: np.random.Generator) -> Image:
    last = image.shape[1] - 1
    return np.ascontiguousarray(image[:, np.clip(np.arange(last + 1) + _either(random) * int(pixels), 0, last)])


def _turned(image: Image, degrees: float, random: np.random.Generator) -> Image:
    height, width = image.shape[:2]
    about = cv2.getRotationMatrix2D(((width - 1) / 2, (height - 1) / 2), _either(random) * degrees, 1.0)
    return _as_image(cv2.warpAffine(image, about, (width, height), borderMode=cv2.BORDER_REPLICATE))


def _exposed(image: Image, stops: float, random: np.random.Generator) -> Image:
    return _as_image(cv2.convertScaleAbs(image, alpha=2.0 ** (_either(random) * stops)))


def _blurred(image: Image, percent: float, random: np.random.Generator) -> Image:
    deviation = percent / 100 * image.shape[1]
    return _as_image(cv2.GaussianBlur(image, (0, 0), deviation, borderType=cv2.BORDER_REPLICATE))


def _noisy(image: Image, levels: float, random: np.random.Generator) -> Image:
    noise = np.float32(levels) * random.standard_normal(image.shape, np.float32)
    return np.clip(np.rint(image + noise), 0, 255).astype(np.uint8)


def _hidden(image: Image, percent: float, random: np.random.Generator) -> Image:
    corners = []
    for side, where in zip(image.shape[:2], random.random(2), strict=True):
        length = round(side * (percent / 100) ** 0.5)
        corners.append((int(where * (side - length + 1)), length))
    (top, height), (left, width) = corners
    hidden = image.copy()
    hidden[top : top + height, left : left + width] = _GREY
    return hidden


def _coarse(image: Image, factor: float, random: np.random.Generator) -> Image:
    height, width = image.shape[:2]
    small = max(1, round(width / factor)), max(1, round(height / factor))
    less = cv2.resize(image, small, interpolation=cv2.INTER_AREA)
    return _as_image(cv2.resize(less, (width, height), interpolation=cv2.INTER_LINEAR))


def _either(random: np.random.Generator) -> int:
    return 1 if random.random() < 0.5 else -1


def _as_image(array: cv2.typing.MatLike) -> Image:
    return np.asarray(array, np.uint8)


_CHANGES: dict[str, Callable[[Image, float, np.random.Generator], Image]] = {
    "shift": _shifted,
    "rotation": _turned,
    "brightness": _exposed,
    "blur": _blurred,
    "noise": _noisy,
    "occlusion": _hidden,
    "resolution": _coarse,
}
