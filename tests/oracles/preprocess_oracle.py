"""A pixel-by-pixel float64 VPRTempo preprocessing that judges the fast implementation."""

import math

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]


def grey_c(image: npt.NDArray[np.uint8]) -> Floats:
    """Return unrounded grey levels (height, width) of RGB (height, width, 3), QVPR/VPRTempo 64154e5."""
    height, width, _ = image.shape
    grey = np.zeros((height, width))
    for row in range(height):
        for column in range(width):
            red, green, blue = (float(value) for value in image[row, column])
            grey[row, column] = 0.299 * red + 0.587 * green + 0.114 * blue
    return grey


def grey_b(image: npt.NDArray[np.uint8]) -> Floats:
    """Return grey (height, width) rounded half up, as v1.0.0 a3b07b2 but for fixed-point near-ties."""
    return np.floor(grey_c(image) + 0.5)


def gamma_c(grey: Floats) -> Floats:
    """Return grey (height, width) with its mean level mapped to 127.5, QVPR/VPRTempo 64154e5.

    An image whose mean is at most 1 has no positive exponent and stays unchanged.
    """
    mean = math.fsum(float(value) for value in grey.flat) / grey.size
    if mean <= 1.0:
        return np.array(grey, dtype=np.float64)
    exponent = math.log(0.5 * 255.0) / math.log(mean)
    saturated = 255.0 ** (1.0 / exponent)  # every level from here on ends at 255
    corrected = np.zeros(grey.shape)
    for row in range(grey.shape[0]):
        for column in range(grey.shape[1]):
            level = float(grey[row, column])
            corrected[row, column] = 255.0 if level >= saturated else level**exponent
    return corrected


def gamma_b(grey: Floats) -> Floats:
    """Return the corrected grey (height, width) truncated to whole levels, v1.0.0 a3b07b2."""
    return np.floor(gamma_c(grey))


def resize_bilinear(grey: Floats, height: int, width: int) -> Floats:
    """Return (height, width), bilinear, half-pixel centres, no antialiasing, QVPR/VPRTempo 64154e5."""
    resized = np.zeros((height, width))
    for row in range(height):
        top, bottom, down = _neighbours(row, grey.shape[0], height)
        for column in range(width):
            left, right, along = _neighbours(column, grey.shape[1], width)
            above = (1.0 - along) * float(grey[top, left]) + along * float(grey[top, right])
            below = (1.0 - along) * float(grey[bottom, left]) + along * float(grey[bottom, right])
            resized[row, column] = (1.0 - down) * above + down * below
    return resized


def patch_z(grey: Floats, patch: int, ddof: int) -> Floats:
    """Return z scores (height, width) in [-1, 1]; ddof 1 as QVPR/VPRTempo 64154e5, 0 as v1.0.0 a3b07b2."""
    z = np.zeros(grey.shape)
    for row in range(grey.shape[0]):
        for column in range(grey.shape[1]):
            window = _window(grey, row, column, patch)
            if min(window) == max(window):
                continue  # 0 / 0 is NaN, and NaN becomes 0
            mean = math.fsum(window) / len(window)
            score = (float(grey[row, column]) - mean) / _std(window, ddof)
            z[row, column] = min(max(score, -1.0), 1.0)
    return z


def patch_normalise(grey: Floats, patch: int, ddof: int) -> npt.NDArray[np.uint8]:
    """Return levels 0..255 (height, width); ddof 1 as QVPR/VPRTempo 64154e5, 0 as v1.0.0 a3b07b2."""
    return np.floor(255.0 * (1.0 + patch_z(grey, patch, ddof)) / 2.0).astype(np.uint8)


def local_std(grey: Floats, patch: int, ddof: int) -> Floats:
    """Return each window's deviation (height, width), the divisor of both public codes' z score."""
    deviation = np.zeros(grey.shape)
    for row in range(grey.shape[0]):
        for column in range(grey.shape[1]):
            deviation[row, column] = _std(_window(grey, row, column, patch), ddof)
    return deviation


def _neighbours(index: int, n_source: int, n_target: int) -> tuple[int, int, float]:
    """Return the two source indices under a target pixel's centre and the second one's weight."""
    position = max((index + 0.5) * n_source / n_target - 0.5, 0.0)
    first = math.floor(position)
    return first, min(first + 1, n_source - 1), position - first


def _window(grey: Floats, row: int, column: int, patch: int) -> list[float]:
    """Return the values of the patch by patch window around a pixel, cut at the border."""
    if patch % 2 == 0:
        raise ValueError(f"patch is {patch}; an odd size is wanted, so that a window has a centre")
    half = (patch - 1) // 2
    return [
        float(grey[r, c])
        for r in range(row - half, row + half + 1)
        for c in range(column - half, column + half + 1)
        if 0 <= r < grey.shape[0] and 0 <= c < grey.shape[1]
    ]


def _std(window: list[float], ddof: int) -> float:
    """Return the standard deviation of a window, 0 where its values are equal or it holds only one."""
    if min(window) == max(window):
        return 0.0
    mean = math.fsum(window) / len(window)
    return math.sqrt(math.fsum((value - mean) ** 2 for value in window) / (len(window) - ddof))
