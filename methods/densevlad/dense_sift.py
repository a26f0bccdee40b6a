"""Dense SIFT at several scales on one grid, as VLFeat's vl_phow computes it with its fast, flat windows."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Literal

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from vprbench.api import Image

ArcTangent = Literal["exact", "vlfeat"]

BIN_SIZES = (4, 6, 8, 10)  # pixels
STEP = 2  # pixels between neighbouring descriptors
BINS = 4  # spatial bins along each side
ORIENTATIONS = 8
DIMENSIONS = BINS * BINS * ORIENTATIONS
SMALLEST_SIDE = min(
    math.floor(1.5 * (max(BIN_SIZES) - size)) + (BINS - 1) * size + 1 for size in BIN_SIZES
)  # pixels; nothing is seen in a smaller image
LOW_CONTRAST = 0.005

_WINDOW = 1.5  # standard deviation of the Gaussian window, in bins
_CLAMP = 0.2
_EPSILON = float(np.finfo(np.float32).eps)
_TOGETHER = 1 << 15  # descriptors; 16 MiB


def make_grey(image: Image) -> npt.NDArray[np.uint8]:
    """Return (height, width), 0..255, with the weights of MATLAB's rgb2gray, rounded half up."""
    weights = np.array([0.298936021293776, 0.587043074451121, 0.114020904255103])
    return np.asarray(np.floor(image @ weights + 0.5), np.uint8)


