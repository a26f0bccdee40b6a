"""Readable twins of the compiled encoders, step by step in PyTorch and numpy, that judge them."""

import numpy as np
import torch
from torch.nn import functional

GREY = (299, 587, 114)  # thousandths of red, green and blue


def correct_gamma(grey, mean):
    """Map the mean of grey levels 0..255 to 127.5 and clip to 0..255; a mean of at most 1 changes nothing."""
    exponent = np.log(127.5) / np.log(mean) if mean > 1 else 1.0
    with np.errstate(over="ignore"):
        return np.clip(np.power(grey, np.float32(exponent)), 0, 255)


def shrink_c(image, height, width):
    """Return the grey, gamma-corrected image of variant C, (height, width), as VPRTempo 64154e5 makes it."""
    red, green, blue = (image[:, :, c].astype(np.float32) for c in range(3))
    weighted = np.float32(0.299) * red + np.float32(0.587) * green + np.float32(0.114) * blue
    sums = image.sum((0, 1), dtype=np.int64)
    corrected = correct_gamma(weighted, (0.299 * sums[0] + 0.587 * sums[1] + 0.114 * sums[2]) / weighted.size)
    if corrected.min() == corrected.max():  # the weights of the resize would leave rounding noise
        return np.full((height, width), corrected[0, 0])
    pixels = torch.from_numpy(corrected)[None, None]
    resized = functional.interpolate(pixels, (height, width), mode="bilinear", align_corners=False)
    return np.asarray(resized[0, 0], dtype=np.float32)


def normalise_patches(grey, patch, ddof):
    """Compare each pixel with its window: (n, height, width) -> (n, height * width), 127 at the window's mean."""
    n, height, width = grey.shape
    pixels = torch.from_numpy(grey).reshape(n, 1, height, width)
    inside = functional.unfold(torch.ones(1, 1, height, width), patch, padding=patch // 2)  # (1, patch**2, h*w)
    windows = functional.unfold(pixels, patch, padding=patch // 2)  # (n, patch**2, h*w), 0 outside
    centre = pixels.reshape(n, -1)
    count = inside.sum(1)  # (1, h*w)
    # float32 and this order of operations are the public code's: in a flat window the rounding decides the level.
    mean = windows.sum(1) / count
    deviation = ((windows - mean[:, None]) * inside).square().sum(1)
    z = ((centre - mean) / (deviation / (count - ddof)).sqrt()).nan_to_num(nan=0.0).clamp(-1, 1)
    flat = ((windows == centre[:, None]) | (inside == 0)).all(1)  # no noise in an exactly constant window
    return (255 * (1 + z.masked_fill(flat, 0.0)) / 2).to(torch.uint8).numpy()


def encode_patches(encoder, images):
    """Return the levels of `PatchNormalisation`, (n_images, height * width)."""
    is_c = encoder.variant == "C"
    small = [shrink_c(image, encoder.height, encoder.width) if is_c else encoder.shrink(image) for image in images]
    return normalise_patches(np.stack(small), encoder.patch, int(is_c))


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
