"""A pixel-by-pixel float64 CoHOG that judges the fast implementation; it begins at the resized grey image."""

import math
from collections import Counter

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

SMOOTH = {-2: 1, -1: 4, 0: 6, 1: 4, 2: 1}
DERIVE = {1: 2, 2: 1}  # of the differences of the pixels one and two to either side


def mirrored(index: int, length: int) -> int:
    """Return the index inside the image, mirrored without the last pixel: -1 is 1."""
    return -index if index < 0 else 2 * (length - 1) - index if index >= length else index


def histograms(grey: npt.NDArray[np.uint8], cell: int, bins: int) -> Floats:
    """Return (height // cell, width // cell, bins)."""
    height, width = grey.shape
    peak = float(grey.max())
    level = [[255 * math.sqrt(float(value) / peak) for value in row] for row in grey] if peak else grey.tolist()

    def pixel(row: int, column: int) -> float:
        return level[mirrored(row, height)][mirrored(column, width)]

    votes = np.zeros((height // cell, width // cell, bins))
    for row in range(height):
        for column in range(width):
            gx = gy = 0.0
            for along, smooth in SMOOTH.items():
                for step, weight in DERIVE.items():
                    gx += smooth * weight * (pixel(row + along, column + step) - pixel(row + along, column - step))
                    gy += smooth * weight * (pixel(row + step, column + along) - pixel(row - step, column + along))
            magnitude = abs(0.5 * gx + 0.5 * gy)
            angle = math.degrees(math.atan2(gy, gx)) % 360
            lower = math.floor(angle / (360 / bins))
            share = angle / (360 / bins) - lower
            votes[row // cell, column // cell, lower % bins] += magnitude * (1 - share)
            votes[row // cell, column // cell, (lower + 1) % bins] += magnitude * share
    return votes


def regions(votes: Floats) -> Floats:
    """Return one vector for each square of 2 x 2 cells, (n_regions, 4 * bins)."""
    found = []
    for row in range(votes.shape[0] - 1):
        for column in range(votes.shape[1] - 1):
            vector = [
                float(vote)
                for down, right in ((0, 0), (0, 1), (1, 0), (1, 1))
                for vote in votes[row + down, column + right]
            ]
            length = math.sqrt(sum(value * value for value in vector))
            found.append([value / length for value in vector] if length else vector)
    return np.array(found)


def entropy(levels: npt.NDArray[np.uint8], radius: int) -> Floats:
    """Return the entropy in bits over a disk, cut off at the border, (height, width)."""
    height, width = levels.shape
    found = np.zeros((height, width))
    for row in range(height):
        for column in range(width):
            seen = Counter(
                int(levels[r, c])
                for r in range(max(0, row - radius), min(height, row + radius + 1))
                for c in range(max(0, column - radius), min(width, column + radius + 1))
                if (r - row) ** 2 + (c - column) ** 2 <= radius**2
            )
            shares = [count / seen.total() for count in seen.values()]
            found[row, column] = -sum(share * math.log2(share) for share in shares)
    return found


def enlarged(image: Floats, size: int) -> Floats:
    """Return (size, size), bilinear, half-pixel centres."""

    def taps(index: int, length: int) -> tuple[int, int, float]:
        position = min(max((index + 0.5) * length / size - 0.5, 0.0), length - 1.0)
        first = min(math.floor(position), length - 1)
        return first, min(first + 1, length - 1), position - first

    found = np.zeros((size, size))
    for row in range(size):
        top, bottom, down = taps(row, image.shape[0])
        for column in range(size):
            left, right, across = taps(column, image.shape[1])
            above = (1 - across) * image[top, left] + across * image[top, right]
            below = (1 - across) * image[bottom, left] + across * image[bottom, right]
            found[row, column] = (1 - down) * above + down * below
    return found


def region_entropy(small: npt.NDArray[np.uint8], radius: int, size: int, cell: int) -> Floats:
    """Return the mean entropy of each region in shares of 8 bits, (n_regions,)."""
    bits = enlarged(entropy(small, radius), size)
    along = range(0, size - cell, cell)
    return np.array(
        [bits[r : r + 2 * cell, c : c + 2 * cell].sum() / (8 * (2 * cell) ** 2) for r in along for c in along]
    )


def score(query: Floats, good: npt.NDArray[np.bool_], reference: Floats) -> float:
    """Return the mean over the good regions of the query of the best dot product with a region of the reference."""
    best = [max(float(np.dot(own, other)) for other in reference) for own in query]
    chosen = [value for value, counts in zip(best, good, strict=True) if counts]
    return sum(chosen) / len(chosen) if chosen else 0.0
