"""RobotCar's camera: distortion tables that are none, raw frames that are none, and the colours that come of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image as PillowImage
from robotcar_download import SITES, SMALL, TABLE, bent, grid, mosaic, uniform, write_table
from scipy.ndimage import map_coordinates

from vprbench.datasets.oxford_robotcar.calibration import (
    STEREO_LEFT,
    Calibration,
    Camera,
    find_calibration,
    processed,
    read_calibration,
    read_raw,
)
from vprbench.errors import BadInput, NotThere


def calibration(folder: Path, x: np.ndarray, y: np.ndarray, camera: Camera = SMALL) -> Calibration:
    return read_calibration(write_table(folder, x, y), camera)


def noise(camera: Camera) -> np.ndarray:
    return np.random.default_rng(0).integers(0, 256, (camera.height, camera.width), dtype=np.uint8)


def slowly_demosaiced(raw: np.ndarray) -> np.ndarray:
    """Every channel of a pixel inside the frame: the mean of the nearest pixels that record it, in float64.

    Those are the pixel itself, or else its two or four neighbours at the same distance.
    """
    height, width = raw.shape
    full = np.zeros((height, width, 3))
    for y in range(1, height - 1):
        for x in range(1, width - 1):
            for channel in range(3):
                by_distance: dict[int, list[int]] = {}
                for dy, dx in np.ndindex(3, 3):
                    if SITES[(y + dy - 1) % 2, (x + dx - 1) % 2] == channel:
                        by_distance.setdefault((dy - 1) ** 2 + (dx - 1) ** 2, []).append(raw[y + dy - 1, x + dx - 1])
                full[y, x, channel] = np.mean(by_distance[min(by_distance)])
    return full


# Colours


def test_noise_is_demosaiced_to_the_mean_of_the_nearest_pixels_and_its_decimals_cut_off(tmp_path: Path) -> None:
    raw = noise(SMALL)
    seen = processed(raw, calibration(tmp_path, *grid()))
    inside = (slice(1, -1), slice(1, -1))
    np.testing.assert_array_equal(seen[inside], np.floor(slowly_demosaiced(raw)[inside]))


# Distortion


def test_half_a_pixel_is_the_mean_of_two(tmp_path: Path) -> None:
    image = uniform((0, 0, 0))
    image[:, :, 1] = 8 * np.arange(16)  # green, a ramp that demosaicing leaves as it is but at the ends
    x, y = grid()
    seen = processed(mosaic(image), calibration(tmp_path, x + 0.5, y))
    np.testing.assert_array_equal(seen[1:-1, 1:14, 1], np.tile(8 * np.arange(1, 14) + 4, (10, 1)))


@pytest.mark.parametrize("camera", [Camera(40, 30, (1, 1), (1, 1)), STEREO_LEFT], ids=["small", "full size"])
def test_a_bent_table_is_followed_as_scipy_interpolates_in_float64(tmp_path: Path, camera: Camera) -> None:
    raw = noise(camera)
    x, y = bent(camera)
    straight = processed(raw, calibration(tmp_path / "straight", *grid(camera), camera)).astype(float)
    bent_one = processed(raw, calibration(tmp_path / "bent", x, y, camera))
    exact = np.stack([map_coordinates(straight[:, :, channel], [y, x], order=1) for channel in range(3)], axis=2)
    outside = (x < 0) | (y < 0) | (x > camera.width - 1) | (y > camera.height - 1)
    assert 0.01 < outside.mean() < 0.4
    assert not bent_one[outside].any()
    # `exact` starts from levels whose decimals are cut off: it may be up to a level darker before its own are cut off.
    difference = bent_one - np.floor(exact)
    assert difference.min() >= 0
    assert difference.max() <= 1
    assert difference.mean() < 0.5


# Tables


@pytest.mark.parametrize(
    ("spoil", "told"),
    [
        (lambda table: table[:-1], "holds 3064 bytes; .* 16 x 12 frames holds 3072"),
        (lambda table: np.where(np.arange(384) == 250, np.nan, table), "not finite"),
        (lambda table: np.where(np.arange(384) == 250, np.inf, table), "not finite"),
        (lambda table: table + 1000, "only 0 %"),
        (lambda table: np.roll(table, 192), "do not grow"),
    ],
    ids=["another size", "no number", "infinity", "outside the frame", "y before x"],
)
def test_a_table_that_is_none_is_refused(tmp_path: Path, spoil, told: str) -> None:
    path = write_table(tmp_path, *grid())
    path.write_bytes(spoil(np.frombuffer(path.read_bytes())).tobytes())
    with pytest.raises(BadInput, match=f"{path} .*{told}.*robotcar-dataset-sdk"):
        read_calibration(path, SMALL)


@pytest.mark.parametrize(
    ("folder", "given"),
    [
        ("models", None),
        ("robotcar-dataset-sdk/models", None),
        ("elsewhere", "elsewhere"),
        ("elsewhere", f"elsewhere/{TABLE}"),
    ],
)
def test_the_table_is_found_in_the_root_or_where_the_option_says(
    tmp_path: Path, folder: str, given: str | None
) -> None:
    if given:
        write_table(tmp_path / "models", *grid())
    path = write_table(tmp_path / folder, *grid())
    assert find_calibration(tmp_path, given and str(tmp_path / given)) == path


@pytest.mark.parametrize("given", [None, "elsewhere"])
def test_a_missing_table_is_answered_with_where_it_was_looked_for_and_where_to_get_it(
    tmp_path: Path, given: str | None
) -> None:
    with pytest.raises(NotThere) as error:
        find_calibration(tmp_path, given and str(tmp_path / given))
    message = str(error.value)
    assert str(tmp_path / (given or f"robotcar-dataset-sdk/models/{TABLE}")) in message
    assert "https://github.com/ori-mrg/robotcar-dataset-sdk" in message
    assert "dataset.calibration" in message


# Raw frames


@pytest.mark.parametrize(
    ("mode", "size", "told"),
    [
        ("RGB", (16, 12), "is of mode RGB"),
        ("I;16", (16, 12), "is of mode I;16"),
        ("L", (12, 16), "is 12 x 16; raw frames are 16 x 12"),
        ("", (0, 0), "cannot be read as an image"),
    ],
)
def test_a_file_that_is_no_raw_frame_is_named_with_what_it_is(tmp_path: Path, mode, size, told) -> None:
    path = tmp_path / "frame.png"
    PillowImage.fromarray(noise(SMALL)).save(path)
    path.write_bytes(path.read_bytes()[:-40])
    if mode:
        PillowImage.new(mode, size).save(path)
    with pytest.raises(BadInput, match=f"{path} {told}"):
        read_raw(path, SMALL)


def test_at_the_last_pixel_the_frame_ends_but_does_not_lie_outside(tmp_path: Path) -> None:
    x, y = grid()
    seen = processed(mosaic(uniform((90, 80, 70))), calibration(tmp_path, np.minimum(x + 0.75, 15), y))
    np.testing.assert_array_equal(seen, uniform((90, 80, 70)))
