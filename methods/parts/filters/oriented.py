"""Oriented edges of frames, normalised by their neighbourhood: an input of spiking networks beside patches."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import types

from vprbench.api import BadInput, Image, Images, compiled, count_operations, encode_blocks


@dataclass(frozen=True)
class OrientedEdges:
    """How strong edges of each orientation are in every cell of a frame, 0 to 1.

    A frame becomes grey, then `height` x `width` pixels by means over areas. Central differences, borders
    replicated, give each pixel a magnitude, which it shares between the two nearest of `orientations` bins of half a
    turn. Each bin is averaged over the pixels of a cell, `rows` x `columns` of them, and divided by the root of the
    cells' energy, averaged over `block` x `block` cells (borders reflected), plus `epsilon` grey levels, and raised to
    `power`: below 1 weak edges count for more. A frame of one level gives zeros. As histograms of oriented gradients
    (Dalal and Triggs 2005), but with energies of blocks around each cell and without gamma.
    All threads that PyTorch may use share the frames. Raises BadInput for sizes under which there is no code.
    """

    height: int = 32  # pixels
    width: int = 64
    rows: int = 8  # cells
    columns: int = 16
    orientations: int = 8
    block: int = 3  # cells
    epsilon: float = 16.0  # grey levels
    power: float = 1.0

    def __post_init__(self) -> None:
        """Check the sizes."""
        for name, least in {"height": 1, "width": 1, "rows": 1, "columns": 1, "orientations": 2, "block": 1}.items():
            if getattr(self, name) < least:
                raise BadInput(f"method.{name}={getattr(self, name)}: give at least {least}")
        if self.block % 2 == 0:
            raise BadInput(f"method.block={self.block}: a block needs a cell in its centre, give an odd number")
        if not 0 < self.epsilon < math.inf:
            raise BadInput(f"method.epsilon={self.epsilon}: give grey levels, more than 0")
        if not 0 < self.power < math.inf:
            raise BadInput(f"method.contrast_power={self.power}: give a finite power, more than 0")

    @property
    def n_inputs(self) -> int:
        """The length of a code."""
        return self.rows * self.columns * self.orientations

    def __call__(self, images: Images) -> npt.NDArray[np.float32]:
        """Return (n_images, rows * columns * orientations): the orientations of a cell side by side."""
        codes = np.empty((len(images), self.n_inputs), np.float32)
        encode_blocks(images, codes, self._write)
        return codes

    def _write(self, images: Sequence[Image], codes: npt.NDArray[np.float32]) -> None:
        cells = codes.reshape(-1, self.rows, self.columns, self.orientations)
        small, n_cells = len(images) * self.height * self.width, len(images) * self.rows * self.columns
        # Grey and means of the frame; differences, length, angle and votes of a small pixel; energies and divisions.
        count_operations(
            4 * sum(image.size // 3 for image in images) + 6 * small + codes.size, 10 * small + 3 * codes.size
        )
        count_operations(single=n_cells * (self.block**2 + 2))
        for image, code in zip(images, cells, strict=True):
            pixels = np.ascontiguousarray(image)
            _encode(pixels, self.height, self.width, self.block, self.epsilon, code)
            if self.power == 0.75:  # two roots take less time than a power
                np.sqrt(code, out=code)
                code *= np.sqrt(code)
            elif self.power != 1:
                np.power(code, np.float32(self.power), out=code)


_IMAGE = types.Array(types.uint8, 3, "C", readonly=True)
_EIGHTH = np.float32(np.tan(np.pi / 8))
_RED, _GREEN, _BLUE = 299, 587, 114  # thousandths of a grey level
# Sums may be reordered; there are no infinities whose sign counts.
_loop = compiled(fastmath={"reassoc", "contract", "arcp", "nsz"})


@_loop
def _share_areas(parts, size):  # type: ignore[no-untyped-def]
    """Return the first of `size` pixels in each of equal parts, (parts,), and how much of each lies in the part.

    The shares are (parts, most pixels of a part), the last ones 0 where a part has fewer; a whole pixel is `parts`.
    """
    first = np.arange(parts) * size // parts
    most = np.max((np.arange(1, parts + 1) * size + parts - 1) // parts - first)
    shares = np.zeros((parts, most))
    for part in range(parts):
        for k in range(most):
            pixel = (first[part] + k) * parts
            shares[part, k] = max(0, min((part + 1) * size, pixel + parts) - max(part * size, pixel))
    return first, shares


@_loop
def _shrink_image(image, grey):  # type: ignore[no-untyped-def]
    """Write thousandths of grey levels, (height, width), summed over areas of `image` (h, w, 3): whole numbers."""
    h, w, _ = image.shape
    height, width = grey.shape
    pixels = image.reshape(h, 3 * w)
    top, down = _share_areas(height, h)
    left, across = _share_areas(width, w)
    weights = np.empty((width, across.shape[1], 3))
    weights[:, :, 0], weights[:, :, 1], weights[:, :, 2] = _RED * across, _GREEN * across, _BLUE * across
    flat_weights = weights.reshape(width, -1)
    whole = np.empty(3 * w, np.int32)  # sums over the pixels that lie wholly in a row
    column = np.zeros(3 * (w + across.shape[1]))
    for row in range(height):
        first, last = top[row], -(-(row + 1) * h // height) - 1
        whole[:] = 0
        y = first + 1
        while y + 4 <= last:  # four rows in one pass over the sums
            a, b, c, d = pixels[y], pixels[y + 1], pixels[y + 2], pixels[y + 3]
            for k in range(3 * w):
                whole[k] += np.int32(a[k]) + np.int32(b[k]) + np.int32(c[k]) + np.int32(d[k])
            y += 4
        for z in range(y, last):
            a = pixels[z]
            for k in range(3 * w):
                whole[k] += np.int32(a[k])
        a, b = pixels[first], pixels[last]
        share, other = down[row, 0], down[row, last - first] * (last > first)
        for k in range(3 * w):
            column[k] = height * np.float64(whole[k]) + share * np.float64(a[k]) + other * np.float64(b[k])
        for x in range(width):
            own, levels = flat_weights[x], column[3 * left[x] :]
            total = 0.0
            for k in range(len(own)):
                total += own[k] * levels[k]
            grey[row, x] = total


@_loop
def _split_votes(across, down, bins, votes, first):  # type: ignore[no-untyped-def]
    """Write which bin of half a turn lies below the orientation of each slope, (n,), and the votes (2, n) of two.

    The bin below the first is -1. The arctangent is the polynomial of Moshier's Cephes for float32, which a processor
    computes for many at once.
    """
    for x in range(len(across)):
        a, b = abs(across[x]), abs(down[x])
        most, least = max(a, b), min(a, b)
        ratio = least / max(most, np.float32(1e-30))
        steep = ratio > _EIGHTH
        z = (ratio - np.float32(1)) / (ratio + np.float32(1)) if steep else ratio
        s = z * z
        series = (np.float32(8.05374449538e-2) * s - np.float32(1.38776856032e-1)) * s + np.float32(1.99777106478e-1)
        angle = (series * s - np.float32(3.33329491539e-1)) * s * z + z
        angle = angle + np.float32(np.pi / 4) if steep else angle
        angle = np.float32(np.pi / 2) - angle if b > a else angle
        angle = np.float32(np.pi) - angle if across[x] * down[x] < 0 else angle
        magnitude = np.sqrt(a * a + b * b)
        position = angle * np.float32(bins / np.pi) - np.float32(0.5)
        below = np.floor(position)
        votes[1, x] = (position - below) * magnitude
        votes[0, x] = magnitude - votes[1, x]
        first[x] = np.int32(below)


@_loop
def _add_votes(grey, scale, cells):  # type: ignore[no-untyped-def]
    """Write the mean votes of `grey` (height, width), times `scale` grey levels, to (rows, columns, orientations)."""
    height, width = grey.shape
    rows, columns, bins = cells.shape
    across, down = np.empty(width, np.float32), np.empty(width, np.float32)
    votes, first = np.empty((2, width), np.float32), np.empty(width, np.int32)
    top, row_shares = _share_areas(rows, height)
    left, column_shares = _share_areas(columns, width)
    cells[:] = 0
    for row in range(rows):
        for j in range(row_shares.shape[1]):
            if row_shares[row, j] == 0:
                continue
            y = top[row] + j
            above, here, below = grey[max(y - 1, 0)], grey[y], grey[min(y + 1, height - 1)]
            for x in range(width):
                down[x] = np.float32((below[x] - above[x]) * scale)
            for x in range(1, width - 1):
                across[x] = np.float32((here[x + 1] - here[x - 1]) * scale)
            across[0] = np.float32((here[min(1, width - 1)] - here[0]) * scale)
            across[width - 1] = np.float32((here[width - 1] - here[max(width - 2, 0)]) * scale)
            _split_votes(across, down, bins, votes, first)
            for column in range(columns):
                own = cells[row, column]
                for k in range(column_shares.shape[1]):
                    share = np.float32(row_shares[row, j] * column_shares[column, k] / (height * width))
                    if share > 0:
                        x = left[column] + k
                        bin = first[x]
                        own[bin if bin >= 0 else bins - 1] += share * votes[0, x]
                        own[bin + 1 if bin + 1 < bins else 0] += share * votes[1, x]


@_loop
def _reflect_indices(size, half):  # type: ignore[no-untyped-def]
    """Return the indices of `size` values and of `half` more on both sides; the border itself is repeated."""
    indices = np.empty(size + 2 * half, np.int64)
    for k in range(len(indices)):
        index = (k - half) % (2 * size)
        indices[k] = min(index, 2 * size - 1 - index)
    return indices


@compiled(_IMAGE, types.int64, types.int64, types.int64, types.float64, types.float32[:, :, ::1])
def _encode(image, height, width, block, epsilon, code):  # type: ignore[no-untyped-def]
    """Write the code (rows, columns, orientations) of `image` (h, w, 3), brought to `height` x `width` pixels."""
    rows, columns, bins = code.shape
    grey = np.empty((height, width))
    _shrink_image(image, grey)
    _add_votes(grey, 1.0 / ((_RED + _GREEN + _BLUE) * image.shape[0] * image.shape[1]), code)
    energy = np.zeros((rows, columns), np.float32)
    for row in range(rows):
        for column in range(columns):
            for bin in range(bins):
                energy[row, column] += code[row, column, bin] * code[row, column, bin]
    down, across = _reflect_indices(rows, block // 2), _reflect_indices(columns, block // 2)
    for row in range(rows):
        for column in range(columns):
            total = np.float32(0)
            for y in down[row : row + block]:
                for x in across[column : column + block]:
                    total += energy[y, x]
            spread = np.sqrt(total / np.float32(block * block)) + np.float32(epsilon)
            for bin in range(bins):
                code[row, column, bin] = min(code[row, column, bin] / spread, np.float32(1))
