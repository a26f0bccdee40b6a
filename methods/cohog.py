"""CoHOG: histograms of oriented gradients of overlapping regions, each compared with the best region of a reference."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Self

import cv2
import numpy as np
import numpy.typing as npt
import torch

from vprbench.api import (
    BadInput,
    Image,
    Images,
    Method,
    NotFittedError,
    Places,
    Scores,
    best_image_of_place,
    count_operations,
)

from .parts.checks import require_arguments

Grey = npt.NDArray[np.uint8]  # (height, width)

_ENTROPY_BITS = 8  # of a pixel of 256 levels, which the entropy is given in shares of
_GRADIENT_UNITS = 2.0**24  # of the brightest pixel
_PRODUCT_BYTES = 8 << 20  # of the cosines that are held at a time, so that they stay in a cache


@dataclass
class CoHOG(Method):
    """Scores a place by the mean cosine of each good region of the query with the region most alike in the reference.

    Regions overlap: squares of `region_cells` x `region_cells` cells, one cell apart. Good are those with a mean
    local entropy of at least `entropy_threshold`; a query that has none scores 0 everywhere. Scores are 0 to 1.

    Source: Zaffar et al., "CoHOG", RA-L 2020, as in VPR-Bench (77ad30f).
    """

    size: int = 512  # pixels, height and width
    cell: int = 16  # pixels
    bins: int = 8  # of the angle, 0 to 360 degrees
    region_cells: int = 2
    sobel: int = 5  # pixels, width of the kernel
    entropy_size: int = 100  # pixels, height and width
    entropy_radius: int = 5  # pixels
    entropy_threshold: float = 0.4  # share of 8 bits
    device: str = "cpu"

    # The check fits some forty maps: small images do.
    conformance_arguments: ClassVar[Mapping[str, Any]] = {"size": 128, "entropy_size": 40}
    query_arguments: ClassVar[frozenset[str]] = frozenset({"entropy_size", "entropy_radius", "entropy_threshold"})

    _references: torch.Tensor | None = field(default=None, init=False, repr=False, compare=False)

    def fit(self, references: Images, places: Places) -> Self:
        """Keep the regions of the references; their goodness does not count."""
        regions = np.empty((len(references), *self._measure_regions()), np.float32)
        for own, image in zip(regions, references, strict=True):
            own[:] = self._describe(self._make_grey(image))
        self._references = torch.from_numpy(regions).to(self.device)
        self._places = places.copy()
        return self

    def encode(self, images: Images) -> npt.NDArray[np.float32]:
        """Return the regions and, as their last number, whether each is good (1) or not (0).

        The shape is (n_images, n_regions, region_cells**2 * bins + 1); a region is a unit vector or zero.
        """
        n_regions, n_dimensions = self._measure_regions()
        codes = np.empty((len(images), n_regions, n_dimensions + 1), np.float32)
        for number, image in enumerate(images):
            grey = self._make_grey(image)
            codes[number, :, :-1] = self._describe(grey)
            codes[number, :, -1] = self._measure_entropy(grey) >= self.entropy_threshold
        return codes

    def match(self, codes: npt.NDArray[np.float32]) -> Scores:
        """Return (n_queries, n_places), 0 to 1."""
        if self._references is None:
            raise NotFittedError("CoHOG has no map yet: call fit(references, places) first")
        similarity = np.zeros((len(codes), len(self._references)), np.float32)
        for code, own in zip(codes, similarity, strict=True):
            good = code[code[:, -1] > 0, :-1]
            if len(good):
                own[:] = mean_best_cosine(torch.from_numpy(good).to(self.device), self._references).cpu().numpy()
        return best_image_of_place(similarity, self._places)

    def map_bytes(self) -> int | None:
        """Return the bytes of the references' regions and of their places."""
        return None if self._references is None else self._references.nbytes + self._places.nbytes

    def _make_grey(self, image: Image) -> Grey:
        return _resize_square(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), self.size).astype(np.uint8, copy=False)

    def _describe(self, grey: Grey) -> npt.NDArray[np.float32]:
        return describe_regions(compute_histograms(grey, self.cell, self.bins, self.sobel), self.region_cells)

    def _measure_entropy(self, grey: Grey) -> npt.NDArray[np.float64]:
        """Return the mean entropy of each region, (n_regions,), 0 to 1."""
        small = _resize_square(grey, self.entropy_size).astype(np.uint8, copy=False)
        entropy = _resize_square(compute_entropy(small, self.entropy_radius), self.size)
        cells = entropy.reshape(self.size // self.cell, self.cell, -1, self.cell).sum((1, 3))
        pixels = (self.region_cells * self.cell) ** 2
        return np.asarray(_cut_windows(cells, self.region_cells).sum(1) / (_ENTROPY_BITS * pixels))

    def _measure_regions(self) -> tuple[int, int]:
        """Return the number of regions and their length; raises BadInput for arguments that do not fit."""
        require_arguments(
            self,
            cell=(self.cell >= 1, "at least 1 pixel"),
            bins=(self.bins >= 2, "at least 2"),
            region_cells=(self.region_cells >= 1, "at least 1"),
            sobel=(self.sobel in (3, 5, 7), "3, 5 or 7 pixels"),
            entropy_size=(self.entropy_size >= 1, "at least 1 pixel"),
            entropy_radius=(self.entropy_radius >= 0, "0 pixels or more"),
            entropy_threshold=(math.isfinite(self.entropy_threshold), "a finite number"),
        )
        if self.size % self.cell or self.size < self.region_cells * self.cell:
            raise BadInput(
                f"method.size={self.size}: give a multiple of method.cell={self.cell} that holds at least one region, "
                f"{self.region_cells * self.cell} pixels"
            )
        along = self.size // self.cell - self.region_cells + 1
        return along**2, self.region_cells**2 * self.bins


def mean_best_cosine(query: torch.Tensor, references: torch.Tensor) -> torch.Tensor:
    """Return for each reference (n_references, n_regions, d) the mean over the query's regions (n, d) of the best dot.

    The references are taken in blocks, so that memory stays bounded.
    """
    count_operations(float(len(query)) * references.numel())
    block = max(1, _PRODUCT_BYTES // (4 * references.shape[1] * len(query)))
    return torch.cat([(own @ query.T).amax(1).mean(1) for own in torch.split(references, block)])


def compute_histograms(grey: Grey, cell: int, bins: int, sobel: int) -> npt.NDArray[np.float64]:
    """Return the histogram of the gradient's angle in each cell, (height // cell, width // cell, bins).

    The gradient is that of the root of the grey level, the brightest pixel being 1. A pixel votes with |gx + gy| / 2
    (sic: not with the gradient's length), shared linearly between the bin that its angle lies in and the next one. Bin
    b begins at b * 360 / bins degrees; angles run from right (0) to down (90). Height and width are multiples of
    `cell`; beyond the border the image is mirrored without its last pixel.
    """
    count_operations(2 * sobel**2 * grey.size, 15 * grey.size, "float64")
    peak = max(int(grey.max()), 1)
    # Whole numbers leave no rounding in the gradient: normalised, it would turn flat regions into unit vectors.
    root = np.rint(np.sqrt(np.arange(256) / peak) * _GRADIENT_UNITS)[grey]
    across, down = (cv2.Sobel(root, cv2.CV_64F, *order, ksize=sobel) for order in ((1, 0), (0, 1)))
    magnitude = np.abs(across + down) / 2
    angle = np.arctan2(down.astype(np.float32), across.astype(np.float32)) * np.float32(bins / (2 * np.pi))
    position = np.where(angle < 0, angle + np.float32(bins), angle)  # in bins, 0 to `bins`
    lower = position.astype(np.int64)
    to_upper = magnitude * (position - lower)
    height, width = grey.shape[0] // cell, grey.shape[1] // cell
    slots = bins + 2  # the last two are the first two again, one turn on
    first = (np.arange(height * width) * slots).reshape(height, width).repeat(cell, 0).repeat(cell, 1) + lower
    votes = np.zeros((height, width, slots))
    for chosen, weight in ((first, magnitude - to_upper), (first + 1, to_upper)):
        votes += np.bincount(chosen.ravel(), weight.ravel(), votes.size).reshape(votes.shape)
    votes[:, :, :2] += votes[:, :, bins:]
    return votes[:, :, :bins] / _GRADIENT_UNITS


def describe_regions(histograms: npt.NDArray[np.float64], region_cells: int) -> npt.NDArray[np.float32]:
    """Return the histograms of each region as one unit vector, or zero, (n_regions, region_cells**2 * bins)."""
    regions = _cut_windows(histograms, region_cells)
    length = np.linalg.norm(regions, axis=1, keepdims=True)
    return (regions / np.where(length > 0, length, 1)).astype(np.float32)


def compute_entropy(levels: Grey, radius: int) -> npt.NDArray[np.float64]:
    """Return the Shannon entropy in bits of the levels in a disk around each pixel, (height, width).

    The disk holds the pixels at most `radius` away that lie inside the image, as skimage.filters.rank.entropy has it.
    """
    height, width = levels.shape
    outside = 256
    padded = np.pad(levels.astype(np.int64), radius, constant_values=outside)
    offsets = np.arange(-radius, radius + 1)
    down, across = np.nonzero(offsets[:, None] ** 2 + offsets[None, :] ** 2 <= radius**2)
    count_operations(single=levels.size * (len(down) + 256), kind="int64")
    weight = np.arange(len(down) + 1, dtype=np.float64)
    weight[2:] *= np.log2(weight[2:])
    weight[:2] = 0
    start = np.arange(width) * (outside + 1)
    entropy = np.empty((height, width))
    for row in range(height):  # the histograms of one row fit a cache
        seen = padded[row + down[:, None], across[:, None] + np.arange(width)]  # (n_disk, width)
        histogram = np.bincount((start + seen).ravel(), minlength=width * (outside + 1)).reshape(width, -1)
        counted = len(down) - histogram[:, outside]
        entropy[row] = np.log2(counted) - weight[histogram[:, :outside]].sum(1) / counted
    return np.maximum(entropy, 0)  # of one level rounding may leave less


def _cut_windows(cells: npt.NDArray[np.float64], side: int) -> npt.NDArray[np.float64]:
    """Return the cells (rows, columns, ...) of each side x side square, (n_squares, side * side * ...), row by row."""
    squares = np.lib.stride_tricks.sliding_window_view(cells, (side, side), axis=(0, 1))
    return np.moveaxis(squares, (-2, -1), (2, 3)).reshape(squares.shape[0] * squares.shape[1], -1)


def _resize_square(image: npt.NDArray[Any], size: int) -> npt.NDArray[Any]:
    return np.asarray(cv2.resize(image, (size, size), interpolation=cv2.INTER_LINEAR))
