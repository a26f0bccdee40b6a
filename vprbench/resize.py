"""Resizing of images, each way under its name, because a descriptor changes with the way."""

from __future__ import annotations

from typing import Literal

import cv2
import numpy as np
from PIL import Image as PillowImage
from torch import Tensor
from torch.nn import functional

from vprbench.interface import Image

Resize = Literal["pillow", "tensor", "opencv"]
Interpolation = Literal["bilinear", "bicubic"]

_PILLOW = {"bilinear": PillowImage.Resampling.BILINEAR, "bicubic": PillowImage.Resampling.BICUBIC}
_OPENCV = {"bilinear": cv2.INTER_LINEAR, "bicubic": cv2.INTER_CUBIC}


def resize_image(image: Image, height: int, width: int, how: Literal["pillow", "opencv"], kind: Interpolation) -> Image:
    """Resize a decoded image, uint8 (h, w, 3), to (height, width, 3); levels are rounded.

    pillow: antialiased, as torchvision resizes a Pillow image; opencv: not antialiased.
    """
    if image.shape[:2] == (height, width):
        return image
    if how == "opencv":
        return np.asarray(cv2.resize(image, (width, height), interpolation=_OPENCV[kind]), np.uint8)
    return np.asarray(PillowImage.fromarray(image).resize((width, height), _PILLOW[kind]))


def resize_batch(batch: Tensor, height: int, width: int, kind: Interpolation, antialias: bool = True) -> Tensor:
    """Resize float images (n, channels, h, w) to (n, channels, height, width), as torchvision resizes a tensor."""
    if batch.shape[-2:] == (height, width):
        return batch
    return functional.interpolate(batch, (height, width), mode=kind, align_corners=False, antialias=antialias)
