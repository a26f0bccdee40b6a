"""Grey, gamma, resize and patch normalisation: the input of VPRTempo, VPRSNN and SAD in three published variants."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
import numpy.typing as npt

from vprbench.api import BadInput, Image, Images, count_operations, encode_blocks

from . import patches_compiled

Variant = Literal["A", "B", "C"]

_LEVELS = np.arange(256, dtype=np.float32)

_SMALL_BYTES = 1 << 16


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
            levels = cv2.LUT(grey, _power(_LEVELS.copy(), grey.mean()).astype(np.uint8))
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
        patches_compiled.normalise_patches(small, self.patch, self._ddof, levels)

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
            patches_compiled.take_taps(images, taps[own], means[own])
        _power(taps, means[:, None, None, None, None])
        patches_compiled.blend_taps(taps, np.array([image.shape[:2] for image in block]), small)

    @property
    def _ddof(self) -> int:
        """Return the number that is subtracted from the count of a window's pixels in its variance."""
        return 1 if self.variant == "C" else 0


def _power(grey: npt.NDArray[np.float32], mean: npt.NDArray[np.float64] | np.float64) -> npt.NDArray[np.float32]:
    """Map the mean of grey images, levels 0..255, to 127.5 and clip to 0..255, in place; `mean` is one or one an image.

    The exponent is ln(0.5 * 255) / ln(mean) (VPRTempo 64154e5). An image whose mean is at most 1, where the exponent
    has no finite positive value, is left unchanged: a black frame stays black.
    """
    exponent = np.where(mean > 1, np.log(127.5) / np.log(np.maximum(mean, 1 + 1e-9)), 1)
    with np.errstate(over="ignore"):  # a nearly black image has a huge exponent; what overflows is clipped
        np.power(grey, exponent.astype(np.float32), out=grey)
    return np.clip(grey, 0, 255, out=grey)
