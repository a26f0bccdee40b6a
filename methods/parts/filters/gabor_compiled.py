"""The compiled half of `gabor`: responses of a bank of filters, their maximum in each cell, and normalisation."""

from __future__ import annotations

import numpy as np
from numba import types

from vprbench.api import compiled

_FRAMES = types.Array(types.uint8, 3, "C", readonly=True)
_MAPS, _TAPS = types.float32[:, :, :, ::1], types.Array(types.float32, 3, "C", readonly=True)
_PLACES = types.int64[::1]


@compiled(_FRAMES, types.float32, _TAPS, _MAPS, fastmath={"contract"})
def filter_frames(frames, mean_level, taps, maps):  # type: ignore[no-untyped-def]
    """Write the largest of the responses in 2x2 pixels of `frames` (n, h, w) to `maps` (n, rows, columns, n_filters).

    `taps` are (size, size, n_filters); nothing is filtered beyond the border.
    """
    n, rows, columns, n_filters = maps.shape
    size = len(taps)
    response = np.empty(n_filters, np.float32)
    for image in range(n):
        for row in range(rows):
            for column in range(columns):
                best = maps[image, row, column]
                best[:] = -np.inf
                for pixel in range(4):
                    top, left = 2 * row + pixel // 2, 2 * column + pixel % 2
                    response[:] = 0
                    for y in range(size):
                        for x in range(size):
                            level = np.float32(frames[image, top + y, left + x]) - mean_level
                            weights = taps[y, x]
                            for k in range(n_filters):
                                response[k] += level * weights[k]
                    for k in range(n_filters):
                        best[k] = max(best[k], response[k])


@compiled(_MAPS, _PLACES, _PLACES, types.int64, types.float32, types.float32)
def normalise(maps, beside_rows, beside_columns, block, epsilon, gain):  # type: ignore[no-untyped-def]
    """Make of responses (n, rows, columns, n_filters) codes 0..1, in place.

    The cells of a block around row i are rows `beside_rows`[i : i + block], and so with columns.
    """
    n, rows, columns, n_filters = maps.shape
    energy, along = np.empty((rows, columns), np.float32), np.empty((rows, columns), np.float32)
    for image in range(n):
        for row in range(rows):
            for column in range(columns):
                total = np.float32(0)
                for response in maps[image, row, column]:
                    total += response * response
                energy[row, column] = total
        for row in range(rows):
            for column in range(columns):
                total = np.float32(0)
                for k in range(block):
                    total += energy[row, beside_columns[column + k]]
                along[row, column] = total
        for row in range(rows):
            for column in range(columns):
                total = np.float32(0)
                for k in range(block):
                    total += along[beside_rows[row + k], column]
                scale = gain / (np.sqrt(total / np.float32(block * block)) + epsilon)
                code = maps[image, row, column]
                for k in range(n_filters):
                    code[k] = min(max(code[k] * scale, np.float32(0)), np.float32(1))
