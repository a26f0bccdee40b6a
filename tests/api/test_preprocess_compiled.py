"""The compiled preprocessing gives what the readable one gives."""

import numpy as np
import pytest
import torch
from preprocess_frames import saturated_frame, smooth_frame

from vprbench.api.images import Images
from vprbench.api.preprocess import PatchNormalisation

SIZES = [(32, 64), (90, 160), (360, 640), (20, 17), (28, 28), (53, 37), (1, 9)]
FLAT = 1e-3  # deviation over mean of a window, below which rounding noise takes part in the level


def both(frames, **arguments):
    """Levels of the fused and of the readable engine, as (n, height * width) of int."""
    images = Images.from_arrays(frames)
    return [PatchNormalisation(**arguments, engine=engine)(images).astype(int) for engine in ("fused", "readable")]


def structured(frames, patch, **arguments):
    """Which windows of the shrunk frames are not flat, (n, height * width)."""
    found = []
    for frame in frames:
        small = PatchNormalisation(**arguments).shrink(frame).astype(np.float64)
        padded = np.pad(small, patch // 2, constant_values=np.nan)
        windows = np.lib.stride_tricks.sliding_window_view(padded, (patch, patch))
        with np.errstate(invalid="ignore"):
            found.append((np.nanstd(windows, (2, 3)) > FLAT * np.nanmean(windows, (2, 3))).ravel())
    return np.stack(found)


@pytest.mark.parametrize("variant", ["A", "B", "C"])
@pytest.mark.parametrize("size", SIZES, ids=str)
def test_levels_differ_by_at_most_one_outside_flat_windows(variant, size):
    frames = [smooth_frame(*size, seed) for seed in range(3)] + [saturated_frame(*size, seed) for seed in range(3)]
    fused, readable = both(frames, variant=variant)
    away = np.abs(fused - readable)
    assert away[structured(frames, 7, variant=variant)].max() <= 1
    assert (away > 1).mean() < 0.02  # in flat windows the rounding of the processor decides


@pytest.mark.parametrize(("height", "width", "patch"), [(28, 28, 3), (12, 40, 5), (56, 56, 15), (5, 4, 7), (1, 1, 3)])
def test_any_size_and_patch_gives_the_same_levels(height, width, patch):
    frames = [smooth_frame(90, 160, seed) for seed in range(4)]
    fused, readable = both(frames, height=height, width=width, patch=patch)
    assert np.abs(fused - readable).max() <= 1


def test_threads_change_nothing():
    frames = [smooth_frame(32, 64, seed) for seed in range(200)]
    before, levels = torch.get_num_threads(), []
    try:
        for threads in (1, 2):
            torch.set_num_threads(threads)
            levels.append(PatchNormalisation()(Images.from_arrays(frames)))
    finally:
        torch.set_num_threads(before)
    assert np.array_equal(*levels)


def test_a_frame_that_cannot_be_written_or_lies_crosswise_in_memory_is_read_as_any_other():
    frame = smooth_frame(32, 64, 5)
    locked = frame.copy()
    locked.flags.writeable = False
    crosswise = np.asfortranarray(frame)
    fused = PatchNormalisation()(Images.from_arrays([frame, locked, crosswise, frame[:, ::-1][:, ::-1]]))
    assert (fused == fused[0]).all()


def test_no_frames_give_no_levels():
    assert PatchNormalisation()(Images.from_arrays([])).shape == (0, 784)
