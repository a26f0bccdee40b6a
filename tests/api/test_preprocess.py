"""Preprocessing against cases worked by hand and a pixel-by-pixel float64 oracle, by both engines."""

import numpy as np
import preprocess_oracle as oracle
import pytest
from preprocess_frames import saturated_frame, smooth_frame

from vprbench.api.images import Images
from vprbench.api.preprocess import PatchNormalisation, patch_normalise

VARIANTS = ("A", "B", "C")
SIZES = [(28, 28), (32, 64), (90, 160), (20, 17), (53, 37), (1, 9)]


def grey_frame(levels):
    return np.repeat(np.asarray(levels, np.uint8)[:, :, None], 3, axis=2)


def preprocess(variant, *frames, **arguments):
    return PatchNormalisation(variant, **arguments)(Images.from_arrays(frames))


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_constant_frame_is_127_everywhere(variant):
    colours = [(0, 0, 0), (1, 1, 1), (2, 2, 2), (100,) * 3, (255,) * 3, (10, 200, 30)]
    frames = [np.full((56, 56, 3), colour, np.uint8) for colour in colours]
    frames += [np.full((*size, 3), 7, np.uint8) for size in (*SIZES, (360, 640))]
    for engine in ("fused", "readable"):
        assert (preprocess(variant, *frames, engine=engine) == 127).all()


# One level of 9 in a 3 x 3 frame. Corner: window 0 0 0 9, mean 2.25, squares 60.75. Edge: window of six, mean 1.5,
# squares 67.5. Centre: z = 8 / 2.8 or 8 / 3, clipped to 1.
# ddof 0: corner z = -2.25 / sqrt(60.75 / 4) = -0.5774, edge z = -1.5 / sqrt(67.5 / 6) = -0.4472.
# ddof 1: corner z = -2.25 / sqrt(60.75 / 3) = -0.5, edge z = -1.5 / sqrt(67.5 / 5) = -0.4082.
# Level = floor(255 (1 + z) / 2).
# Windows 0 4 | 0 4 8 | 4 8. ddof 0: z = -1, 0, 1. ddof 1: z = -2 / sqrt(8) = -0.7071, 0, 0.7071.
@pytest.mark.parametrize(
    ("levels", "patch", "ddof", "expected"),
    [
        ([[0, 0, 0], [0, 9, 0], [0, 0, 0]], 3, 0, [53, 70, 53, 70, 255, 70, 53, 70, 53]),
        ([[0, 0, 0], [0, 9, 0], [0, 0, 0]], 3, 1, [63, 75, 63, 75, 255, 75, 63, 75, 63]),
        ([[0, 4, 8]], 3, 0, [0, 127, 255]),
        ([[0, 4, 8]], 3, 1, [37, 127, 217]),
        ([[200, 200], [200, 200]], 7, 1, [127] * 4),  # black beyond the border is no part of a window
        ([[80]], 3, 1, [127]),
    ],
)
def test_a_pixel_is_compared_with_its_window_cut_at_the_border(levels, patch, ddof, expected):
    assert patch_normalise(np.array([levels], np.float32), patch, ddof).tolist() == [expected]


BRIGHT = np.zeros((20, 20), np.uint8)
BRIGHT[0, :2] = 255  # the mean is 1.275, the exponent 20: beyond float32, so clipped


@pytest.mark.parametrize(
    ("levels", "expected"),
    [
        *([[[level] * 5] * 4, np.full((4, 5), 127.5)] for level in (2, 10, 127, 200, 255)),
        # The mean is 16; 4 is its square root, so it goes to the square root of 127.5; 28 would go to 339.
        ([[4, 16], [28, 16]], [[127.5**0.5, 127.5], [255, 127.5]]),
        ([[0, 255], [100, 155]], [[0, 255], [100, 155]]),  # the mean is 127.5
        *((levels, levels) for levels in ([[0, 0]], [[0, 2]])),  # at most 1
        (BRIGHT, BRIGHT),
    ],
    ids=str,
)
def test_gamma_maps_the_mean_level_to_127_and_a_half_and_clips_in_variant_c_and_truncates_in_b(levels, expected):
    frame = grey_frame(levels)
    b, c = (PatchNormalisation(variant, *frame.shape[:2]).shrink(frame) for variant in "BC")
    assert c == pytest.approx(np.asarray(expected, np.float64), abs=0.01)
    assert np.array_equal(b, np.floor(expected))


