"""Frames as pixels that are compared one by one: grey and small, patch-normalised in three published variants or not.

The float32 operations of the compiled functions and their order are those of PyTorch, which the public code calls: in
windows that are flat but for rounding noise the noise decides the level, and methods of this kind see it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
import numpy.typing as npt
from numba import types

from vprbench.api import BadInput, Image, Images, compiled, count_operations, encode_blocks

MEAN_LEVEL = 127  # of a patch-normalised pixel: its window's mean

Variant = Literal["A", "B", "C"]
Preprocessing = Literal["grey", "A", "B", "C"]  # grey: antialiased, not patch-normalised

_LEVELS = np.arange(256, dtype=np.float32)

_SMALL_BYTES = 1 << 16
_NEARLY_FLAT = np.float32(1e-4)  # deviation over mean, below which a window is looked at for being constant
_CASCADE = 16  # terms that PyTorch adds up before it adds them to its sum
_IMAGES = types.Array(types.uint8, 4, "C", readonly=True)
_TAPS, _SMALL, _ROWS = types.float32[:, :, :, :, ::1], types.float32[:, :, ::1], types.uint8[:, ::1]


def pixels(images: Images, preprocessing: Preprocessing, height: int, width: int, patch: int) -> npt.NDArray[np.uint8]:
    """Return levels 0..255, (n_images, height * width); raises BadInput for sizes that make no frame."""
    if preprocessing != "grey":
        return PatchNormalisation(preprocessing, height, width, patch)(images)
    if min(height, width) < 1:
        raise BadInput(f"method.height={height}, method.width={width}: give sizes of at least 1 pixel")
    levels = np.empty((len(images), height, width), np.uint8)
    for level, image in zip(levels, images, strict=True):
        grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
        level[:] = cv2.resize(grey, (width, height), interpolation=cv2.INTER_AREA)
    return levels.reshape(len(images), -1)


@dataclass(frozen=True)
class PatchNormalisation:
    """The preprocessing of one variant, to grey levels 0..255.

    A: VPRSNN (d38f30c): resize in colour, grey, no gamma, population standard deviation.
    B: VPRTempo v1.0.0 (a3b07b2): grey and gamma as uint8, resize, population standard deviation.
    C: VPRTempo 64154e5: grey and gamma in float32, resize, unbiased standard deviation.
    No variant resizes with antialiasing. All threads that PyTorch may use share the frames. Raises BadInput for an even
    `patch` (pixels), which has no centre.
    """

    variant: Variant = "C"
    height: int = 28
    width: int = 28
    patch: int = 7

    def __post_init__(self) -> None:
        """Check the sizes."""
        if self.patch < 3 or self.patch % 2 == 0:
            raise BadInput(f"method.patch={self.patch}: the window needs a centre, give an odd number from 3 on")
        if min(self.height, self.width) < 1:
            raise BadInput(f"method.height={self.height}, method.width={self.width}: give sizes of at least 1 pixel")

    def __call__(self, images: Images) -> npt.NDArray[np.uint8]:
        """Return (n_images, height * width)."""
        levels, window = np.empty((len(images), self.height * self.width), np.uint8), self.patch**2
        # A pixel blends four, each made grey, gamma-corrected and clipped; then comes its window's mean and deviation.
        count_operations(levels.size * (4 * 3 + 4 + window), levels.size * (4 * 3 + 2 * window + 7))
        encode_blocks(images, levels, self._normalise)
        return levels

    def shrink(self, image: Image) -> npt.NDArray[np.float32]:
        """Return the grey, gamma-corrected image as (height, width), levels 0..255."""
        size = (self.width, self.height)
        if self.variant == "A":
            small = cv2.resize(image, size, interpolation=cv2.INTER_LINEAR)
            return cv2.cvtColor(small, cv2.COLOR_RGB2GRAY).astype(np.float32)
        if self.variant == "B":
            grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
            levels = cv2.LUT(grey, _correct_gamma(_LEVELS.copy(), grey.mean()).astype(np.uint8))
            return cv2.resize(levels, size, interpolation=cv2.INTER_LINEAR).astype(np.float32)
        shrunk = np.empty((1, self.height, self.width), np.float32)
        self._shrink_block([image], shrunk)
        return np.asarray(shrunk[0], np.float32)

    def _normalise(self, block: Sequence[Image], levels: npt.NDArray[np.uint8]) -> None:
        small = np.empty((len(block), self.height, self.width), np.float32)
        if self.variant == "C":
            self._shrink_block(block, small)
        else:
            for number, image in enumerate(block):
                small[number] = self.shrink(image)
        normalise_patches(small, self.patch, self._ddof, levels)

    def _shrink_block(self, block: Sequence[Image], small: npt.NDArray[np.float32]) -> None:
        """Shrink images by variant C: only pixels that the resize reads are corrected."""
        taps = np.empty((len(block), 2, 2, self.height, self.width), np.float32)
        means = np.empty(len(block))
        alike = len({image.shape for image in block}) == 1
        # Small images are copied side by side: calls from several threads would wait for one another.
        step = len(block) if alike and block[0].nbytes <= _SMALL_BYTES else 1
        for first in range(0, len(block), step):
            own = slice(first, first + step)
            images = np.stack(block) if step > 1 else np.ascontiguousarray(block[first])[None]
            take_taps(images, taps[own], means[own])
        _correct_gamma(taps, means[:, None, None, None, None])
        blend_taps(taps, np.array([image.shape[:2] for image in block]), small)

    @property
    def _ddof(self) -> int:
        """Return the number that is subtracted from the count of a window's pixels in its variance."""
        return 1 if self.variant == "C" else 0


