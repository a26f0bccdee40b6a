"""Grey, gamma, resize and patch normalisation: the input of VPRTempo, VPRSNN and SAD in three published variants."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
import numpy.typing as npt
import torch
from torch.nn import functional

from vprbench.api import preprocess_compiled
from vprbench.api.arithmetic import takes
from vprbench.api.arrays import Image
from vprbench.api.images import Images
from vprbench.api.threads import encode_blocks
from vprbench.errors import BadInput

Variant = Literal["A", "B", "C"]
Engine = Literal["fused", "readable"]

_LEVELS = np.arange(256, dtype=np.float32)

_SMALL_BYTES = 1 << 16


@dataclass(frozen=True)
class PatchNormalisation:
    """The preprocessing of one variant, to grey levels 0..255.

    A: VPRSNN (d38f30c): resize in colour, grey, no gamma, population standard deviation.
    B: VPRTempo v1.0.0 (a3b07b2): grey and gamma as uint8, resize, population standard deviation.
    C: VPRTempo 64154e5: grey and gamma in float32, resize, unbiased standard deviation.
    No variant resizes with antialiasing. The fused engine is compiled and takes all threads that PyTorch may use;
    the readable one is what it is judged by. Raises BadInput for an even `patch` (pixels), which has no centre.
    """

    variant: Variant = "C"
    height: int = 28
    width: int = 28
    patch: int = 7
    engine: Engine = "fused"

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
        takes(levels.size * (4 * 3 + 4 + window), levels.size * (4 * 3 + 2 * window + 7))
        normalise = self._fused if self.engine == "fused" else self._readable
        encode_blocks(images, levels, normalise, self.engine == "fused")
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
        red, green, blue = (image[:, :, c].astype(np.float32) for c in range(3))
        weighted = np.float32(0.299) * red + np.float32(0.587) * green + np.float32(0.114) * blue
        sums = image.sum((0, 1), dtype=np.int64)
        mean = (0.299 * sums[0] + 0.587 * sums[1] + 0.114 * sums[2]) / weighted.size
        corrected = _power(weighted, mean)
        if corrected.min() == corrected.max():  # the weights of the resize would leave rounding noise
            return np.full((self.height, self.width), corrected[0, 0])
        pixels = torch.from_numpy(corrected)[None, None]
        resized = functional.interpolate(pixels, (self.height, self.width), mode="bilinear", align_corners=False)
        return np.asarray(resized[0, 0], dtype=np.float32)

    def _readable(self, block: Sequence[Image], levels: npt.NDArray[np.uint8]) -> None:
        small = np.stack([self.shrink(image) for image in block])
        levels[:] = patch_normalise(small, self.patch, self._ddof)

    def _fused(self, block: Sequence[Image], levels: npt.NDArray[np.uint8]) -> None:
        small = np.empty((len(block), self.height, self.width), np.float32)
        if self.variant == "C":
            self._shrink_fused(block, small)
        else:
            for number, image in enumerate(block):
                small[number] = self.shrink(image)
        preprocess_compiled.normalise_patches(small, self.patch, self._ddof, levels)

    def _shrink_fused(self, block: Sequence[Image], small: npt.NDArray[np.float32]) -> None:
        """Do what `shrink` does for variant C, but correct only those pixels that the resize reads."""
        taps = np.empty((len(block), 2, 2, self.height, self.width), np.float32)
        means = np.empty(len(block))
        alike = len({image.shape for image in block}) == 1
        # Small images are copied side by side: calls from several threads would wait for one another.
        step = len(block) if alike and block[0].nbytes <= _SMALL_BYTES else 1
        for first in range(0, len(block), step):
            own = slice(first, first + step)
            images = np.stack(block) if step > 1 else np.ascontiguousarray(block[first])[None]
            preprocess_compiled.take_taps(images, taps[own], means[own])
        _power(taps, means[:, None, None, None, None])
        preprocess_compiled.blend_taps(taps, np.array([image.shape[:2] for image in block]), small)

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


def patch_normalise(grey: npt.NDArray[np.float32], patch: int, ddof: int) -> npt.NDArray[np.uint8]:
    """Compare each pixel with its window: (n, height, width) -> (n, height * width), 127 at the window's mean.

    The window of `patch` x `patch` pixels is cut at the border; (pixel - mean) / standard deviation is clipped
    to -1..1 and truncated onto 0..255 (VPRTempo 64154e5 with ddof 1, v1.0.0 with ddof 0).
    """
    n, height, width = grey.shape
    pixels = torch.from_numpy(grey).reshape(n, 1, height, width)
    inside = functional.unfold(torch.ones(1, 1, height, width), patch, padding=patch // 2)  # (1, patch**2, h*w)
    windows = functional.unfold(pixels, patch, padding=patch // 2)  # (n, patch**2, h*w), 0 outside
    centre = pixels.reshape(n, -1)
    count = inside.sum(1)  # (1, h*w)
    # float32 and this order of operations are the public code's: where a window is flat but for rounding
    # noise, the noise decides the level, and on real frames with saturated sky another order changes R@5 by 0.7 %.
    mean = windows.sum(1) / count
    deviation = ((windows - mean[:, None]) * inside).square().sum(1)
    z = ((centre - mean) / (deviation / (count - ddof)).sqrt()).nan_to_num(nan=0.0).clamp(-1, 1)
    flat = ((windows == centre[:, None]) | (inside == 0)).all(1)  # no noise in an exactly constant window
    return (255 * (1 + z.masked_fill(flat, 0.0)) / 2).to(torch.uint8).numpy()
