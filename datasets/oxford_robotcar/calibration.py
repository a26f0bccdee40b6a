"""The stereo camera's left eye: its calibration, and frames as it recorded them made into upright colour pictures."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
from scipy.ndimage import map_coordinates

from vprbench.api import BadInput, Image, MissingData, open_image

WIDTH, HEIGHT = 1280, 960  # of the camera's frames
VERSION = 2  # of the pixels that `undistort` returns: a change to them raises it

_TABLE = "stereo_wide_left_distortion_lut.bin"
_WHENCE = f"copy models/{_TABLE} of https://github.com/ori-mrg/robotcar-dataset-sdk"
_EXACT = 4  # levels are demosaiced times this, so that means of two and of four neighbours stay exact
_ROUNDING = 1e-4  # levels that the weights' rounding may take off a whole number before its decimals are cut off


@dataclass(frozen=True, eq=False)
class Calibration:
    """Where each pixel of an undistorted frame comes from, (HEIGHT, WIDTH) each."""

    sha256: str  # of the file
    x: npt.NDArray[np.float64]
    y: npt.NDArray[np.float64]


def find_calibration(root: Path, given: str | None) -> Path:
    """Return the file of the distortion table: `given`, a file or its folder, or else the file in `<root>/models`.

    Raises MissingData if there is none.
    """
    path = root / "models" / _TABLE if given is None else Path(given).expanduser()
    file = path / _TABLE if path.is_dir() else path
    if not file.is_file():
        raise MissingData(
            f"raw frames are there, but the distortion table is not ({file}): {_WHENCE} to {root / 'models'}, or set "
            "dataset.calibration to it"
        )
    return file


def read_calibration(path: Path) -> Calibration:
    """Read a distortion table: float64 (2, HEIGHT * WIDTH), x and y of the source of each pixel, row after row.

    Raises BadInput if the file is no such table.
    """
    content = path.read_bytes()
    n_bytes = 2 * 8 * WIDTH * HEIGHT
    if len(content) != n_bytes:
        raise BadInput(
            f"{path} holds {len(content)} bytes; the distortion table of {WIDTH} x {HEIGHT} frames holds {n_bytes}: "
            f"{_WHENCE}"
        )
    x, y = np.frombuffer(content, "<f8").reshape(2, HEIGHT, WIDTH)
    inside = (x >= 0) & (x <= WIDTH - 1) & (y >= 0) & (y <= HEIGHT - 1)
    if inside.mean() < 0.5:
        raise BadInput(
            f"{path} is no distortion table of {WIDTH} x {HEIGHT} frames (only {100 * inside.mean():.0f} % of its "
            f"points lie inside such a frame): {_WHENCE}"
        )
    return Calibration(hashlib.sha256(content).hexdigest(), x, y)


def read_raw(path: Path) -> npt.NDArray[np.uint8]:
    """Read a frame as the camera recorded it, (HEIGHT, WIDTH), one colour a pixel; raises BadInput for any other."""
    pixels, mode = read_pixels(path)
    if mode != "L" or pixels.shape != (HEIGHT, WIDTH):
        raise BadInput(
            f"{path} is {pixels.shape[1]} x {pixels.shape[0]} of mode {mode}; raw frames are {WIDTH} x {HEIGHT} "
            "of mode L (grey): restore the file as downloaded, or give processed frames another folder"
        )
    return pixels


def read_pixels(path: Path) -> tuple[npt.NDArray[np.uint8], str]:
    """Return the pixels of a frame and Pillow's mode of it; raises BadInput for a file that is no image."""
    try:
        with open_image(path) as image:
            return np.asarray(image), image.mode
    except (OSError, SyntaxError) as error:
        raise BadInput(f"{path} cannot be read as an image ({error}): restore the file; none is skipped") from error


def undistort(raw: npt.NDArray[np.uint8], calibration: Calibration) -> Image:
    """Return a raw frame (HEIGHT, WIDTH) demosaiced and undistorted, (HEIGHT, WIDTH, 3).

    Both are bilinear, decimals are cut off at the end alone and pixels from outside the frame are 0, as in
    robotcar-dataset-sdk 16ce332, which VPRTempo's process_orc.py calls. At the outermost pixels the demosaicing differs
    from theirs.
    """
    levels = cv2.cvtColor(raw.astype(np.uint16) * _EXACT, cv2.COLOR_BayerGBRG2RGB).astype(np.float64)
    at = calibration.y, calibration.x
    bands = [map_coordinates(levels[:, :, band], at, order=1) for band in range(3)]
    image: Image = (np.stack(bands, axis=2) / _EXACT + _ROUNDING).astype(np.uint8)
    return image