def _correct_gamma(
    grey: npt.NDArray[np.float32], mean: npt.NDArray[np.float64] | np.float64
) -> npt.NDArray[np.float32]:
    """Map the mean of grey images, levels 0..255, to 127.5 and clip to 0..255, in place; `mean` is one or one an image.

    The exponent is ln(0.5 * 255) / ln(mean) (VPRTempo 64154e5). An image whose mean is at most 1, where the exponent
    has no finite positive value, is left unchanged: a black frame stays black.
    """
    exponent = np.where(mean > 1, np.log(127.5) / np.log(np.maximum(mean, 1 + 1e-9)), 1)
    with np.errstate(over="ignore"):  # a nearly black image has a huge exponent; overflows are clipped
        np.power(grey, exponent.astype(np.float32), out=grey)
    return np.clip(grey, 0, 255, out=grey)


# The kernels below have no type hints: numba compiles each for the types of its first call.


@compiled()
def _multiply_add(a, b, c):  # type: ignore[no-untyped-def]
    """Return a * b + c in float32 with a single rounding, as processors with such an instruction do."""
    return np.float32(np.float64(a) * np.float64(b) + np.float64(c))


@compiled()
def _find_source(index, size, source_size):  # type: ignore[no-untyped-def]
    """Return the first source pixel of a bilinear resize with half-pixel centres, and the share of the second."""
    scale = np.float32(source_size) / np.float32(size)
    position = max(_multiply_add(scale, np.float32(index) + np.float32(0.5), np.float32(-0.5)), np.float32(0))
    first = min(np.int64(position), source_size - 1)
    return first, min(max(position - np.float32(first), np.float32(0)), np.float32(1))


@compiled()
def _make_grey(pixel):  # type: ignore[no-untyped-def]
    weighted = np.float32(0.299) * np.float32(pixel[0]) + np.float32(0.587) * np.float32(pixel[1])
    return weighted + np.float32(0.114) * np.float32(pixel[2])


@compiled()
def _is_constant(small, row, column, half):  # type: ignore[no-untyped-def]
    """Tell whether a window, cut at the border, holds one level only."""
    height, width = small.shape
    for y in range(max(row - half, 0), min(row + half + 1, height)):
        for x in range(max(column - half, 0), min(column + half + 1, width)):
            if small[y, x] != small[row, column]:
                return False
    return True


@compiled()
def _average_windows(grey, patch, stride, count, part, mean):  # type: ignore[no-untyped-def]
    part[:] = mean[:] = 0
    for dy in range(patch):
        for dx in range(patch):
            window = grey[dy * stride + dx :]
            for k in range(len(mean)):
                part[k] += window[k]
            if (dy * patch + dx) % _CASCADE == _CASCADE - 1:
                for k in range(len(mean)):
                    mean[k] += part[k]
                    part[k] = 0
    for k in range(len(mean)):
        mean[k] = (part[k] + mean[k]) / count[k]


@compiled()
def _measure_deviations(grey, inside, patch, stride, mean, part, deviation):  # type: ignore[no-untyped-def]
    part[:] = deviation[:] = 0
    for dy in range(patch):
        for dx in range(patch):
            window, exists = grey[dy * stride + dx :], inside[dy * stride + dx :]
            for k in range(len(mean)):
                away = (window[k] - mean[k]) * exists[k]
                part[k] += away * away
            if (dy * patch + dx) % _CASCADE == _CASCADE - 1:
                for k in range(len(mean)):
                    deviation[k] += part[k]
                    part[k] = 0
    for k in range(len(mean)):
        deviation[k] += part[k]


