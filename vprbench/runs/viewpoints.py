"""Queries seen from several viewpoints: shifted copies of each frame, of which the best one counts for a place."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from vprbench import progress
from vprbench.api.arrays import Image, Scores
from vprbench.api.dataset import Dataset
from vprbench.api.images import Images
from vprbench.api.method import Method
from vprbench.errors import BadInput
from vprbench.metrics.intervals import WiderInterval, difference_interval, share_interval
from vprbench.plugins.checked import checked
from vprbench.plugins.entries import read
from vprbench.text import near

_STEP = 1 / 64  # of the width: the least shift that `auto` tries
_STEPS = 19  # to either side
_NEIGHBOURS = 2  # steps from the offset to the views beside it
_FAR = 3  # steps from which another shift shows nothing of the same offset
_CHANCE = 0.05  # that an offset is taken which is none, among all that are tried
_BY_CHANCE = 2 / 3  # of the queries: how often one of two views that show no more is better than the frame itself
_BLOCK = 64  # queries scored together while an offset is looked for
_EXAMPLE = "as in views=[-0.1,0,0.1], views=auto or views={horizontal:[0],vertical:[-0.1,0,0.1]}"

ZScores = npt.NDArray[np.float64]  # (n_shifts, n_queries)


@dataclass(frozen=True)
class Viewpoint:
    """Where a view looks, beside the frame itself: shifts in widths to the right, and in heights downwards."""

    horizontal: float
    vertical: float = 0.0

    def __str__(self) -> str:
        """Return its shifts, that of the width alone if there is no other."""
        return f"{self.horizontal:g}" if self.vertical == 0 else f"{self.horizontal:g}/{self.vertical:g}"


AS_IT_IS = Viewpoint(0.0)


@dataclass(frozen=True)
class Viewpoints:
    """The views of each query, or that they are chosen by the first queries; raises BadInput for shifts beyond 0.5."""

    horizontal: tuple[float, ...] = (0.0,)  # in widths
    vertical: tuple[float, ...] = (0.0,)  # in heights
    auto: bool = False  # shifts of the width, told from the queries
    queries: int | None = 1000  # the first ones, by which `auto` chooses; None: all

    def __post_init__(self) -> None:
        """Check the shifts."""
        shifts = (*self.horizontal, *self.vertical)
        if not self.horizontal or not self.vertical or not all(abs(each) <= 0.5 for each in shifts):  # NaN too
            raise BadInput(f"views={shifts}: give shifts from -0.5 to 0.5 of the frame, {_EXAMPLE}")
        if len({*self.all}) < len(self.all):
            raise BadInput(f"views={shifts}: give each shift once, {_EXAMPLE}")
        if self.auto and set(shifts) != {0.0}:
            raise BadInput(f"views={shifts}: auto chooses the shifts itself, give none beside it")
        if self.queries is not None and self.queries < 1:
            raise BadInput(f"views.queries={self.queries}: give at least 1 query, or null for all")

    @property
    def all(self) -> list[Viewpoint]:
        """Every horizontal shift with every vertical one."""
        return [Viewpoint(*shifts) for shifts in itertools.product(self.horizontal, self.vertical)]

    def protocol(self) -> str:
        """Return what stands of them in the protocol of a run."""
        if self.auto:
            return f"auto, by {'all' if self.queries is None else f'the first {self.queries}'} queries"
        return "+".join(map(str, self.all))


def viewpoints(value: Any) -> Viewpoints | None:
    """Return the views that the option asks for; None for null. Raises BadInput for what it cannot be."""
    if isinstance(value, str):
        value = read(value.replace(":", ": "))
    if value is None:
        return None
    given = {"auto": True} if value == "auto" else value if isinstance(value, Mapping) else {"horizontal": value}
    hints: dict[str, Any] = {
        **{"horizontal": tuple[float, ...], "vertical": tuple[float, ...]},
        **{"auto": bool, "queries": int | None},
    }
    for name in given:
        if name not in hints:
            raise BadInput(f"option views.{name} is unknown: {near(name, hints)}")
    return Viewpoints(**{name: checked(f"views.{name}", each, hints[name]) for name, each in given.items()})


def seen_from(dataset: Dataset, views: Viewpoints | None) -> Dataset:
    """Return a dataset whose protocol says from which viewpoints its queries are asked."""
    return dataset if views is None else replace(dataset, protocol={**dataset.protocol, "views": views.protocol()})


def shifted(image: Image, viewpoint: Viewpoint) -> Image:
    """Return an image (height, width, 3) as a camera that looks elsewhere would show it, its borders reflected."""
    rows, columns = (
        _reflected(length, round(shift * length))
        for length, shift in zip(image.shape[:2], (viewpoint.vertical, viewpoint.horizontal), strict=True)
    )
    across = image if viewpoint.horizontal == 0 else image[:, columns]
    return np.ascontiguousarray(across if viewpoint.vertical == 0 else across[rows])


def _reflected(length: int, shift: int) -> npt.NDArray[np.int64]:
    """Return which row or column is seen at each place after a shift; the border itself is not repeated."""
    last = length - 1
    return np.asarray(last - np.abs(last - np.abs(np.arange(length) + shift)))


class Viewed:
    """Stands in for a fitted method where it is asked: a place's score is that of the view that shows it best."""

    def __init__(self, method: Method, views: Sequence[Viewpoint]) -> None:
        """Ask the method for each query from these viewpoints."""
        self.method, self.views = method, views

    @property
    def code_bytes(self) -> int:
        """Bytes of the codes of one query."""
        return self.method.code_bytes * len(self.views)

    def encode(self, images: Images) -> npt.NDArray[Any]:
        """Turn queries into the codes of their views, (n_queries, n_views, ...)."""
        frames = [shifted(image, view) for image in images for view in self.views]
        codes = self.method.encode(Images.from_arrays(frames))
        return codes.reshape(len(images), len(self.views), *codes.shape[1:])

    def match(self, codes: npt.NDArray[Any]) -> Scores:
        """Return the best score of every place among the views, (n_queries, n_places)."""
        scores = self.method.match(codes.reshape(-1, *codes.shape[2:]))
        return np.asarray(scores.reshape(*codes.shape[:2], -1).max(1), np.float32)


