"""Readable twins of the compiled encoders, step by step in numpy, that judge them."""

import numpy as np
import preprocess_oracle as oracle

GREY = (299, 587, 114)  # thousandths of red, green and blue


def encode_patches(encoder, images):
    """Return the levels of a `PatchNormalisation` of variant C, (n_images, height * width)."""
    size, grey = (encoder.height, encoder.width), (oracle.gamma_c(oracle.grey_c(image)) for image in images)
    small = (oracle.resize_bilinear(levels, *size) for levels in grey)
    return np.stack([oracle.patch_normalise(levels, encoder.patch, 1).ravel() for levels in small])


def encode_edges(edges, image):
    """Return the code of `OrientedEdges`, (rows, columns, orientations)."""
    levels = image.astype(np.int64) @ np.array(GREY)
    # Whole numbers up to the last step, so that a frame of one level stays one.
    grey = sum_areas(levels, edges.height, edges.width) / (levels.size * sum(GREY))
    padded = np.pad(grey, 1, mode="edge")
    across, down = padded[1:-1, 2:] - padded[1:-1, :-2], padded[2:, 1:-1] - padded[:-2, 1:-1]
    position = np.arctan2(down, across) % np.pi * edges.orientations / np.pi - 0.5  # in bins, 0: the first's centre
    away = np.abs(position - np.arange(edges.orientations)[:, None, None])
    shares = np.maximum(0, 1 - np.minimum(away, edges.orientations - away))
    votes = shares * np.hypot(across, down)
    cells = np.stack([sum_areas(bins, edges.rows, edges.columns) for bins in votes], 2) / grey.size
    energy = np.pad(np.square(cells).sum(2), edges.block // 2, mode="symmetric")
    windows = np.lib.stride_tricks.sliding_window_view(energy, (edges.block, edges.block))
    spread = np.sqrt(windows.mean((2, 3))) + edges.epsilon
    return np.clip(cells / spread[:, :, None], 0, 1) ** edges.power


def sum_areas(values, rows, columns):
    """Return the sums over equal areas, (rows, columns), times rows * columns; cut values count by their share."""
    return area_shares(rows, values.shape[0]) @ values @ area_shares(columns, values.shape[1]).T


def area_shares(parts, size):
    """Return how much of each of `size` pixels lies in each of equal `parts`, (parts, size), in parts of a pixel."""
    first, pixel = np.arange(parts)[:, None] * size, np.arange(size) * parts
    return np.maximum(0, np.minimum(first + size, pixel + parts) - np.maximum(first, pixel))
