"""Corruptions of query frames by their names, kind and strength, as in `shift-1`: pure functions of frame and seed."""

from __future__ import annotations

import hashlib
import itertools
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from vprbench.api.arrays import Image
from vprbench.api.dataset import Dataset
from vprbench.errors import BadInput
from vprbench.text import suggest_names

STRENGTHS = (1, 2, 3)  # weak, medium, strong
_GREY = 128  # level of the rectangle that hides a part of a frame


def _shift(image: Image, pixels: float, random: np.random.Generator) -> Image:
    last = image.shape[1] - 1
    return np.ascontiguousarray(image[:, np.clip(np.arange(last + 1) + _draw_sign(random) * int(pixels), 0, last)])


def _rotate(image: Image, degrees: float, random: np.random.Generator) -> Image:
    height, width = image.shape[:2]
    about = cv2.getRotationMatrix2D(((width - 1) / 2, (height - 1) / 2), _draw_sign(random) * degrees, 1.0)
    return np.asarray(cv2.warpAffine(image, about, (width, height), borderMode=cv2.BORDER_REPLICATE), np.uint8)


def _expose(image: Image, stops: float, random: np.random.Generator) -> Image:
    return np.asarray(cv2.convertScaleAbs(image, alpha=2.0 ** (_draw_sign(random) * stops)), np.uint8)


def _blur(image: Image, percent: float, random: np.random.Generator) -> Image:
    deviation = percent / 100 * image.shape[1]
    return np.asarray(cv2.GaussianBlur(image, (0, 0), deviation, borderType=cv2.BORDER_REPLICATE), np.uint8)


def _add_noise(image: Image, levels: float, random: np.random.Generator) -> Image:
    noise = np.float32(levels) * random.standard_normal(image.shape, np.float32)
    return np.clip(np.rint(image + noise), 0, 255).astype(np.uint8)


def _occlude(image: Image, percent: float, random: np.random.Generator) -> Image:
    corners = []
    for side, where in zip(image.shape[:2], random.random(2), strict=True):
        length = round(side * (percent / 100) ** 0.5)
        corners.append((int(where * (side - length + 1)), length))
    (top, height), (left, width) = corners
    occluded = image.copy()
    occluded[top : top + height, left : left + width] = _GREY
    return occluded


def _coarsen(image: Image, factor: float, random: np.random.Generator) -> Image:
    height, width = image.shape[:2]
    small = max(1, round(width / factor)), max(1, round(height / factor))
    less = cv2.resize(image, small, interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.resize(less, (width, height), interpolation=cv2.INTER_LINEAR), np.uint8)


def _draw_sign(random: np.random.Generator) -> int:
    return 1 if random.random() < 0.5 else -1


@dataclass(frozen=True)
class Kind:
    """One way to spoil a frame, in three strengths."""

    change: Callable[[Image, float, np.random.Generator], Image]  # of an image, by an amount
    amounts: tuple[float, float, float]
    unit: str  # around an amount
    words: str  # the change of query frames, around amounts with their unit

    def short(self, strengths: Sequence[int]) -> str:
        """Return the amounts of these strengths with their unit."""
        return self.unit.format("/".join(f"{self.amounts[each - 1]:g}" for each in strengths))

    def describe(self, strengths: Sequence[int]) -> str:
        """Return the change of query frames in words."""
        return self.words.format(self.short(strengths).replace("/", ", "))


KINDS = {
    "shift": Kind(_shift, (1, 4, 8), "{} px", "moved left or right by {}, borders repeated"),
    "rotation": Kind(_rotate, (2, 5, 10), "{}°", "turned left or right by {}, borders repeated"),
    "brightness": Kind(_expose, (0.5, 1, 2), "{} EV", "brighter or darker by {}: levels times 2 to that power"),
    "blur": Kind(_blur, (1, 2, 4), "{} %", "blurred by a Gaussian whose deviation is {} of their width"),
    "noise": Kind(_add_noise, (5, 10, 20), "±{}", "with Gaussian noise of {} levels in each pixel and channel"),
    "occlusion": Kind(_occlude, (10, 25, 50), "{} %", "with {} of their area hidden by a grey rectangle anywhere"),
    "resolution": Kind(_coarsen, (2, 4, 8), "1:{}", "reduced {} and enlarged again"),
}


@dataclass(frozen=True)
class Corruption:
    """A change of the query frames of a run."""

    kind: str
    strength: int  # 1 to 3
    seed: int = 0  # of the direction, place or noise of each frame

    @property
    def name(self) -> str:
        """Its name in the option `corruption`."""
        return f"{self.kind}-{self.strength}" + (f"-{self.seed}" if self.seed else "")


def parse_corruption(name: str) -> Corruption:
    """Return the corruption of a name; raises BadInput for an unknown name."""
    parts = re.fullmatch(r"([a-z_]+)-([1-3])(?:-(\d{1,9}))?", name)
    if parts is None or parts[1] not in KINDS:
        kind = name.partition("-")[0]
        remedy = "give a strength from 1 to 3" if kind in KINDS else suggest_names(kind, KINDS)
        raise BadInput(f"corruption={name} is unknown: {remedy}, as in corruption=shift-1")
    return Corruption(parts[1], int(parts[2]), int(parts[3] or 0))


def parse_corruptions(names: Sequence[str]) -> tuple[Corruption, ...]:
    """Return the corruptions that are named, a kind for all its strengths, `all` for every kind, in the kinds' order.

    Raises BadInput for a name that is unknown, and for one corruption with two seeds.
    """
    found: dict[tuple[str, int], Corruption] = {}
    for name in KINDS if [*names] == ["all"] else names:
        for spelled in [f"{name}-{strength}" for strength in STRENGTHS] if name in KINDS else [name]:
            one = parse_corruption(spelled)
            if found.setdefault((one.kind, one.strength), one) != one:
                raise BadInput(f"corruptions={','.join(names)}: give each corruption once, with one seed")
    return tuple(found[each] for each in itertools.product(KINDS, STRENGTHS) if each in found)


def corrupt_queries(dataset: Dataset, name: str | None) -> Dataset:
    """Return a dataset whose query frames are corrupted when they are read, and whose protocol says so.

    None leaves it as it is. References, and places that a method chooses its settings by, stay clean. Raises BadInput
    for a name that is unknown.
    """
    if name is None:
        return dataset
    wanted = parse_corruption(name)
    text = f"{wanted.name} (queries {KINDS[wanted.kind].describe([wanted.strength])}; seed {wanted.seed})"
    queries = dataset.queries.changed(lambda image, frame: corrupt_frame(image, wanted, frame), text)
    return replace(dataset, queries=queries, protocol={**dataset.protocol, "corruption": text})


def corrupt_frame(image: Image, wanted: Corruption, frame: str) -> Image:
    """Return an image, uint8 (height, width, 3), corrupted; random draws follow from seed, kind and the frame's name.

    So it is the same in any order, process and batch, and all strengths of a kind go one way.
    """
    drawn = hashlib.sha256(f"{wanted.seed} {wanted.kind} {frame}".encode(errors="surrogateescape")).digest()
    kind = KINDS[wanted.kind]
    return kind.change(image, kind.amounts[wanted.strength - 1], np.random.default_rng([*drawn]))


def require_right_places(dataset: Dataset, corruptions: Sequence[str]) -> None:
    """Raise BadInput for a dataset without a right place: a corruption has no accuracy to lower."""
    if not any(map(len, dataset.positives)):
        raise BadInput(f"corruptions={','.join(corruptions)}: no query of {dataset.name} has a right place to lose")