def halve_image(grey: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
    """Return every second pixel from the first on, without the last row and column (VLFeat's vl_imdown)."""
    return grey[:-1:2, :-1:2]


def count_descriptors(height: int, width: int) -> int:
    """Return how many descriptors an image of this size has, over all scales."""
    return sum(len(_place_corners(height, size)) * len(_place_corners(width, size)) for size in BIN_SIZES)


def dense_sift(grey: Tensor, arctan: ArcTangent = "exact") -> Iterator[Tensor]:
    """Yield the descriptors (n, 128) of a grey image (height, width), 0 to 1, in blocks, scale after scale.

    Unit vectors, clamped at 0.2 and normalised again; zero for less contrast than 0.005. Within a descriptor the
    orientation runs fastest, then the column of the bin, then its row; angles turn from right to down.
    Source: VLFeat 0.9.21, vl_phow and vl_dsift, with its approximation of the arc tangent by `arctan`=vlfeat; that of
    the root is left out.
    """
    for size in BIN_SIZES:
        yield from _describe_scale(grey, size, arctan)


def compute_root_sift(unit: Tensor) -> Tensor:
    """Return the RootSIFT (n, 128) of SIFT unit vectors, which are first cut to whole levels 0..255 of 1 / 512."""
    levels = (512 * unit).clamp_(max=255).floor_()
    levels /= levels.sum(1, keepdim=True) + 1e-12
    return levels.sqrt_()


def _describe_scale(grey: Tensor, size: int, arctan: ArcTangent) -> Iterator[Tensor]:
    rows, columns = (_place_corners(length, size) for length in grey.shape)
    if not (len(rows) and len(columns)):
        return
    maps = _map_orientations(_smooth_image(grey, size / 6), arctan)
    bins = size * np.arange(BINS)
    at_rows, row_of = np.unique(rows[:, None] + bins, return_inverse=True)
    at_columns, column_of = np.unique(columns[:, None] + bins, return_inverse=True)
    down = _build_filter(grey.shape[0], at_rows, size, lambda t: 1 - np.abs(t) / size).to(grey)
    across = _build_filter(grey.shape[1], at_columns, size, lambda t: 1 - np.abs(t) / size).to(grey)
    sampled = (down @ (maps @ across.T)).permute(1, 2, 0).contiguous()  # (rows, columns, orientations)
    window = torch.from_numpy(_weigh_bins(size)).to(grey)
    row_of, column_of = row_of.reshape(len(rows), BINS), column_of.reshape(len(columns), BINS)
    together = max(1, _TOGETHER // len(columns))
    for first in range(0, len(rows), together):
        own = row_of[first : first + together]
        picked = sampled[own[:, None, :, None], column_of[None, :, None, :]]
        yield _normalise_histograms(picked.mul_(window[:, :, None]).view(-1, DIMENSIONS), size)


def _place_corners(length: int, size: int) -> npt.NDArray[np.int64]:
    """Return where the first bin's centre of each descriptor lies along a side; all scales share their first centre."""
    first = math.floor(1.5 * (max(BIN_SIZES) - size))
    return np.arange(first, max(first, length - (BINS - 1) * size), STEP)


def _smooth_image(grey: Tensor, sigma: float) -> Tensor:
    """Return the image under a Gaussian of this standard deviation (pixels), cut at four of them."""
    radius = math.ceil(4 * sigma)
    total = np.exp(-0.5 * (np.arange(-radius, radius + 1) / sigma) ** 2).sum()
    down, across = (
        _build_filter(length, np.arange(length), radius + 1, lambda t: np.exp(-0.5 * (t / sigma) ** 2) / total).to(grey)
        for length in grey.shape
    )
    return down @ grey @ across.T


def _map_orientations(grey: Tensor, arctan: ArcTangent) -> Tensor:
    """Return (orientations, height, width): each pixel's gradient, shared between the two nearest orientations."""
    down, right = torch.gradient(grey)
    strength = torch.hypot(down, right)
    angle = _approximate_atan2(down, right) if arctan == "vlfeat" else torch.atan2(down, right)
    angle = torch.remainder(angle * (ORIENTATIONS / (2 * math.pi)), ORIENTATIONS)
    lower = angle.floor()
    share = angle - lower
    below = lower.long()[None] % ORIENTATIONS
    maps = grey.new_zeros(ORIENTATIONS, *grey.shape)
    maps.scatter_(0, below, ((1 - share) * strength)[None])
    maps.scatter_(0, (below + 1) % ORIENTATIONS, (share * strength)[None])
    return maps


def _approximate_atan2(y: Tensor, x: Tensor) -> Tensor:
    """Return VLFeat's vl_fast_atan2_f: a cubic in each quadrant, up to 0.006 radians off the arc tangent."""
    above = y.abs() + _EPSILON
    ahead = x >= 0
    ratio = torch.where(ahead, x - above, x + above) / torch.where(ahead, x + above, above - x)
    angle = (3 - 2 * ahead.to(ratio)) * (math.pi / 4) + (0.1821 * ratio**2 - 0.9675) * ratio
    return torch.where(y < 0, -angle, angle)


def _build_filter(
    length: int,
    at: npt.NDArray[np.int64],
    reach: int,
    kernel: Callable[[npt.NDArray[np.int64]], npt.NDArray[np.float64]],
) -> Tensor:
    """Return the matrix (len(at), length) that filters a line at these places; beyond its ends it goes on unchanged."""
    offsets = np.arange(1 - reach, reach)
    matrix = np.zeros((len(at), length))
    where = np.clip(at[:, None] + offsets, 0, length - 1)
    np.add.at(matrix, (np.arange(len(at))[:, None], where), np.broadcast_to(kernel(offsets), where.shape))
    return torch.from_numpy(matrix)


def _weigh_bins(size: int) -> npt.NDArray[np.float64]:
    """Return the weight of each spatial bin, (bins, bins): the Gaussian window's mean over its pixels."""
    offsets = np.arange(1 - size, size)
    centres = size * (np.arange(BINS) - (BINS - 1) / 2)
    means = np.exp(-0.5 * ((offsets - centres[:, None]) / (_WINDOW * size)) ** 2).mean(1)
    return np.outer(means, means)


def _normalise_histograms(histograms: Tensor, size: int) -> Tensor:
    """Make histograms (n, 128) unit vectors, in place; their contrast is the sum per pixel of a descriptor's frame."""
    contrast = histograms.sum(1, keepdim=True) / ((BINS - 1) * size + 1) ** 2
    histograms /= histograms.norm(dim=1, keepdim=True) + _EPSILON
    histograms.clamp_(max=_CLAMP)
    histograms *= (contrast >= LOW_CONTRAST) / (histograms.norm(dim=1, keepdim=True) + _EPSILON)
    return histograms
