"""Queries seen from several viewpoints: shifted copies of each frame, of which the best one counts for a place."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from vprbench.api.arrays import Image, Scores
from vprbench.api.dataset import Dataset
from vprbench.api.images import Images
from vprbench.api.method import Method
from vprbench.errors import BadInput
from vprbench.plugins.checked import checked
from vprbench.plugins.entries import read
from vprbench.text import near

_EXAMPLE = "as in views=[-0.1,0,0.1], views=auto or views={horizontal:[0],vertical:[-0.1,0,0.1]}"


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