@dataclass(frozen=True)
class Offset:
    """Which views `auto` chose, and why."""

    views: tuple[Viewpoint, ...]
    evidence: Mapping[str, Any]


def told_from(method: Method, queries: Images, asked: Viewpoints) -> Offset:
    """Tell the offset of a drive from its first queries, without ground truth; the frames as they are if none is told.

    A query's evidence for a shift is how far its best place stands above the others, in standard deviations. The pair
    of opposite shifts with the most evidence is taken if the better of the two beats the frame itself by more than
    chance gives, for more than 2/3 of the queries or on the mean, if the pair has more evidence than the shifts apart
    from it, and if it is not the furthest; intervals allow for neighbouring queries and for all that is tried. Of the
    pair the better side is shown with its neighbours, or both sides and the frame itself if the weaker side has more
    evidence than other shifts too.
    """
    count = len(queries) if asked.queries is None else min(asked.queries, len(queries))
    z = np.concatenate([*_z_scores(method, queries[:count])], axis=1)
    return offset_of(z)


def offset_of(z: ZScores) -> Offset:
    """Return the offset by the evidence of shifts of -19 to 19 steps, (39, n_queries)."""
    confidence = 1 - _CHANCE / (2 * _STEPS)
    right, left = z[_STEPS:], z[_STEPS::-1]  # of 0 to 19 steps
    pairs = np.maximum(right, left)
    best = 1 + int(pairs[1:].mean(1).argmax())
    others = [step for step in range(1, _STEPS + 1) if abs(step - best) > _FAR]
    by_chance = (pairs - (right + left) / 2)[others].mean(0)  # what the better of two shifts has for no reason
    better = share_interval(pairs[best] > z[_STEPS], confidence)
    gain = difference_interval(pairs[best] - by_chance, z[_STEPS], confidence)
    above = difference_interval(pairs[best], pairs[others].mean(0), confidence)
    told = best < _STEPS and _low(above) > 0 and (_low(better) > _BY_CHANCE or _low(gain) > 0)
    evidence = {
        "queries": z.shape[1],
        "shifts": [step * _STEP for step in range(-_STEPS, _STEPS + 1)],
        "mean_evidence": [float(each) for each in z.mean(1)],
        "best_shift": best * _STEP,
        "better_than_the_frame": float((pairs[best] > z[_STEPS]).mean()),
        "better_at_least": better and better.low,
        "gain_at_least": gain and gain.low,
        "above_others_at_least": above and above.low,
        "both_sides": None,
    }
    if not told:
        return Offset((AS_IT_IS,), evidence)
    sides = sorted((right, left), key=lambda side: float(side[best].mean()))
    far = np.mean([side[others] for side in (right, left)], axis=(0, 1))
    both = _low(difference_interval(sides[0][best], far, confidence)) > 0
    if both:
        steps = [-best, 0, best]
    else:
        sign = 1 if sides[1] is right else -1
        steps = [sign * best + beside for beside in (-_NEIGHBOURS, 0, _NEIGHBOURS)]
    return Offset(tuple(Viewpoint(step * _STEP) for step in steps), {**evidence, "both_sides": both})


def _low(interval: WiderInterval | None) -> float:
    """Return the lower end of an interval, below everything if there is none."""
    return -math.inf if interval is None else interval.low


def _z_scores(method: Method, queries: Images) -> Iterator[ZScores]:
    """Yield for blocks of queries how far the best place stands above the others, at each shift."""
    done = 0
    for block in queries.blocks(_BLOCK):
        found = []
        for step in range(-_STEPS, _STEPS + 1):
            one = Viewed(method, [Viewpoint(step * _STEP)])
            found.append(_above_others(one.match(one.encode(block))))
        done += len(block)
        progress.report("looking for an offset", done / len(queries))
        yield np.array(found)


def _above_others(scores: Scores) -> npt.NDArray[np.float64]:
    """Return by how many standard deviations the best place is above the mean of a query's candidates, (n_queries,)."""
    there = scores > -math.inf
    known = np.where(there, scores, 0.0).astype(np.float64)
    counts = np.maximum(there.sum(1), 1)
    means = known.sum(1) / counts
    spread = np.sqrt(np.where(there, (known - means[:, None]) ** 2, 0.0).sum(1) / counts)
    best = np.where(there.any(1), np.where(there, scores, -math.inf).max(1), means)
    return np.asarray((best - means) / np.where(spread > 0, spread, 1.0))