@compiled(_IMAGES, _TAPS, types.float64[::1])
def take_taps(images, taps, means):  # type: ignore[no-untyped-def]
    """Write the grey levels that a resize reads of `images` (n, h, w, 3) to `taps` (n, 2, 2, height, width).

    The mean grey level of each whole image goes to `means` (n,).
    """
    n, _, _, height, width = taps.shape
    h, w = images.shape[1:3]
    for number in range(n):
        image = images[number]
        for row in range(height):
            above, _ = _find_source(row, height, h)
            below = min(above + 1, h - 1)
            for column in range(width):
                left, _ = _find_source(column, width, w)
                right = min(left + 1, w - 1)
                taps[number, 0, 0, row, column] = _make_grey(image[above, left])
                taps[number, 0, 1, row, column] = _make_grey(image[above, right])
                taps[number, 1, 0, row, column] = _make_grey(image[below, left])
                taps[number, 1, 1, row, column] = _make_grey(image[below, right])
        red = green = blue = np.int64(0)
        for row in range(h):
            red_here = green_here = blue_here = np.int32(0)
            for column in range(w):
                red_here += np.int32(image[row, column, 0])
                green_here += np.int32(image[row, column, 1])
                blue_here += np.int32(image[row, column, 2])
            red, green, blue = red + red_here, green + green_here, blue + blue_here
        means[number] = (0.299 * red + 0.587 * green + 0.114 * blue) / (h * w)


@compiled(_TAPS, types.int64[:, ::1], _SMALL)
def blend_taps(taps, sizes, small):  # type: ignore[no-untyped-def]
    """Blend `taps` (n, 2, 2, height, width) of images of `sizes` (n, 2), h and w, to `small` (n, height, width)."""
    n, height, width = small.shape
    for image in range(n):
        least = most = taps[image, 0, 0, 0, 0]
        for tap in taps[image].flat:
            least, most = min(least, tap), max(most, tap)
        if least == most:  # the weights would leave rounding noise
            small[image] = least
            continue
        for row in range(height):
            _, down = _find_source(row, height, sizes[image, 0])
            up = np.float32(1) - down
            for column in range(width):
                _, right = _find_source(column, width, sizes[image, 1])
                left = np.float32(1) - right
                level = taps[image, 0, 1, row, column] * (up * right)
                level = _multiply_add(taps[image, 0, 0, row, column], up * left, level)
                level = _multiply_add(taps[image, 1, 0, row, column], down * left, level)
                small[image, row, column] = _multiply_add(taps[image, 1, 1, row, column], down * right, level)


@compiled(_SMALL, types.int64, types.int64, _ROWS)
def normalise_patches(small, patch, ddof, levels):  # type: ignore[no-untyped-def]
    """Write the patch-normalised `small` (n, height, width) to `levels` (n, height * width)."""
    n, height, width = small.shape
    half = patch // 2
    stride = width + 2 * half
    # Flat, with a border of zeros on every side: a shift of the window is a shift of the index.
    length = height * stride
    grey = np.zeros(length + 2 * half * stride + 2 * half, np.float32)
    inside = np.zeros(len(grey), np.float32)
    mean, deviation = np.empty(length, np.float32), np.empty(length, np.float32)
    part, count = np.empty(length, np.float32), np.zeros(length, np.float32)
    for row in range(height):
        start = (row + half) * stride + half
        inside[start : start + width] = np.float32(1)
    for dy in range(patch):
        for dx in range(patch):
            exists = inside[dy * stride + dx :]
            for k in range(length):
                count[k] += exists[k]
    for image in range(n):
        for row in range(height):
            start = (row + half) * stride + half
            grey[start : start + width] = small[image, row]
        _average_windows(grey, patch, stride, count, part, mean)
        _measure_deviations(grey, inside, patch, stride, mean, part, deviation)
        for row in range(height):
            for column in range(width):
                k = row * stride + column
                spread = np.sqrt(deviation[k] / (count[k] - np.float32(ddof)))
                z = (small[image, row, column] - mean[k]) / spread
                flat = spread <= _NEARLY_FLAT * mean[k] and _is_constant(small[image], row, column, half)
                z = np.float32(0) if flat or np.isnan(z) else min(max(z, np.float32(-1)), np.float32(1))
                levels[image, row * width + column] = np.uint8(np.float32(255) * (np.float32(1) + z) / np.float32(2))
