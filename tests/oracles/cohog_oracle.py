"""A plain float64 CoHOG that judges the fast implementation; it begins at the resized grey image."""

import numpy as np
from preprocess_oracle import resize_bilinear
from scipy.ndimage import correlate, correlate1d

SMOOTH = [1, 4, 6, 4, 1]
DERIVE = [-1, -2, 0, 2, 1]


def histograms(grey, cell, bins):
    """Return (height // cell, width // cell, bins)."""
    level = grey.astype(np.float64)
    if level.any():
        level = 255 * np.sqrt(level / level.max())
    gx, gy = (
        correlate1d(correlate1d(level, DERIVE, axis, mode="mirror"), SMOOTH, 1 - axis, mode="mirror") for axis in (1, 0)
    )
    turn = np.degrees(np.arctan2(gy, gx)) % 360 / (360 / bins)
    lower, magnitude = np.floor(turn).astype(int), np.abs(0.5 * gx + 0.5 * gy)
    rows, columns = np.indices(grey.shape) // cell
    votes = np.zeros((grey.shape[0] // cell, grey.shape[1] // cell, bins))
    np.add.at(votes, (rows, columns, lower % bins), magnitude * (1 - turn + lower))
    np.add.at(votes, (rows, columns, (lower + 1) % bins), magnitude * (turn - lower))
    return votes


def regions(votes):
    """Return one unit vector for each square of 2 x 2 cells, (n_regions, 4 * bins); 0 where there are no votes."""
    squares = np.concatenate([votes[:-1, :-1], votes[:-1, 1:], votes[1:, :-1], votes[1:, 1:]], axis=2)
    vectors = squares.reshape(-1, squares.shape[2])
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    return vectors / np.where(lengths > 0, lengths, 1)


def entropy(levels, radius):
    """Return the entropy in bits over a disk, cut off at the border, (height, width)."""
    down, right = np.mgrid[-radius : radius + 1, -radius : radius + 1]
    disk = (down**2 + right**2 <= radius**2).astype(int)
    seen = correlate(np.ones(levels.shape, int), disk, mode="constant")
    found = np.zeros(levels.shape)
    for level in np.unique(levels):
        share = correlate((levels == level).astype(int), disk, mode="constant") / seen
        found -= share * np.log2(np.where(share > 0, share, 1))
    return found


def region_entropy(small, radius, size, cell):
    """Return the mean entropy of each region in shares of 8 bits, (n_regions,)."""
    bits = resize_bilinear(entropy(small, radius), size, size)
    along = range(0, size - cell, cell)
    return np.array([bits[r : r + 2 * cell, c : c + 2 * cell].mean() / 8 for r in along for c in along])


def score(query, good, reference):
    """Return the mean over the good regions of the query of the best dot product with a region of the reference."""
    best = (query @ reference.T).max(1)[good]
    return float(best.mean()) if len(best) else 0.0
