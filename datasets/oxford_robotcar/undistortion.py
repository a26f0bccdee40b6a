"""The compiled loop that undistorts a frame: exactly bilinear, where OpenCV's remap is up to 7 levels off."""

from __future__ import annotations

import numpy as np
from numba import types

from vprbench.api import compiled

_ROUNDING = 1e-4  # levels that the weights' rounding may take off a whole number before its decimals are cut off


@compiled(
    types.Array(types.uint16, 2, "C", readonly=True),
    types.int64,
    types.Array(types.int32, 1, "C", readonly=True),
    types.Array(types.float32, 1, "C", readonly=True),
    types.Array(types.float32, 1, "C", readonly=True),
    types.float64,
    types.uint8[:, ::1],
)
def undistort(levels, width, source, right, down, scale, image):  # type: ignore[no-untyped-def]
    """Fill `image` (n, 3) with `scale` times `levels` (m, 3) between `source` and its neighbours right and below it.

    `source`, `right` and `down` (n,) are those of a calibration; rows of the frame are `width` pixels long.
    """
    for pixel in range(len(source)):
        first = source[pixel]
        if first < 0:
            image[pixel] = 0
            continue
        x, y = np.float64(right[pixel]), np.float64(down[pixel])
        for channel in range(3):
            above = levels[first, channel] * (1 - x) + levels[first + 1, channel] * x
            below = levels[first + width, channel] * (1 - x) + levels[first + width + 1, channel] * x
            image[pixel, channel] = np.uint8((above * (1 - y) + below * y) * scale + _ROUNDING)
