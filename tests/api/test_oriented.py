"""Oriented edges against loops over pixels and cells that follow the published formula."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from preprocess_frames import saturated_frame, smooth_frame

from vprbench.api.images import Images
from vprbench.api.oriented import OrientedEdges
from vprbench.errors import BadInput

SIZES = [(32, 64), (90, 160), (53, 37), (20, 17), (1, 9), (7, 1), (1, 1), (360, 640), (2, 9000), (5000, 3)]


def area_mean(values, rows, columns):
    """Means over equal areas, pixel by pixel: a pixel counts by the area that it shares with the cell."""
    height, width = len(values), len(values[0])
    means = [[0.0] * columns for _ in range(rows)]
    for row in range(rows):
        top, bottom = row * height / rows, (row + 1) * height / rows
        for column in range(columns):
            left, right = column * width / columns, (column + 1) * width / columns
            for y in range(int(top), min(math.ceil(bottom - 1e-9), height)):
                for x in range(int(left), min(math.ceil(right - 1e-9), width)):
                    shared = (min(bottom, y + 1) - max(top, y)) * (min(right, x + 1) - max(left, x))
                    means[row][column] += values[y][x] * shared / ((bottom - top) * (right - left))
    return means


def by_hand(frame, height, width, rows, columns, bins, block, epsilon):
    """The code of one frame, (rows, columns, bins), a number at a time."""
    levels = [[0.299 * r + 0.587 * g + 0.114 * b for r, g, b in line] for line in frame.tolist()]
    grey = area_mean(levels, height, width)
    votes = [[[0.0] * width for _ in range(height)] for _ in range(bins)]
    for y in range(height):
        for x in range(width):
            gx = grey[y][min(x + 1, width - 1)] - grey[y][max(x - 1, 0)]
            gy = grey[min(y + 1, height - 1)][x] - grey[max(y - 1, 0)][x]
            place = (math.atan2(gy, gx) % math.pi) / (math.pi / bins) - 0.5
            lower = math.floor(place)
            votes[lower % bins][y][x] += math.hypot(gx, gy) * (1 - (place - lower))
            votes[(lower + 1) % bins][y][x] += math.hypot(gx, gy) * (place - lower)
    cells = [area_mean(own, rows, columns) for own in votes]

    def mirrored(index, size):
        while not 0 <= index < size:
            index = -1 - index if index < 0 else 2 * size - 1 - index
        return index

    code = np.empty((rows, columns, bins))
    around = range(-(block // 2), block // 2 + 1)
    for row in range(rows):
        for column in range(columns):
            energies = [
                sum(own[mirrored(row + dy, rows)][mirrored(column + dx, columns)] ** 2 for own in cells)
                for dy in around
                for dx in around
            ]
            for bin in range(bins):
                value = cells[bin][row][column] / (math.sqrt(sum(energies) / block**2) + epsilon)
                code[row, column, bin] = min(max(value, 0), 1)
    return code


ENGINES = pytest.mark.parametrize("engine", ["fused", "readable"])


@ENGINES
@pytest.mark.parametrize(
    ("height", "width", "rows", "columns", "orientations", "block", "epsilon"),
    [
        (32, 64, 8, 16, 8, 3, 16.0),
        (33, 61, 8, 16, 8, 3, 16.0),
        (12, 40, 5, 7, 3, 5, 1.0),
        (5, 4, 8, 2, 2, 7, 0.1),
        (1, 30, 1, 5, 9, 1, 40.0),
    ],
)
def test_codes_follow_the_formula(engine, height, width, rows, columns, orientations, block, epsilon):
    sizes = (height, width, rows, columns, orientations, block, epsilon)
    encoder = OrientedEdges(*sizes, engine)
    for frame in (smooth_frame(45, 70, 3), saturated_frame(20, 17, 2), smooth_frame(1, 9, 1)):
        expected = by_hand(frame, *sizes)
        for power, within in ((1.0, 1e-6), (0.75, 1e-5), (0.5, 1e-5)):
            found = replace(encoder, power=power)(Images.from_arrays([frame]))
            assert found.shape == (1, encoder.n_inputs)
            assert np.abs(found.reshape(expected.shape) - expected**power).max() < within


@pytest.mark.parametrize("size", SIZES, ids=str)
def test_both_engines_give_the_same_codes_and_zeros_for_one_level(size):
    images = Images.from_arrays([smooth_frame(*size, 4), saturated_frame(*size, 5)])
    flat = [np.full((*size, 3), level, np.uint8) for level in (0, 1, 77, 255)]
    flat.append(np.broadcast_to(np.uint8([10, 200, 30]), (*size, 3)))
    fused, readable = (OrientedEdges(engine=engine)(images) for engine in ("fused", "readable"))
    assert fused.dtype == readable.dtype == np.float32
    assert np.abs(fused - readable).max() < 1e-6
    for engine in ("fused", "readable"):
        assert not OrientedEdges(engine=engine)(Images.from_arrays(flat)).any()


@ENGINES
def test_an_edge_votes_in_its_own_cells_and_orientation_alone(engine):
    # Left half 0, right half 160: slopes of 160 across in the two columns beside the step, theta = 0, halfway between
    # the first bin (pi / 16) and the last: half a vote each. A cell of 4 x 4 pixels beside the step has one such
    # column: 160 / 4 / 2 = 20 in both bins, energy 800; of the 9 cells of its block 6 hold it at every row.
    frame = np.zeros((32, 64, 3), np.uint8)
    frame[:, 32:] = 160
    code = OrientedEdges(engine=engine)(Images.from_arrays([frame])).reshape(8, 16, 8)
    expected = np.zeros((8, 16, 8))
    expected[:, 7:9, [0, 7]] = 20 / (math.sqrt(800 * 6 / 9) + 16)
    assert np.abs(code - expected).max() < 1e-6


def test_threads_and_layout_in_memory_change_nothing_and_no_frames_give_no_codes():
    frame = smooth_frame(32, 64, 5)
    locked = frame.copy()
    locked.flags.writeable = False
    alike = [frame, locked, np.asfortranarray(frame), frame[:, ::-1][:, ::-1]]
    images = Images.from_arrays([*alike, *(smooth_frame(32, 64, seed) for seed in range(5)), smooth_frame(90, 50, 9)])
    before, codes = torch.get_num_threads(), []
    try:
        for threads in (1, 2, 4):
            torch.set_num_threads(threads)
            codes.append(OrientedEdges()(images))
    finally:
        torch.set_num_threads(before)
    assert np.array_equal(codes[0], codes[1])
    assert np.array_equal(codes[0], codes[2])
    assert (codes[0][:4] == codes[0][0]).all()
    assert OrientedEdges()(Images.from_arrays([])).shape == (0, 1024)


@pytest.mark.parametrize(
    ("arguments", "wanted"),
    [
        ({"height": 0}, "method.height=0: give at least 1"),
        ({"columns": 0}, "method.columns=0: give at least 1"),
        ({"orientations": 1}, "method.orientations=1: give at least 2"),
        ({"block": 4}, "method.block=4: .* odd"),
        ({"epsilon": 0.0}, "method.epsilon=0.0: .* more than 0"),
        ({"epsilon": math.nan}, "method.epsilon=nan"),
        ({"power": 0.0}, "method.contrast_power=0.0: .* more than 0"),
    ],
)
def test_sizes_without_a_code_are_told(arguments, wanted):
    with pytest.raises(BadInput, match=wanted):
        OrientedEdges(**arguments)
