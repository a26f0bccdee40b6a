"""Grey, gamma, resize and patch normalisation: the input of VPRTempo, VPRSNN and SAD in three published variants."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
import numpy.typing as npt
import torch
from torch.nn import functional

from vprbench.images import Images
from vprbench.interface import BadInput, Image

Variant = Literal["A", "B", "C"]

_BLOCK = 64  # images whose windows are unfolded together


@dataclass(frozen=True)
class PatchNormalisation:
    """The preprocessing of one variant, to grey levels 0..255.

    A: VPRSNN (d38f30c): resize in colour, grey, no gamma, population standard deviation.
    B: VPRTempo v1.0.0 (a3b07b2): grey and gamma as uint8, resize, population standard deviation.
    C: VPRTempo 64154e5: grey and gamma in float32, resize, unbiased standard deviation.
    No variant resizes with antialiasing. Raises BadInput for an even `patch` (pixels), which has no centre.
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
        ddof = 1 if self.variant == "C" else 0
        levels = np.empty((len(images), self.height * self.width), np.uint8)
        small = np.empty((min(len(images), _BLOCK), self.height, self.width), np.float32)
        for number, image in enumerate(images):
            small[number % _BLOCK] = self.shrink(image)
            if number % _BLOCK == _BLOCK - 1 or number == len(images) - 1:
                start = number - number % _BLOCK
                levels[start : number + 1] = patch_normalise(small[: number + 1 - start], self.patch, ddof)
        return levels

    def shrink(self, image: Image) -> npt.NDArray[np.float32]:
        """Return the grey, gamma-corrected image as (height, width), levels 0..255."""
        size = (self.width, self.height)
        if self.variant == "A":
            small = cv2.resize(image, size, interpolation=cv2.INTER_LINEAR)
            return cv2.cvtColor(small, cv2.COLOR_RGB2GRAY).astype(np.float32)
        if self.variant == "B":
            grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
            levels = gamma_correct(grey.astype(np.float32)).astype(np.uint8)
            return cv2.resize(levels, size, interpolation=cv2.INTER_LINEAR).astype(np.float32)
        red, green, blue = (image[:, :, c].astype(np.float32) for c in range(3))
        weighted = np.float32(0.299) * red + np.float32(0.587) * green + np.float32(0.114) * blue
        corrected = gamma_correct(weighted)
        if corrected.min() == corrected.max():  # the weights of the resize would leave rounding noise
            return np.full((self.height, self.width), corrected[0, 0])
        pixels = torch.from_numpy(corrected)[None, None]
        resized = functional.interpolate(pixels, (self.height, self.width), mode="bilinear", align_corners=False)
        return np.asarray(resized[0, 0], dtype=np.float32)


def gamma_correct(grey: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Map the mean of a grey image (height, width), levels 0..255, to 127.5 and clip to 0..255.

    The exponent is ln(0.5 * 255) / ln(mean) (VPRTempo 64154e5). An image whose mean is at most 1, where that
    has no finite positive value, is returned unchanged: a black frame stays black.
    """
    mean = grey.mean()
    if mean <= 1:
        return grey
    with np.errstate(over="ignore"):  # a nearly black image has a huge exponent; what overflows is clipped
        return np.clip(np.power(grey, np.float32(np.log(127.5) / np.log(mean))), 0, 255)


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
