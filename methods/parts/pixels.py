"""Frames as pixels that are compared one by one: grey and small, patch-normalised or not."""

from __future__ import annotations

from typing import Literal

import cv2
import numpy as np
import numpy.typing as npt

from vprbench.api import BadInput, Images

from .filters.patches import PatchNormalisation

MEAN_LEVEL = 127  # of a patch-normalised pixel: its window's mean

Preprocessing = Literal["grey", "A", "B", "C"]  # grey: antialiased, not patch-normalised


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
