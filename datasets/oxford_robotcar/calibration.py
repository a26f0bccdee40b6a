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

VERSION = 2  # of the pixels that `undistort` returns: a change to them raises it

_TABLE = "stereo_wide_left_distortion_lut.bin"
_WHENCE = f"copy models/{_TABLE} of https://github.com/ori-mrg/robotcar-dataset-sdk"
_FOLDERS = ("models", "robotcar-dataset-sdk/models")  # of a root
_EXACT = 4  # levels are demosaiced times this, so that means of two and of four neighbours stay exact
_ROUNDING = 1e-4  # levels that the weights' rounding may take off a whole number before its decimals are cut off


@dataclass(frozen=True)
class Camera:
    """The size of a camera's frames in pixels."""

    width: int
    height: int


STEREO_LEFT = Camera(1280, 960)


@dataclass(frozen=True, eq=False)
class Calibration:
    """Where each pixel of an undistorted frame comes from, (height, width) each."""

    camera: Camera
    sha256: str  # of the file
    x: npt.NDArray[np.float64]
    y: npt.NDArray[np.float64]


def find_calibration(root: Path, given: str | None) -> Path:
    """Return the file of the distortion table: `given`, a file or its folder, or else the file in a root.

    Raises MissingData if there is none.
    """
    path = Path(given or "").expanduser()
    named = [path / _TABLE if path.is_dir() else path]
    candidates = [root / folder / _TABLE for folder in _FOLDERS] if given is None else named
    found = next(filter(Path.is_file, candidates), None)
    if found is None:
        raise MissingData(
            f"raw frames are there, but the distortion table is not ({' and '.join(map(str, candidates))}): {_WHENCE} "
            f"to {root / _FOLDERS[0]}, or set dataset.calibration to it"
        )
    return found


def read_calibration(path: Path, camera: Camera) -> Calibration:
    """Read a distortion table: float64 (2, height * width), x and y of the source of each pixel, row after row.

    Raises BadInput if the file is none of this camera.
    """
    content = path.read_bytes()
    width, height = camera.width, camera.height
    if len(content) != 2 * 8 * width * height:
        raise BadInput(
            f"{path} holds {len(content)} bytes; the distortion table of {width} x {height} frames holds "
            f"{2 * 8 * width * height}: {_WHENCE}"
        )
    x, y = np.frombuffer(content, "<f8").reshape(2, height, width)
    inside = (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
    if inside.mean() < 0.5:
        raise BadInput(
            f"{path} is no distortion table of {width} x {height} frames (only {100 * inside.mean():.0f} % of its "
            f"points lie inside such a frame): {_WHENCE}"
        )
    return Calibration(camera, hashlib.sha256(content).hexdigest(), x, y)


def read_raw(path: Path, camera: Camera) -> npt.NDArray[np.uint8]:
    """Read a frame as the camera recorded it, (height, width), one colour a pixel; raises BadInput for any other."""
    pixels, mode = read_pixels(path)
    if mode != "L" or pixels.shape != (camera.height, camera.width):
        raise BadInput(
            f"{path} is {pixels.shape[1]} x {pixels.shape[0]} of mode {mode}; raw frames are {camera.width} x "
            f"{camera.height} of mode L (grey): restore the file as downloaded, or give processed frames another folder"
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
    """Return a raw frame (height, width) demosaiced and undistorted, (height, width, 3).

    Both are bilinear, decimals are cut off at the end alone and pixels from outside the frame are 0, as in
    robotcar-dataset-sdk 16ce332, which VPRTempo's process_orc.py calls. At the outermost pixels the demosaicing differs
    from theirs.
    """
    levels = cv2.cvtColor(raw.astype(np.uint16) * _EXACT, cv2.COLOR_BayerGBRG2RGB).astype(np.float64)
    at = calibration.y, calibration.x
    bands = [map_coordinates(levels[:, :, band], at, order=1) for band in range(3)]
    image: Image = (np.stack(bands, axis=2) / _EXACT + _ROUNDING).astype(np.uint8)
    return image
