"""A bank of 32 small Gabor filters over patch-normalised frames: local waves of both signs, by cell."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from functools import cache
from typing import Self

import numpy as np
import numpy.typing as npt
import torch
from torch.nn import functional

from vprbench.api.images import Images
from vprbench.api.preprocess import Engine, PatchNormalisation
from vprbench.errors import BadInput

SIZE = 5  # pixels, of a filter
POOL = 2  # pixels, of a cell
_ORIENTATIONS = tuple(np.pi / 4 * step for step in range(4))
_WAVELENGTHS = (2.0, 3.0)  # pixels
_PHASES = (0.0, np.pi / 2)
_ENVELOPES = (1.0, 2.0)  # pixels, standard deviations across the wave
_ASPECT = 0.5  # of that along the wave
_MEAN_LEVEL = 127  # of a patch-normalised frame

Maps = npt.NDArray[np.float32]  # (n_images, rows * columns, 32)


@cache
def gabor_filters() -> npt.NDArray[np.float32]:
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
    """The strongest response of each of 32 Gabor filters in every 2x2 pixels of a patch-normalised frame.

    `thresholds` (32,) are subtracted from the responses; None: 0. Source: lrp-666/VPRTempo (30635ee), `B5`.
    Raises BadInput for frames in which no cell fits, and for another number of thresholds.
    """

    height: int = 32  # pixels
    width: int = 64
    patch: int = 11
    thresholds: tuple[float, ...] | None = None
    engine: Engine = "fused"

    def __post_init__(self) -> None:
        """Check the sizes."""
        if min(self.rows, self.columns) < 1:
            least = SIZE + POOL - 1
            raise BadInput(f"method.height={self.height}, method.width={self.width}: give at least {least} pixels each")
        if self.thresholds is not None and len(self.thresholds) != len(gabor_filters()):
            raise BadInput(f"{len(self.thresholds)} thresholds came for {len(gabor_filters())} filters: give one each")

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
        return self.rows * self.columns * len(gabor_filters())

    def __call__(self, images: Images) -> npt.NDArray[np.float32]:
        """Return (n_images, rows * columns * 32) in 0..1, filter by filter at each cell; 0: below the threshold."""
        thresholds = np.float32(0 if self.thresholds is None else self.thresholds)
        return (2 * (self.responses(images) - thresholds)).clip(0, 1).reshape(len(images), -1)

    def responses(self, images: Images) -> Maps:
        """Return the strongest responses, (n_images, rows * columns, 32), -0.5 to 0.5, without thresholds."""
        levels = PatchNormalisation("C", self.height, self.width, self.patch, self.engine)(images)
        frames = torch.from_numpy(levels.astype(np.float32) - _MEAN_LEVEL).reshape(-1, 1, self.height, self.width)
        waves = functional.conv2d(frames / 255, torch.from_numpy(gabor_filters())[:, None])
        return functional.max_pool2d(waves, POOL).permute(0, 2, 3, 1).flatten(1, 2).contiguous().numpy()

    def adapted(self, images: Images, rate_min: float = 0.2, rate_max: float = 0.9) -> Self:
        """Return this bank with the thresholds at which each filter is active in its share of these images' cells.

        The shares run evenly from `rate_min` to `rate_max`: where intrinsic threshold plasticity comes to rest.
        """
        responses = self.responses(images).reshape(-1, len(gabor_filters()))
        rates = np.linspace(rate_min, rate_max, len(gabor_filters()))
        thresholds = [float(np.quantile(own, 1 - rate)) for own, rate in zip(responses.T, rates, strict=True)]
        return replace(self, thresholds=tuple(thresholds))
