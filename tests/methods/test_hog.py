"""HOG against a float64 implementation of the rules and worked examples."""

import math

import numpy as np
import pytest
from described_images import encoded, image

from vprbench.methods.hog import HOG

ONE_CELL = {"height": 16, "width": 16}  # a single histogram of nine orientations


def slow_hog(rgb, block=16, stride=8, cell=16, bins=9, sigma=4.0, signed=False, gamma=False):
    """Spec, section 5.2, on an image that needs no resizing: pixel by pixel, in float64, as a unit vector."""
    levels = np.sqrt(rgb) if gamma else rgb.astype(float)
    height, width, _ = rgb.shape
    framed = np.pad(levels, ((1, 1), (1, 1), (0, 0)), mode="reflect")
    across = framed[1:-1, 2:] - framed[1:-1, :-2]
    down = framed[2:, 1:-1] - framed[:-2, 1:-1]

    strength = across[..., ::-1] ** 2 + down[..., ::-1] ** 2
    channel = 2 - strength.argmax(2)[..., None]  # the strongest of blue, green, red; the first of equals
    gx, gy = (np.take_along_axis(side, channel, 2)[..., 0] for side in (across, down))
    turn = 2 * math.pi if signed else math.pi
    position = np.arctan2(gy, gx) % turn / turn * bins - 0.5
    offsets = np.arange(block)
    weights = np.exp(-((offsets[:, None] - block / 2) ** 2 + (offsets - block / 2) ** 2) / (2 * sigma**2))
    near = np.maximum(0, 1 - abs((offsets[:, None] + 0.5) / cell - 0.5 - np.arange(block // cell)))  # (offset, cell)

    lower = np.floor(position).astype(int)
    of_lower, of_upper = np.eye(bins)[lower % bins], np.eye(bins)[(lower + 1) % bins]
    share = (position - lower)[..., None]
    votes = np.hypot(gx, gy)[..., None] * ((1 - share) * of_lower + share * of_upper)  # (height, width, orientation)

    def histograms(top, left):
        part = votes[top : top + block, left : left + block] * weights[..., None]
        flat = np.einsum("yxo,yr,xc->cro", part, near, near).ravel()  # column, row, orientation
        clipped = np.minimum(flat / (np.linalg.norm(flat) + 0.1 * flat.size), 0.2)
        return clipped / (np.linalg.norm(clipped) + 1e-3)

    tops, lefts = range(0, height - block + 1, stride), range(0, width - block + 1, stride)
    code = np.concatenate([histograms(top, left) for left in lefts for top in tops])
    return code / np.linalg.norm(code)


def smooth(height, width):
    y, x = np.mgrid[:height, :width]
    waves = [np.sin(x / 5 + y / 9), np.cos(x / 7 - y / 4), np.sin(x * y / 90)]
    return np.stack([np.round(127 + 120 * wave) for wave in waves], axis=2).astype(np.uint8)


@pytest.mark.parametrize(
    ("frame", "arguments"),
    [
        (image(32, 40), {}),
        (smooth(32, 40), {"cell": 8}),
        (smooth(32, 40), {"signed": True, "bins": 12}),
        (image(32, 40), {"gamma": True}),
        (image(32, 40), {"sigma": 2.5, "stride": 4}),
    ],
)
def test_descriptors_equal_those_computed_pixel_by_pixel(frame, arguments):
    code = encoded(HOG(height=32, width=40, **arguments), frame)[0]
    # OpenCV's angles are a polynomial's, up to 0.3 degrees off by its documentation: 0.015 of a vote of 20 degrees.
    assert np.abs(code - slow_hog(frame, **arguments)).max() < 1e-3


def test_a_large_frame_is_resized_without_antialiasing_as_published_or_by_area():
    frame = image(64, 64)
    for offset in (1, 2):  # constant between the second and the third of every four pixels
        frame[offset::4] = 90
        frame[:, offset::4] = 90
    assert not encoded(HOG(**ONE_CELL), frame).any()
    assert encoded(HOG(**ONE_CELL, interpolation="area"), frame).any()
