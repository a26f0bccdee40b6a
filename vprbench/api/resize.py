"""Resizing of images, each way under its name, because a descriptor changes with the way."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import cv2
import numpy as np
import numpy.typing as npt
from PIL import Image as PillowImage
from torch import Tensor
from torch.nn import functional

from vprbench.api.arrays import Image

Resize = Literal["pillow", "tensor", "opencv", "area"]
Interpolation = Literal["bilinear", "bicubic"]
Preprocessing = Literal["authors", "vpr_methods_evaluation"]

_PILLOW = {"bilinear": PillowImage.Resampling.BILINEAR, "bicubic": PillowImage.Resampling.BICUBIC}
_OPENCV = {"bilinear": cv2.INTER_LINEAR, "bicubic": cv2.INTER_CUBIC}


@dataclass(frozen=True)
class Way:
    """How an image gets the size that a network wants."""

    resize: Resize
    interpolation: Interpolation
    crops: bool = False  # to the multiple that the network wants, from the middle; otherwise resized to it


#: gmberton/VPR-methods-evaluation adbb6e2: tensors after their normalisation, by torchvision's default.
VPR_METHODS_EVALUATION = Way("tensor", "bilinear")


def resize_image(
    image: Image, height: int, width: int, how: Literal["pillow", "opencv", "area"], kind: Interpolation
) -> npt.NDArray[Any]:
    """Resize a decoded image, uint8 (h, w, 3), to (height, width, 3).

    pillow: antialiased, as torchvision resizes a Pillow image, whole levels; opencv: not antialiased, whole levels;
    area: means over areas, or bilinear if a side grows, as float32 levels that are not rounded
    (cvg/Hierarchical-Localization c13273b); it has no other `kind`.
    """
    if image.shape[:2] == (height, width):
        return image
    if how == "area":
        grows = height > image.shape[0] or width > image.shape[1]
        way = cv2.INTER_LINEAR if grows else cv2.INTER_AREA
        return cv2.resize(image.astype(np.float32), (width, height), interpolation=way)
    if how == "opencv":
        return np.asarray(cv2.resize(image, (width, height), interpolation=_OPENCV[kind]), np.uint8)
    return np.asarray(PillowImage.fromarray(image).resize((width, height), _PILLOW[kind]))


def resize_batch(batch: Tensor, height: int, width: int, kind: Interpolation) -> Tensor:
    """Resize float images (n, channels, h, w) to (n, channels, height, width), antialiased, as torchvision does."""
    if batch.shape[-2:] == (height, width):
        return batch
    return functional.interpolate(batch, (height, width), mode=kind, align_corners=False, antialias=True)


def centre_crop(batch: Tensor, multiple: int) -> Tensor:
    """Return the middle of images (n, channels, h, w) whose sides are multiples, as torchvision's CenterCrop."""
    height, width = batch.shape[-2:]
    rows, columns = (side // multiple * multiple for side in (height, width))
    top, left = round((height - rows) / 2), round((width - columns) / 2)  # halves go to the even number
    return batch[..., top : top + rows, left : left + columns]
