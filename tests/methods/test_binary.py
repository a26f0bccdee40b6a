"""Bits of Gabor filters and oriented edges, and the descriptor that they are cut from."""

import numpy as np
import pytest
from preprocess_frames import smooth_frame

from vprbench.api import BadInput, GaborBank, Images
from vprbench.methods.binary import GaborBinary, OrientedBinary, strongest
from vprbench.methods.gabor import Gabor

FRAMES = Images.from_arrays([smooth_frame(32, 64, seed) for seed in range(6)])
BY_CELL = GaborBinary(height=28, width=28, patch=7, within="cell", shares=[0.25])

VALUES = np.array([[[0.9, 0.1], [0.5, 0.0], [0.7, 0.3], [0.0, 0.2]]], np.float32)  # 4 cells of 2 maps


@pytest.mark.parametrize(
    ("within", "shares", "wanted"),
    [
        ("map", [0.25], [[1, 0], [0, 0], [0, 1], [0, 0]]),
        ("map", [1.0], [[1, 1], [1, 0], [1, 1], [0, 1]]),  # nothing is never strong
        ("map", [0.5, 0.25], [[1, 0], [0, 0], [1, 1], [0, 1], [1, 0], [0, 0], [0, 1], [0, 0]]),
        ("cell", [0.5], [[1, 0], [1, 0], [1, 0], [0, 1]]),
        ("cell", [0.01], [[1, 0], [1, 0], [1, 0], [0, 1]]),  # one at least
    ],
)
def test_bits_are_the_strongest_of_a_map_or_of_a_cell(within, shares, wanted):
    assert strongest(VALUES, within, shares).astype(int).tolist() == [np.ravel(wanted).tolist()]
    for nothing in ([], [0.0], [0.5, 1.2]):
        with pytest.raises(BadInput, match=r"method\.shares=\["):
            strongest(VALUES, within, nothing)


@pytest.mark.parametrize(("method", "n_bits"), [(GaborBinary(), 13440), (BY_CELL, 4608), (OrientedBinary(), 4608)])
def test_a_map_holds_one_bit_for_each_value_and_says_so(method, n_bits):
    method.fit(FRAMES, np.arange(6))
    assert method.encode(FRAMES).shape == (6, n_bits / 64)
    assert method.notes() == [f"binary codes: {n_bits // 8:,} bytes a place"]
    assert method.query(FRAMES).argmax(1).tolist() == [*range(6)]
    assert np.diag(method.query(FRAMES)).tolist() == [0] * 6


def test_bits_of_a_cell_are_those_of_its_8_strongest_filters():
    bits = np.unpackbits(BY_CELL.encode(FRAMES).view(np.uint8), axis=1).reshape(6, 144, 32).astype(bool)
    codes = GaborBank(28, 28, 7)(FRAMES).reshape(6, 144, 32)
    for own, code in zip(bits.reshape(-1, 32), codes.reshape(-1, 32), strict=True):
        if own.any() and not own.all():
            assert code[own].min() >= code[~own].max()
    assert np.median(bits.sum(2)) == 8


def test_a_black_image_differs_from_nothing_by_its_bits_and_has_no_direction():
    black = Images.from_arrays([np.zeros((32, 64, 3), np.uint8)])
    assert not GaborBinary().encode(black).any()
    assert not OrientedBinary().encode(black).any()
    assert not Gabor().fit(FRAMES, np.arange(6)).query(black).any()


def test_gabor_scores_are_cosines_of_codes_or_of_the_responses_as_they_are():
    for normalised in (True, False):
        rows = GaborBank()(FRAMES) if normalised else GaborBank().responses(FRAMES).reshape(6, -1)
        directions = rows.astype(np.float64) / np.linalg.norm(rows.astype(np.float64), axis=1, keepdims=True)
        scores = Gabor(normalised=normalised).fit(FRAMES, np.arange(6)).query(FRAMES)
        np.testing.assert_allclose(scores, directions @ directions.T, atol=1e-5)
