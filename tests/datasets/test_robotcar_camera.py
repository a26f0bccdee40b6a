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
    check_raw,
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


@pytest.mark.parametrize("colour", [(255, 0, 0), (0, 255, 0), (0, 0, 255), (200, 100, 50)])
def test_a_patch_of_one_colour_comes_back_in_that_colour(tmp_path: Path, colour: tuple[int, int, int]) -> None:
    image = uniform(colour)
    np.testing.assert_array_equal(processed(mosaic(image), calibration(tmp_path, *grid())), image)


def test_two_patches_keep_their_colours_but_for_the_pixels_where_they_meet(tmp_path: Path) -> None:
    image = uniform((220, 30, 90))
    image[:, 8:] = (10, 180, 60)
    seen = processed(mosaic(image), calibration(tmp_path, *grid()))
    np.testing.assert_array_equal(seen[:, :7], image[:, :7])
    np.testing.assert_array_equal(seen[:, 9:], image[:, 9:])


def test_noise_is_demosaiced_to_the_mean_of_the_nearest_pixels_and_its_decimals_cut_off(tmp_path: Path) -> None:
    raw = noise(SMALL)
    seen = processed(raw, calibration(tmp_path, *grid()))
    inside = (slice(1, -1), slice(1, -1))
    np.testing.assert_array_equal(seen[inside], np.floor(slowly_demosaiced(raw)[inside]))


# Distortion


def test_a_table_that_shifts_by_whole_pixels_shifts_the_frame_and_leaves_0_outside(tmp_path: Path) -> None:
    raw = noise(SMALL)
    x, y = grid()
    straight = processed(raw, calibration(tmp_path / "straight", x, y))
    shifted = processed(raw, calibration(tmp_path / "shifted", x + 2, y + 1))
    np.testing.assert_array_equal(shifted[:-1, :-2], straight[1:, 2:])
    assert not shifted[-1].any()
    assert not shifted[:, -2:].any()


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


def refusal(path: Path) -> str:
    with pytest.raises(BadInput) as error:
        read_calibration(path, SMALL)
    message = str(error.value)
    assert str(path) in message
    assert "https://github.com/ori-mrg/robotcar-dataset-sdk" in message
    return message


def test_a_table_of_another_size_is_refused_with_both_sizes(tmp_path: Path) -> None:
    path = write_table(tmp_path, *grid())
    path.write_bytes(path.read_bytes()[:-8])
    assert "holds 3064 bytes; the distortion table of 16 x 12 frames holds 3072" in refusal(path)


@pytest.mark.parametrize("wrong", [np.nan, np.inf])
def test_a_table_with_a_number_that_is_none_is_refused(tmp_path: Path, wrong: float) -> None:
    x, y = grid()
    y[3, 4] = wrong
    assert "not finite" in refusal(write_table(tmp_path, x, y))


def test_a_table_that_points_outside_the_frame_is_refused(tmp_path: Path) -> None:
    x, y = grid()
    assert "only 0 % of its points lie inside" in refusal(write_table(tmp_path, x + 1000, y))


def test_a_table_with_y_before_x_is_refused(tmp_path: Path) -> None:
    x, y = grid()
    assert "x do not grow to the right" in refusal(write_table(tmp_path, y, x))


@pytest.mark.parametrize("folder", ["models", "robotcar-dataset-sdk/models"])
def test_the_table_is_found_in_the_root(tmp_path: Path, folder: str) -> None:
    path = write_table(tmp_path / folder, *grid())
    assert find_calibration(tmp_path, None) == path


@pytest.mark.parametrize("named", ["", TABLE])
def test_a_table_that_is_named_by_file_or_folder_comes_before_that_of_the_root(tmp_path: Path, named: str) -> None:
    write_table(tmp_path / "models", *grid())
    path = write_table(tmp_path / "elsewhere", *grid())
    assert find_calibration(tmp_path, str(tmp_path / "elsewhere" / named)) == path


@pytest.mark.parametrize("given", [None, "elsewhere"])
def test_a_missing_table_is_answered_with_where_it_was_looked_for_and_where_to_get_it(
    tmp_path: Path, given: str | None
) -> None:
    with pytest.raises(NotThere) as error:
        find_calibration(tmp_path, given and str(tmp_path / given))
    message = str(error.value)
    assert str(tmp_path / (given or f"robotcar-dataset-sdk/models/{TABLE}")) in message
    assert f"copy models/{TABLE} of https://github.com/ori-mrg/robotcar-dataset-sdk to {tmp_path / 'models'}" in message
    assert "dataset.calibration" in message


# Raw frames


def saved(path: Path, image: PillowImage.Image) -> Path:
    image.save(path)
    return path


@pytest.mark.parametrize("reader", [check_raw, read_raw])
@pytest.mark.parametrize(
    ("image", "told"),
    [
        (PillowImage.new("RGB", (16, 12)), "is of mode RGB among raw frames"),
        (PillowImage.new("I;16", (16, 12)), "is of mode I;16 among raw frames"),
        (PillowImage.new("L", (12, 16)), "is 12 x 16; raw frames are 16 x 12"),
    ],
)
def test_a_file_that_is_no_raw_frame_is_named_with_what_it_is(reader, image, told, tmp_path: Path) -> None:
    path = saved(tmp_path / "frame.png", image)
    with pytest.raises(BadInput) as error:
        reader(path, SMALL)
    assert f"{path} {told}" in str(error.value)


def test_a_truncated_raw_frame_is_named(tmp_path: Path) -> None:
    path = saved(tmp_path / "frame.png", PillowImage.fromarray(noise(SMALL)))
    path.write_bytes(path.read_bytes()[:-40])
    with pytest.raises(BadInput, match="cannot be read as an image") as error:
        read_raw(path, SMALL)
    assert str(path) in str(error.value)


def test_at_the_last_pixel_the_frame_ends_but_does_not_lie_outside(tmp_path: Path) -> None:
    x, y = grid()
    seen = processed(mosaic(uniform((90, 80, 70))), calibration(tmp_path, np.minimum(x + 0.75, 15), y))
    np.testing.assert_array_equal(seen, uniform((90, 80, 70)))
