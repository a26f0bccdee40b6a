"""The bank of Gabor filters against loops over pixels and cells that follow the published formula."""

import itertools
import math

import numpy as np
import pytest
from preprocess_frames import saturated_frame, smooth_frame

from vprbench.api.gabor import GaborBank, gabor_filters
from vprbench.api.images import Images
from vprbench.api.preprocess import PatchNormalisation

FRAMES = [smooth_frame(90, 160, seed) for seed in range(3)] + [saturated_frame(32, 64, seed) for seed in range(3)]


def filter_by_hand(angle, wavelength, phase, width):
    """One filter of 5x5 pixels, a number at a time."""
    wave = []
    for y in range(-2, 3):
        for x in range(-2, 3):
            across, along = x * math.cos(angle) + y * math.sin(angle), y * math.cos(angle) - x * math.sin(angle)
            envelope = math.exp(-(across**2 + 0.25 * along**2) / (2 * width**2))
            wave.append(envelope * math.cos(2 * math.pi * across / wavelength + phase))
    mean = sum(wave) / 25
    size = sum(abs(value - mean) for value in wave)
    return [(value - mean) / size for value in wave]


FILTERS = [
    filter_by_hand(quarter * math.pi / 4, *others)
    for quarter in range(4)
    for others in itertools.product((2.25, 3), (0, math.pi / 2), (1, 2))
]


def by_hand(levels, block, epsilon):
    """The codes of patch-normalised frames (n, h, w) before anything is clipped, (n, rows * columns * 32)."""
    windows = np.lib.stride_tricks.sliding_window_view(levels / 255, (5, 5), (1, 2)).reshape(
        *levels[:, 4:, 4:].shape, 25
    )
    waves = windows @ np.transpose(FILTERS)
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


def test_the_filters_are_32_different_waves_of_zero_mean_and_norm_1():
    assert gabor_filters().shape == (32, 5, 5)
    np.testing.assert_allclose(gabor_filters().reshape(32, 25), FILTERS, atol=1e-6)
    alike = np.abs(np.corrcoef(gabor_filters().reshape(32, 25))) - np.eye(32)
    assert alike.max() < 0.999


@pytest.mark.parametrize("engine", ["fused", "readable"])
@pytest.mark.parametrize(("block", "epsilon"), [(1, 0.3), (3, 0.1), (7, 0.01)])
def test_codes_are_those_of_the_formula(engine, block, epsilon):
    images = Images.from_arrays(FRAMES[2:5])
    codes = GaborBank(10, 13, 5, block, epsilon, engine=engine)(images)
    levels = PatchNormalisation("C", 10, 13, 5, engine)(images).reshape(3, 10, 13)
    wanted = by_hand(levels.astype(float), block, epsilon)
    np.testing.assert_allclose(codes, np.clip(wanted, 0, 1), atol=2e-5)
    assert 0.05 < np.mean(np.clip(wanted, 0, 1) != wanted) < 0.95  # some are clipped


def test_the_compiled_engine_gives_what_the_readable_one_gives_within_0_and_1():
    images = Images.from_arrays([*FRAMES, *(np.full((48, 64, 3), level, np.uint8) for level in (0, 97, 255))])
    fused, readable = (GaborBank(thresholds=(0.01,) * 32, engine=engine)(images) for engine in ("fused", "readable"))
    # In flat windows the rounding of the patch normalisation decides, and there the engines may differ by a level.
    assert np.median(np.abs(fused - readable)) < 1e-6
    assert np.abs(fused - readable).mean() < 1e-3
    assert fused.shape == (9, GaborBank().n_inputs) == (9, 14 * 30 * 32)
    assert (fused.min(), fused.max()) == (0, 1)
    assert not fused[6:].any()


def test_adapted_thresholds_give_each_filter_its_share_of_active_cells():
    images = Images.from_arrays(FRAMES * 3)
    active = (GaborBank().adapted(images, 0.2, 0.9)(images).reshape(-1, 32) > 0).mean(0)
    np.testing.assert_allclose(active, np.linspace(0.2, 0.9, 32), atol=0.01)
