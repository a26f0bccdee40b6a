"""Queries seen from several viewpoints: shifted and enlarged copies of each frame; the best one counts for a place."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from vprbench.api.arrays import Image
from vprbench.api.dataset import Dataset
from vprbench.plugins.options import build_options

_EXAMPLE = "views=[-0.1,0,0.1] or views={vertical:[-0.1,0,0.1],zoom:[1,1.1]}"


@dataclass(frozen=True)
class Viewpoint:
    """Where a view looks, beside the frame itself: shifts in widths to the right, in heights downwards, and a zoom."""

    horizontal: float = 0.0
    vertical: float = 0.0
    zoom: float = 1.0  # above 1: the middle of the frame, enlarged so many times

    def __str__(self) -> str:
        """Return its shifts and zoom, that of the width alone if there is no other."""
        vertical = "" if self.vertical == 0 else f"/{self.vertical:g}"
        return f"{self.horizontal:g}{vertical}" + ("" if self.zoom == 1 else f" zoom {self.zoom:.3g}")


@dataclass(frozen=True)
class Viewpoints:
    """The views of each query; raises ValueError for impossible ones."""

    horizontal: tuple[float, ...] = (0.0,)  # in widths
    vertical: tuple[float, ...] = (0.0,)  # in heights
    zoom: tuple[float, ...] = (1.0,)  # enlargements, 0.5 to 2

    def __post_init__(self) -> None:
        """Check the shifts and zooms."""
        shifts = (*self.horizontal, *self.vertical)
        possible = all(abs(each) <= 0.5 for each in shifts) and all(0.5 <= each <= 2 for each in self.zoom)  # not NaN
        if not possible or not self.all or len({*self.all}) < len(self.all):
            wanted = "shifts from -0.5 to 0.5 of the frame and enlargements from 0.5 to 2, each view once"
            raise ValueError(f"{self.protocol() or '[]'}: give {wanted}, as in {_EXAMPLE}")

    @property
    def all(self) -> list[Viewpoint]:
        """Every horizontal shift with every vertical one and every zoom."""
        return [Viewpoint(*each) for each in itertools.product(self.horizontal, self.vertical, self.zoom)]

    def protocol(self) -> str:
        """Return their entry in the protocol of a run."""
        return "+".join(map(str, self.all))


def parse_viewpoints(value: Any) -> Viewpoints | None:
    """Return the views that the option asks for, a list of shifts or a mapping of `Viewpoints`; None for null.

    Raises BadInput for a value that is neither, and for impossible views.
    """
    if value is None:
        return None
    return build_options("views", Viewpoints, value if isinstance(value, Mapping) else {"horizontal": value})


def record_viewpoints(dataset: Dataset, views: Viewpoints | None) -> Dataset:
    """Return a dataset whose protocol names the viewpoints of its queries."""
    return dataset if views is None else replace(dataset, protocol={**dataset.protocol, "views": views.protocol()})


def render_view(image: Image, viewpoint: Viewpoint) -> Image:
    """Return an image (height, width, 3) as a camera that looks elsewhere would show it, its borders reflected.

    Shifts are by whole pixels; an enlargement about the middle interpolates between pixels.
    """
    if viewpoint == Viewpoint():
        return image
    (height, width), zoom = image.shape[:2], viewpoint.zoom
    left, up = -round(viewpoint.horizontal * width), -round(viewpoint.vertical * height)
    matrix = np.array([[zoom, 0, (1 - zoom) * (width - 1) / 2 + left], [0, zoom, (1 - zoom) * (height - 1) / 2 + up]])
    return np.asarray(cv2.warpAffine(image, matrix, (width, height), borderMode=cv2.BORDER_REFLECT_101), np.uint8)
