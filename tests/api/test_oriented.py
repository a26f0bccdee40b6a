"""Oriented edges worked by hand, and by two engines that judge each other."""

import math

import numpy as np
import pytest
from preprocess_frames import saturated_frame, smooth_frame

from vprbench.api.images import Images
from vprbench.api.oriented import OrientedEdges

SIZES = [(32, 64), (90, 160), (53, 37), (20, 17), (1, 9), (7, 1), (1, 1), (360, 640), (2, 9000), (5000, 3)]


def both(frames, **sizes):
    """The codes of both engines."""
    return [OrientedEdges(**sizes, engine=engine)(Images.from_arrays(frames)) for engine in ("fused", "readable")]


@pytest.mark.parametrize("size", SIZES, ids=str)
def test_both_engines_give_the_same_codes_and_zeros_for_one_level(size):
    fused, readable = both([smooth_frame(*size, 4), saturated_frame(*size, 5)])
    assert fused.dtype == readable.dtype == np.float32
    assert np.abs(fused - readable).max() < 1e-6
    flat = [np.full((*size, 3), level, np.uint8) for level in (0, 1, 77, 255)]
    flat.append(np.broadcast_to(np.uint8([10, 200, 30]), (*size, 3)))
    assert not np.any(both(flat))


@pytest.mark.parametrize("power", [1.0, 0.75, 0.5])
@pytest.mark.parametrize(
    "sizes",
    [(33, 61, 8, 16, 8, 3, 16.0), (12, 40, 5, 7, 3, 5, 1.0), (5, 4, 8, 2, 2, 7, 0.1), (1, 30, 1, 5, 9, 1, 40.0)],
)
def test_both_engines_agree_on_any_sizes(sizes, power):
    names = ("height", "width", "rows", "columns", "orientations", "block", "epsilon")
    fused, readable = both([smooth_frame(45, 70, 3)], **dict(zip(names, sizes, strict=True)), power=power)
    assert fused.shape == (1, sizes[2] * sizes[3] * sizes[4])
    assert np.abs(fused - readable).max() < (1e-6 if power == 1 else 1e-5)


@pytest.mark.parametrize("power", [1.0, 0.75])
@pytest.mark.parametrize(("shape", "turned"), [((64, 32, 16, 8), True), ((32, 64, 8, 16), False)])
def test_an_edge_votes_in_its_own_cells_and_orientations_alone(shape, turned, power):
    # Left half 0, right half of a colour whose grey is 0.299 * 100 + 0.587 * 200 + 0.114 * 50 = 153: slopes of 153
    # across in the two columns beside the step, theta = 0, halfway between the first bin (pi / 16) and the last: half a
    # vote each. A cell of 4 x 4 pixels beside the step has one such column: 153 / 4 / 2 in both bins, twice its square
    # in energy; of the 9 cells of its block 6 hold it at every row. Turned, theta = pi / 2 lies between bins 3 and 4.
    frame = np.zeros((32, 64, 3), np.uint8)
    frame[:, 32:] = (100, 200, 50)
    expected = np.zeros((8, 16, 8))
    vote = 153 / 4 / 2
    expected[:, 7:9, [3, 4] if turned else [0, 7]] = (vote / (math.sqrt(2 * vote**2 * 6 / 9) + 16)) ** power
    if turned:
        frame, expected = frame.swapaxes(0, 1), expected.swapaxes(0, 1)
    sizes = dict(zip(("height", "width", "rows", "columns"), shape, strict=True))
    for codes in both([frame], **sizes, power=power):
        assert np.abs(codes.reshape(expected.shape) - expected).max() < 1e-6
