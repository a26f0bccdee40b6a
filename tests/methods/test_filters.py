"""Filters of frames by hand and by float64 oracles: patch normalisation, Gabor filters, edges."""

import itertools
import math

import numpy as np
import preprocess_oracle as oracle
import pytest
import readable_encoders as readable
from described_images import drawn_images

from vprbench.api.images import Images
from vprbench.methods.parts.filters.gabor import GaborBank
from vprbench.methods.parts.filters.oriented import OrientedEdges
from vprbench.methods.parts.filters.patches import PatchNormalisation

SIZES = [(28, 28), (32, 64), (90, 160), (20, 17), (53, 37), (1, 9)]


def draw_frame(height, width, seed=0):
    return drawn_images((height, width), seed=seed)[0]


def saturated_frame(height, width, seed=0):
    """A frame whose upper third is a sky of one level, as of an overexposed camera."""
    frame = draw_frame(height, width, seed)
    frame[: height // 3] = 255 if seed % 2 else 203
    return frame


def preprocess(variant, *frames, **arguments):
    return PatchNormalisation(variant, **arguments)(Images.from_arrays(frames))


@pytest.mark.parametrize("variant", "ABC")
def test_a_constant_frame_is_127_everywhere(variant):
    colours = [(0, 0, 0), (1, 1, 1), (2, 2, 2), (100,) * 3, (255,) * 3, (10, 200, 30)]
    frames = [np.full((56, 56, 3), colour, np.uint8) for colour in colours]
    frames += [np.full((*size, 3), 7, np.uint8) for size in (*SIZES, (360, 640))]
    assert (preprocess(variant, *frames) == 127).all()


BRIGHT = np.zeros((20, 20), np.uint8)
BRIGHT[0, :2] = 255  # the mean is 1.275, the exponent 20: beyond float32, so clipped


@pytest.mark.parametrize(
    "levels",
    [
        *([[level] * 5] * 4 for level in (2, 10, 127, 200, 255)),
        *([[4, 16], [28, 16]], [[0, 255], [100, 155]]),  # means of 16, and of 127.5
        *([[0, 0]], [[0, 2]]),  # at most 1
        BRIGHT,
    ],
    ids=str,
)
def test_gamma_maps_the_mean_level_to_127_and_a_half_and_clips_in_variant_c_and_truncates_in_b(levels):
    frame = np.repeat(np.asarray(levels, np.uint8)[:, :, None], 3, axis=2)
    expected = oracle.gamma_c(np.asarray(levels, np.float64))
    b, c = (PatchNormalisation(variant, *frame.shape[:2]).shrink(frame) for variant in "BC")
    assert c == pytest.approx(expected, abs=0.01)
    assert np.array_equal(b, np.floor(expected))


@pytest.mark.parametrize("size", SIZES, ids=str)
@pytest.mark.parametrize("target", [(28, 28), (12, 20), (5, 4)])
def test_levels_are_the_oracles_but_for_one_where_a_window_is_not_flat(size, target):
    frame = draw_frame(*size)
    grey = oracle.resize_bilinear(oracle.gamma_c(oracle.grey_c(frame)), *target)
    for variant, ddof in (("A", 0), ("B", 0), ("C", 1)):
        small = grey if variant == "C" else PatchNormalisation(variant, *target).shrink(frame).astype(np.float64)
        expected = oracle.patch_normalise(small, 7, ddof).astype(int)
        got = preprocess(variant, frame, height=target[0], width=target[1])[0].reshape(target)
        told = oracle.local_std(small, 7, ddof) > 1e-3
        assert np.abs(got - expected)[told].max() <= 1


def filter_by_hand(angle, wavelength, phase, width):
    """One filter of 5x5 pixels."""
    y, x = np.mgrid[-2:3, -2:3]
    across, along = x * math.cos(angle) + y * math.sin(angle), y * math.cos(angle) - x * math.sin(angle)
    wave = np.exp(-(across**2 + 0.25 * along**2) / (2 * width**2)) * np.cos(2 * np.pi * across / wavelength + phase)
    return ((wave - wave.mean()) / np.abs(wave - wave.mean()).sum()).ravel()


FILTERS = [
    filter_by_hand(quarter * math.pi / 4, *others)
    for quarter in range(4)
    for others in itertools.product((2.25, 3), (0, math.pi / 2), (1, 2))
]


def by_hand(levels, block, epsilon):
    """The codes of patch-normalised frames (n, h, w) before anything is clipped, (n, rows * columns * 32)."""
    windows = np.lib.stride_tricks.sliding_window_view(levels / 255, (5, 5), (1, 2))
    waves = windows.reshape(*windows.shape[:3], 25) @ np.transpose(FILTERS)
    n, rows, columns = len(waves), waves.shape[1] // 2, waves.shape[2] // 2
    strongest = waves[:, : 2 * rows, : 2 * columns].reshape(n, rows, 2, columns, 2, 32).max((2, 4))
    around = [np.pad(range(size), block // 2, mode="symmetric") for size in (rows, columns)]
    energy = (strongest**2).sum(3)
    codes = []
    for r in range(rows):
        for c in range(columns):
            near = energy[:, around[0][r : r + block]][:, :, around[1][c : c + block]]
            codes.append(4 * strongest[:, r, c] / (np.sqrt(near.mean((1, 2))) + epsilon)[:, None])
    return np.concatenate(codes, axis=1)


@pytest.mark.parametrize(("block", "epsilon"), [(1, 0.3), (3, 0.1), (7, 0.01)])
def test_codes_are_those_of_the_formula_within_0_and_1(block, epsilon):
    plain = np.full((48, 64, 3), 97, np.uint8)
    images = Images.from_arrays([draw_frame(90, 160), *(saturated_frame(32, 64, seed) for seed in (0, 1)), plain])
    bank = GaborBank(10, 13, 5, block, epsilon)
    levels = PatchNormalisation("C", 10, 13, 5)(images)
    wanted = by_hand(levels.reshape(4, 10, 13).astype(float), block, epsilon)
    np.testing.assert_allclose(bank(images), np.clip(wanted, 0, 1), atol=2e-5)
    assert 0.05 < np.mean(np.clip(wanted, 0, 1) != wanted) < 0.95  # some are clipped


EDGE_SIZES = [(32, 64), (53, 37), (20, 17), (1, 9), (7, 1), (1, 1), (2, 9000), (5000, 3)]
NAMES = ("height", "width", "rows", "columns", "orientations", "block", "epsilon")
SIZES_OF_CODES = [
    (33, 61, 8, 16, 8, 3, 16.0),
    (12, 40, 5, 7, 3, 5, 1.0),
    (5, 4, 8, 2, 2, 7, 0.1),
    (1, 30, 1, 5, 9, 1, 40.0),
]


@pytest.mark.parametrize(
    ("size", "sizes", "power"),
    [
        *((size, {}, 1.0) for size in EDGE_SIZES),
        *(
            ((45, 70), dict(zip(NAMES, sizes, strict=True)), power)
            for sizes in SIZES_OF_CODES
            for power in (1.0, 0.75, 0.5)
        ),
    ],
    ids=str,
)
def test_edges_are_those_of_the_readable_twin_and_zeros_for_one_level(size, sizes, power):
    edges = OrientedEdges(**sizes, power=power)
    frames = [draw_frame(*size, 4), saturated_frame(*size, 5)]
    frames += [np.full((*size, 3), level, np.uint8) for level in (0, 1, 77, 255)]
    frames.append(np.broadcast_to(np.uint8([10, 200, 30]), (*size, 3)))
    found, twins = edges(Images.from_arrays(frames)), [readable.encode_edges(edges, frame).ravel() for frame in frames]
    assert (found.dtype, found.shape) == (np.float32, (7, edges.rows * edges.columns * edges.orientations))
    assert np.abs(found - np.array(twins, np.float32)).max() < (1e-6 if power == 1 else 1e-5)
    assert not found[2:].any()


def test_variant_b_has_the_oracles_whole_levels_and_a_no_gamma_and_resizes_before_it_takes_the_grey():
    frame = draw_frame(28, 28)
    difference = np.abs(PatchNormalisation("B").shrink(frame) - oracle.gamma_b(oracle.grey_b(frame)))
    assert difference.max() <= 2  # near-ties of OpenCV's fixed-point grey
    assert np.count_nonzero(difference) <= 8
    assert (PatchNormalisation("A").shrink(np.full((56, 56, 3), 10, np.uint8)) == 10).all()
    # The mean colour is (1, 0.25, 1.25), rounded (1, 0, 1), grey 0.413. Grey first would give 1 in every pixel
    # (0.598, 0.587, 0.57, 0.598 rounded), and 1 after the resize.
    frame = np.array([[[2, 0, 0], [0, 1, 0]], [[0, 0, 5], [2, 0, 0]]], np.uint8)
    assert PatchNormalisation("A", 1, 1, 3).shrink(frame).tolist() == [[0]]