@pytest.mark.parametrize("size", [(32, 64), (53, 37), (28, 28)])
@pytest.mark.parametrize("target", [(28, 28), (12, 20)])
def test_variant_c_is_the_oracle_but_for_a_level_where_a_window_is_not_flat(size, target):
    frame = smooth_frame(*size)
    grey = oracle.resize_bilinear(oracle.gamma_c(oracle.grey_c(frame)), *target)
    expected = oracle.patch_normalise(grey, 7, 1).astype(int)
    got = preprocess("C", frame, height=target[0], width=target[1])[0].reshape(target)
    told = oracle.local_std(grey, 7, 1) > 1e-3
    assert np.abs(got - expected)[told].max() <= 1


def test_variant_b_has_the_oracles_whole_levels():
    frame = smooth_frame(28, 28)
    difference = np.abs(PatchNormalisation("B").shrink(frame) - oracle.gamma_b(oracle.grey_b(frame)))
    assert difference.max() <= 2  # near-ties of OpenCV's fixed-point grey
    assert np.count_nonzero(difference) <= 8


def test_variant_a_has_no_gamma_and_resizes_before_it_takes_the_grey():
    assert (PatchNormalisation("A").shrink(np.full((56, 56, 3), 10, np.uint8)) == 10).all()
    # The mean colour is (1, 0.25, 1.25), rounded (1, 0, 1), grey 0.413. Grey first would give 1 in every pixel
    # (0.598, 0.587, 0.57, 0.598 rounded), and 1 after the resize.
    frame = np.array([[[2, 0, 0], [0, 1, 0]], [[0, 0, 5], [2, 0, 0]]], np.uint8)
    assert PatchNormalisation("A", 1, 1, 3).shrink(frame).tolist() == [[0]]


def structured(frames, patch, **arguments):
    """Which windows of the shrunk frames are not flat, (n, height * width): there rounding decides."""
    found = []
    for frame in frames:
        small = PatchNormalisation(**arguments).shrink(frame).astype(np.float64)
        padded = np.pad(small, patch // 2, constant_values=np.nan)
        windows = np.lib.stride_tricks.sliding_window_view(padded, (patch, patch))
        with np.errstate(invalid="ignore"):
            found.append((np.nanstd(windows, (2, 3)) > 1e-3 * np.nanmean(windows, (2, 3))).ravel())
    return np.stack(found)


def both(frames, variant, **sizes):
    """Levels of the fused and of the readable engine, as (n, height * width) of int."""
    return [preprocess(variant, *frames, **sizes, engine=engine).astype(int) for engine in ("fused", "readable")]


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("size", SIZES, ids=str)
def test_engines_differ_by_at_most_one_level_outside_flat_windows(variant, size):
    frames = [smooth_frame(*size, seed) for seed in range(3)] + [saturated_frame(*size, seed) for seed in range(3)]
    frames.append(grey_frame((np.indices(size).sum(axis=0) % 2) * 2))  # its mean is 1
    fused, readable = both(frames, variant=variant)
    away = np.abs(fused - readable)
    assert away[structured(frames, 7, variant=variant)].max() <= 1
    assert (away > 1).mean() < 0.02  # in flat windows the rounding of the processor decides
    for height, width, patch in ((12, 40, 5), (56, 56, 15), (5, 4, 7), (1, 1, 3)):
        fused, readable = both([smooth_frame(90, 160)], variant=variant, height=height, width=width, patch=patch)
        assert np.abs(fused - readable).max() <= 1
