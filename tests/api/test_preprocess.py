"""Preprocessing against cases worked by hand and a pixel-by-pixel float64 oracle."""

import numpy as np
import preprocess_oracle as oracle
import pytest
from preprocess_frames import smooth_frame

from vprbench.api.images import Images
from vprbench.api.preprocess import PatchNormalisation, patch_normalise
from vprbench.errors import BadInput

VARIANTS = ("A", "B", "C")


def grey_frame(levels):
    return np.repeat(np.asarray(levels, np.uint8)[:, :, None], 3, axis=2)


def preprocess(variant, *frames, **sizes):
    return PatchNormalisation(variant, **sizes)(Images.from_arrays(frames))


def floats(levels):
    return np.asarray(levels, np.float32)


COLOURS = [(0, 0, 0), (1, 1, 1), (2, 2, 2), (100,) * 3, (255,) * 3, (10, 200, 30)]
SIZES = [(28, 28), (32, 64), (90, 160), (53, 37), (360, 640)]


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize(
    ("size", "colour"), [*(((56, 56), colour) for colour in COLOURS), *((size, (7, 7, 7)) for size in SIZES)]
)
def test_a_constant_frame_is_127_everywhere(variant, size, colour):
    assert (preprocess(variant, np.full((*size, 3), colour, np.uint8)) == 127).all()


# One level of 9 in a 3 x 3 frame. Corner: window 0 0 0 9, mean 2.25, squares 60.75. Edge: window of six, mean 1.5,
# squares 67.5. Centre: z = 8 / 2.8 or 8 / 3, clipped to 1.
# ddof 0: corner z = -2.25 / sqrt(60.75 / 4) = -0.5774, edge z = -1.5 / sqrt(67.5 / 6) = -0.4472.
# ddof 1: corner z = -2.25 / sqrt(60.75 / 3) = -0.5, edge z = -1.5 / sqrt(67.5 / 5) = -0.4082.
# Level = floor(255 (1 + z) / 2).
@pytest.mark.parametrize(("ddof", "corner", "edge"), [(0, 53, 70), (1, 63, 75)])
def test_a_window_is_cut_at_the_border(ddof, corner, edge):
    grey = floats([[[0, 0, 0], [0, 9, 0], [0, 0, 0]]])
    expected = [corner, edge, corner, edge, 255, edge, corner, edge, corner]
    assert patch_normalise(grey, 3, ddof).tolist() == [expected]


# Windows 0 4 | 0 4 8 | 4 8. ddof 0: z = -1, 0, 1. ddof 1: z = -2 / sqrt(8) = -0.7071, 0, 0.7071.
@pytest.mark.parametrize(("ddof", "expected"), [(0, [0, 127, 255]), (1, [37, 127, 217])])
def test_the_deviation_of_a_ramp_is_that_of_its_ddof(ddof, expected):
    assert patch_normalise(floats([[[0, 4, 8]]]), 3, ddof).tolist() == [expected]


@pytest.mark.parametrize(("levels", "patch"), [([[200, 200], [200, 200]], 7), ([[80]], 3)])
def test_black_beyond_the_border_is_no_part_of_a_window(levels, patch):
    assert set(patch_normalise(floats([levels]), patch, 1).ravel()) == {127}


BRIGHT = np.zeros((20, 20), np.uint8)
BRIGHT[0, :2] = 255  # the mean is 1.275, the exponent 20: beyond float32, so clipped


@pytest.mark.parametrize(
    ("levels", "expected"),
    [
        *([[[level] * 5] * 4, np.full((4, 5), 127.5)] for level in (2, 10, 127, 200, 255)),
        # The mean is 16; 4 is its square root, so it goes to the square root of 127.5; 28 would go to 339.
        ([[4, 16], [28, 16]], [[127.5**0.5, 127.5], [255, 127.5]]),
        ([[0, 1, 8, 7]], [[0, 1, 255, 255]]),  # the mean is 4
        ([[0, 255], [100, 155]], [[0, 255], [100, 155]]),  # the mean is 127.5
        *((levels, levels) for levels in ([[0, 0]], [[1, 1]], [[0, 2]], [[0, 1]])),  # at most 1
        (BRIGHT, BRIGHT),
    ],
    ids=str,
)
def test_gamma_maps_the_mean_level_to_127_and_a_half_and_clips(levels, expected):
    frame = grey_frame(levels)
    found = PatchNormalisation("C", *frame.shape[:2]).shrink(frame)
    assert found == pytest.approx(np.asarray(expected, np.float64), abs=0.01)


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_frame_whose_mean_is_exactly_1_is_accepted(variant):
    # Left as it is: the 0s and 2s of a chessboard are 2 above or below their neighbours.
    frame = grey_frame((np.indices((28, 28)).sum(axis=0) % 2) * 2)
    ddof = 1 if variant == "C" else 0
    expected = oracle.patch_normalise(frame[:, :, 0].astype(float), 7, ddof).ravel()
    assert np.abs(preprocess(variant, frame)[0].astype(int) - expected).max() <= 1


