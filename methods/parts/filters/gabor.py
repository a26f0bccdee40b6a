"""A bank of 32 small Gabor filters over patch-normalised frames: local waves, cell by cell."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from functools import cache

import numpy as np
import numpy.typing as npt
import torch
from numba import types

from vprbench.api import BadInput, Images, compiled, count_operations, in_shares

from .patches import PatchNormalisation

SIZE = 5  # pixels, of a filter
POOL = 2  # pixels, of a cell
_ORIENTATIONS = tuple(np.pi / 4 * step for step in range(4))
_WAVELENGTHS = (2.25, 3.0)  # pixels; at 2 whole pixels see nothing of a sine
_PHASES = (0.0, np.pi / 2)
_ENVELOPES = (1.0, 2.0)  # pixels, standard deviations across the wave
_ASPECT = 0.5  # of that along the wave
N_FILTERS = 32
_MEAN_LEVEL = 127  # of a patch-normalised frame
_GAIN = 4  # times a response over its block's; most of the range 0..1 is used

Maps = npt.NDArray[np.float32]  # (n_images, rows * columns, 32)


@cache
def draw_gabor_filters() -> npt.NDArray[np.float32]:
    """Return the bank, (32, 5, 5): 4 orientations x 2 wavelengths x 2 phases x 2 envelopes, zero mean, L1 norm 1."""
    y, x = np.mgrid[:SIZE, :SIZE] - SIZE // 2
    bank = []
    for angle, wavelength, phase, width in itertools.product(_ORIENTATIONS, _WAVELENGTHS, _PHASES, _ENVELOPES):
        across, along = x * np.cos(angle) + y * np.sin(angle), y * np.cos(angle) - x * np.sin(angle)
        envelope = np.exp(-(across**2 + (_ASPECT * along) ** 2) / (2 * width**2))
        wave = envelope * np.cos(2 * np.pi * across / wavelength + phase)
        wave -= wave.mean()
        bank.append(wave / np.abs(wave).sum())
    return np.array(bank, np.float32)


@dataclass(frozen=True)
class GaborBank:
    """How strongly each of 32 Gabor filters answers in every 2x2 pixels of a patch-normalised frame, 0 to 1.

    A frame is patch-normalised (variant C), filtered, and the strongest response of each filter in 2x2 pixels is kept,
    with its sign. A code is the positive part of it, divided by the root of the responses'
    energy, averaged over `block` x `block` cells (borders reflected), plus `epsilon`, times 4.
    All threads that PyTorch may use share the frames.
    Filters as in lrp-666/VPRTempo (30635ee), `B5`, but for its shorter wavelength of 2 pixels, under which a sine is
    rounding noise; the normalisation is this project's. Raises BadInput for sizes under which there is no code.
    """

    height: int = 32  # pixels
    width: int = 64
    patch: int = 11
    block: int = 5  # cells
    epsilon: float = 0.1  # in shares of the grey levels

    def __post_init__(self) -> None:
        """Check the sizes."""
        for name in ("height", "width"):
            if getattr(self, name) < SIZE + POOL - 1:
                raise BadInput(f"method.{name}={getattr(self, name)}: give at least {SIZE + POOL - 1} pixels")
        if self.block < 1 or self.block % 2 == 0:
            raise BadInput(f"method.block={self.block}: a block needs a cell in its centre, give an odd number")
        if not 0 < self.epsilon < math.inf:
            raise BadInput(f"method.epsilon={self.epsilon}: give more than 0")
        self._make_normalisation()

    @property
    def rows(self) -> int:
        """Rows of cells."""
        return (self.height - SIZE + 1) // POOL

    @property
    def columns(self) -> int:
        """Columns of cells."""
        return (self.width - SIZE + 1) // POOL

    @property
    def n_inputs(self) -> int:
        """The length of a code."""
        return self.rows * self.columns * N_FILTERS

    def __call__(self, images: Images) -> npt.NDArray[np.float32]:
        """Return (n_images, rows * columns * 32): the filters of a cell side by side."""
        maps = self.compute_responses(images)
        in_shares(lambda own: self._normalise(maps[own]), len(images), torch.get_num_threads())
        return maps.reshape(len(images), self.n_inputs)

    def compute_responses(self, images: Images) -> Maps:
        """Return the strongest responses, -0.5 to 0.5, neither normalised nor cut off at 0."""
        levels = self._make_normalisation()(images)
        maps = np.empty((len(images), self.rows * self.columns, N_FILTERS), np.float32)
        filtered = len(images) * (self.height - SIZE + 1) * (self.width - SIZE + 1) * N_FILTERS
        count_operations(
            SIZE**2 * filtered + maps.size, filtered + 4 * maps.size
        )  # the largest of four; energies, divisions
        in_shares(lambda own: self._filter_levels(levels[own], maps[own]), len(images), torch.get_num_threads())
        return maps

    def _make_normalisation(self) -> PatchNormalisation:
        return PatchNormalisation("C", self.height, self.width, self.patch)

    def _filter_levels(self, levels: npt.NDArray[np.uint8], maps: Maps) -> None:
        frames = levels.reshape(-1, self.height, self.width)
        _filter_frames(frames, _MEAN_LEVEL, _draw_taps(), maps.reshape(-1, self.rows, self.columns, N_FILTERS))

    def _normalise(self, maps: Maps) -> None:
        beside = [np.pad(np.arange(n), self.block // 2, mode="symmetric") for n in (self.rows, self.columns)]
        cells = maps.reshape(-1, self.rows, self.columns, N_FILTERS)
        _normalise_maps(cells, *beside, self.block, self.epsilon, _GAIN)


@cache
def _draw_taps() -> npt.NDArray[np.float32]:
    """Return the filters pixel by pixel, for grey levels 0..255: (5, 5, 32)."""
    return np.ascontiguousarray(draw_gabor_filters().transpose(1, 2, 0) / np.float32(255))


_FRAMES = types.Array(types.uint8, 3, "C", readonly=True)
_MAPS, _TAPS = types.float32[:, :, :, ::1], types.Array(types.float32, 3, "C", readonly=True)
_PLACES = types.int64[::1]


@compiled(_FRAMES, types.float32, _TAPS, _MAPS, fastmath={"contract"})
def _filter_frames(frames, mean_level, taps, maps):  # type: ignore[no-untyped-def]
    """Write the largest of the responses in 2x2 pixels of `frames` (n, h, w) to `maps` (n, rows, columns, n_filters).

    `taps` are (size, size, n_filters); nothing is filtered beyond the border.
    """
    n, rows, columns, n_filters = maps.shape
    size = len(taps)
    response = np.empty(n_filters, np.float32)
    for image in range(n):
        for row in range(rows):
            for column in range(columns):
                best = maps[image, row, column]
                best[:] = -np.inf
                for pixel in range(4):
                    top, left = 2 * row + pixel // 2, 2 * column + pixel % 2
                    response[:] = 0
                    for y in range(size):
                        for x in range(size):
                            level = np.float32(frames[image, top + y, left + x]) - mean_level
                            weights = taps[y, x]
                            for k in range(n_filters):
                                response[k] += level * weights[k]
                    for k in range(n_filters):
                        best[k] = max(best[k], response[k])


@compiled(_MAPS, _PLACES, _PLACES, types.int64, types.float32, types.float32)
def _normalise_maps(maps, beside_rows, beside_columns, block, epsilon, gain):  # type: ignore[no-untyped-def]
    """Make of responses (n, rows, columns, n_filters) codes 0..1, in place.

    The cells of a block around row i are rows `beside_rows`[i : i + block], and so with columns.
    """
    n, rows, columns, n_filters = maps.shape
    energy, along = np.empty((rows, columns), np.float32), np.empty((rows, columns), np.float32)
    for image in range(n):
        for row in range(rows):
            for column in range(columns):
                total = np.float32(0)
                for response in maps[image, row, column]:
                    total += response * response
                energy[row, column] = total
        for row in range(rows):
            for column in range(columns):
                total = np.float32(0)
                for k in range(block):
                    total += energy[row, beside_columns[column + k]]
                along[row, column] = total
        for row in range(rows):
            for column in range(columns):
                total = np.float32(0)
                for k in range(block):
                    total += along[beside_rows[row + k], column]
                scale = gain / (np.sqrt(total / np.float32(block * block)) + epsilon)
                code = maps[image, row, column]
                for k in range(n_filters):
                    code[k] = min(max(code[k] * scale, np.float32(0)), np.float32(1))
