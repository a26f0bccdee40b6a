"""A float64 VPRTempo preprocessing by windows that judges the fast implementation, after QVPR/VPRTempo 64154e5."""

import math

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view


def grey_c(image):
    """Return unrounded grey levels (height, width) of RGB (height, width, 3)."""
    red, green, blue = np.moveaxis(image.astype(np.float64), 2, 0)
    return 0.299 * red + 0.587 * green + 0.114 * blue


def grey_b(image):
    """Return grey (height, width) rounded half up, as v1.0.0 a3b07b2 but for fixed-point near-ties."""
    return np.floor(grey_c(image) + 0.5)


def gamma_c(grey):
    """Return grey (height, width) with its mean level mapped to 127.5; a mean of at most 1 changes nothing."""
    mean = math.fsum(grey.flat) / grey.size
    if mean <= 1.0:
        return np.array(grey, dtype=np.float64)
    exponent = math.log(0.5 * 255.0) / math.log(mean)
    saturated = 255.0 ** (1.0 / exponent)  # every level from here on ends at 255
    return np.where(grey >= saturated, 255.0, np.minimum(grey, saturated) ** exponent)


def gamma_b(grey):
    """Return the corrected grey (height, width) truncated to whole levels, v1.0.0 a3b07b2."""
    return np.floor(gamma_c(grey))


def taps(n_source, n_target):
    """Return the two source indices under each target pixel's centre and the second one's weight."""
    position = np.clip((np.arange(n_target) + 0.5) * n_source / n_target - 0.5, 0.0, n_source - 1)
    first = position.astype(np.intp)
    return first, np.minimum(first + 1, n_source - 1), position - first


def resize_bilinear(grey, height, width):
    """Return (height, width), bilinear, half-pixel centres, no antialiasing."""
    (top, bottom, down), (left, right, along) = taps(grey.shape[0], height), taps(grey.shape[1], width)
    across = (1.0 - along) * grey[:, left] + along * grey[:, right]
    return (1.0 - down[:, None]) * across[top] + down[:, None] * across[bottom]


def moments(grey, patch, ddof):
    """Return mean and deviation of the odd patch by patch window around each pixel, cut at the border."""
    windows = sliding_window_view(np.pad(grey, patch // 2, constant_values=np.nan), (patch, patch))
    n = np.isfinite(windows).sum((2, 3))
    mean = np.nanmean(windows, (2, 3))
    squares = np.nansum((windows - mean[:, :, None, None]) ** 2, (2, 3))
    flat = np.nanmax(windows, (2, 3)) == np.nanmin(windows, (2, 3))
    return mean, np.where(flat, 0.0, np.sqrt(squares / np.maximum(n - ddof, 1)))


def local_std(grey, patch, ddof):
    """Return each window's deviation (height, width), the divisor of both public codes' z score; 0 where it is flat."""
    return moments(grey, patch, ddof)[1]


def patch_normalise(grey, patch, ddof):
    """Return levels 0..255 (height, width); ddof 1 as QVPR/VPRTempo 64154e5, 0 as v1.0.0 a3b07b2."""
    mean, deviation = moments(grey, patch, ddof)
    z = np.divide(grey - mean, deviation, out=np.zeros(grey.shape), where=deviation > 0)  # of a flat window 0
    return np.floor(255.0 * (1.0 + z.clip(-1.0, 1.0)) / 2.0).astype(np.uint8)