@pytest.mark.parametrize(
    "arguments", [*({"patch": patch} for patch in (0, 1, 2, 6, 8, -7)), {"height": 0}, {"width": -1}], ids=str
)
def test_a_patch_without_a_centre_or_neighbours_and_a_size_below_a_pixel_are_refused_by_name(arguments):
    ((name, value),) = arguments.items()
    with pytest.raises(BadInput, match=rf"method\.{name}={value}\b"):
        PatchNormalisation(**arguments)


@pytest.mark.parametrize(("height", "width"), [(32, 64), (90, 160), (53, 37), (28, 28)])
@pytest.mark.parametrize("target", [(28, 28), (12, 20)])
def test_variant_c_is_the_oracle_but_for_a_level_where_a_window_is_not_flat(height, width, target):
    frame = smooth_frame(height, width)
    grey = oracle.resize_bilinear(oracle.gamma_c(oracle.grey_c(frame)), *target)
    expected = oracle.patch_normalise(grey, 7, 1).astype(int)
    got = preprocess("C", frame, height=target[0], width=target[1])[0].reshape(target)
    told = oracle.local_std(grey, 7, 1) > 1e-3
    assert np.abs(got - expected)[told].max() <= 1


def test_variant_b_has_the_oracles_whole_levels():
    frame = smooth_frame(28, 28)
    expected = oracle.gamma_b(oracle.grey_b(frame))
    difference = np.abs(PatchNormalisation("B").shrink(frame) - expected)
    assert difference.max() <= 2  # near-ties of OpenCV's fixed-point grey
    assert np.count_nonzero(difference) <= 8


def test_variant_b_truncates_what_variant_c_keeps():
    frame = grey_frame([[4, 16], [28, 16]])  # the frame worked above: 11.29, 127.5, 255
    b, c = (PatchNormalisation(variant, 2, 2, 3).shrink(frame) for variant in "BC")
    assert b.tolist() == [[11, 127], [255, 127]]
    assert c == pytest.approx(np.array([[11.2916, 127.5], [255, 127.5]]), abs=0.001)


@pytest.mark.parametrize(("variant", "ddof"), [("A", 0), ("B", 0), ("C", 1)])
def test_where_grey_gamma_and_resize_do_nothing_the_variants_differ_in_the_deviation_alone(variant, ddof):
    half = np.random.default_rng(0).integers(0, 256, (14, 28))
    levels = np.vstack([half, 255 - half])  # the mean is 127.5, so gamma is the identity
    expected = oracle.patch_normalise(levels.astype(float), 7, ddof).ravel().astype(int)
    assert np.abs(preprocess(variant, grey_frame(levels))[0] - expected).max() <= 1


def test_variant_a_has_no_gamma():
    assert PatchNormalisation("A").shrink(np.full((56, 56, 3), 10, np.uint8)).tolist() == np.full((28, 28), 10).tolist()


def test_variant_a_resizes_before_it_takes_the_grey():
    # The mean colour is (1, 0.25, 1.25), rounded (1, 0, 1), grey 0.413. Grey first would give 1 in every pixel
    # (0.598, 0.587, 0.57, 0.598 rounded), and 1 after the resize.
    frame = np.array([[[2, 0, 0], [0, 1, 0]], [[0, 0, 5], [2, 0, 0]]], np.uint8)
    assert PatchNormalisation("A", 1, 1, 3).shrink(frame).tolist() == [[0]]


@pytest.mark.parametrize("variant", VARIANTS)
def test_rows_are_not_columns(variant):
    assert PatchNormalisation(variant, 12, 20).shrink(smooth_frame(32, 64)).shape == (12, 20)
    frame = grey_frame([[0, 0], [200, 200]])
    assert preprocess(variant, frame, height=2, width=2, patch=3)[0].tolist() == sorted(
        preprocess(variant, frame, height=2, width=2, patch=3)[0].tolist()
    )


@pytest.mark.parametrize("variant", VARIANTS)
def test_many_frames_give_what_each_gives_alone(variant):
    frames = [smooth_frame(20 + i % 3, 30, seed=i) for i in range(69)] + [np.zeros((90, 160, 3), np.uint8)]
    together = preprocess(variant, *frames)
    assert (together.shape, together.dtype) == ((70, 784), np.uint8)
    alone = np.concatenate([preprocess(variant, frame) for frame in frames])
    assert np.array_equal(together, alone)


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_frame_is_left_as_it_was_and_may_be_read_only(variant):
    frame = smooth_frame(28, 28)
    before = frame.copy()
    frame.setflags(write=False)
    assert preprocess(variant, frame).shape == (1, 784)
    assert np.array_equal(frame, before)
