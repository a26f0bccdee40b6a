"""Frames and grey levels as input spikes of VPRTempo."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from vprbench.api import Images

from ..parts.filters.patches import PatchNormalisation
from .layer import compiled

_SPREADS = 6.0  # of an image's values between the amplitudes 0 and 1


class Encoder(Protocol):
    """Makes input spikes of frames, float32 (n_images, n_inputs), amplitudes 0 to 1."""

    @property
    def n_inputs(self) -> int:
        """The number of inputs."""

    def __call__(self, images: Images) -> npt.NDArray[np.float32]:
        """Return the spikes of each frame."""


@dataclass(frozen=True)
class Patches:
    """The published input: a spike for every pixel of a patch-normalised frame."""

    levels: PatchNormalisation

    @property
    def n_inputs(self) -> int:
        """The number of pixels."""
        return self.levels.height * self.levels.width

    def __call__(self, images: Images) -> npt.NDArray[np.float32]:
        """Return the spikes of each frame."""
        return make_spikes(self.levels(images), fake_quantised=self.levels.variant == "C")


def scale_values(values: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Return values (n_images, n) as amplitudes 0 to 1: 0.5 is an image's mean, the ends are 3 spreads away.

    An image without spread gives 0.5 everywhere.
    """
    mean, spread = values.mean(1, keepdims=True), values.std(1, keepdims=True)
    deviations = (values - mean) / np.where(spread > 0, _SPREADS * spread, 1)
    return np.asarray(np.clip(0.5 + deviations, 0, 1), np.float32)


def make_spikes(levels: npt.NDArray[np.uint8], fake_quantised: bool) -> npt.NDArray[np.float32]:
    """Return amplitudes 0 to 1 of levels 0 to 255, both (n_images, n_pixels).

    `fake_quantised` adds the public code's 8-bit step (64154e5): a grid of 256 levels up to the image's maximum.
    """
    spikes = np.empty(levels.shape, np.float32)
    _write_spikes(levels, fake_quantised, spikes)
    return spikes


@compiled
def _write_spikes(levels, fake_quantised, spikes):  # type: ignore[no-untyped-def]
    for image in range(len(levels)):
        most = np.float32(0)
        for i in range(levels.shape[1]):
            spikes[image, i] = np.float32(levels[image, i]) / np.float32(255)
            most = max(most, spikes[image, i])
        if fake_quantised:
            scale = max(most, np.float32(1) / np.float32(255)) / np.float32(255)
            for i in range(levels.shape[1]):
                spikes[image, i] = np.rint(spikes[image, i] / scale) * scale
