"""The stereo camera's left eye: its calibration, and frames as it recorded them made into upright colour pictures."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
from PIL import Image as PillowImage

from vprbench.api import BadInput, Image, MissingData, open_image

from .undistortion import undistort

VERSION = 1  # of what `undistorted` does: a change to its pixels raises it

_TABLE = "stereo_wide_left_distortion_lut.bin"
_WHENCE = f"copy models/{_TABLE} of https://github.com/ori-mrg/robotcar-dataset-sdk"
_FOLDERS = ("models", "robotcar-dataset-sdk/models")  # of a root
_EXACT = 4  # levels are demosaiced times this, so that means of two and of four neighbours stay exact


@dataclass(frozen=True)
class Camera:
    """The size of a camera's frames, and of its undistorted frames focal lengths and principal point; in pixels."""

    width: int
    height: int
    focal_lengths: tuple[float, float]  # x, y
    principal_point: tuple[float, float]


STEREO_LEFT = Camera(1280, 960, (983.044006, 983.044006), (643.646973, 493.378998))


@dataclass(frozen=True, eq=False)
class Calibration:
    """Where each pixel of an undistorted frame comes from; arrays are (height * width,), row after row."""

    camera: Camera
    sha256: str  # of the file
    source: npt.NDArray[np.int32]  # the upper left of the four pixels between which it lies; -1: outside
    right: npt.NDArray[np.float32]  # how far it lies right of that, 0 to 1
    down: npt.NDArray[np.float32]


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
    try:
        content = path.read_bytes()
    except OSError as error:
        raise BadInput(f"{path} cannot be read ({error.strerror}): {_WHENCE}") from error
    width, height = camera.width, camera.height
    wanted = 2 * 8 * width * height
    if len(content) != wanted:
        raise BadInput(
            f"{path} holds {len(content)} bytes; the distortion table of {width} x {height} frames holds {wanted}: "
            f"{_WHENCE}"
        )
    x, y = np.frombuffer(content, "<f8").reshape(2, -1)
    if not (np.isfinite(x).all() and np.isfinite(y).all()):
        raise BadInput(f"{path} holds numbers that are not finite: {_WHENCE}")
    inside = (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
    if inside.mean() < 0.5:
        raise BadInput(
            f"{path} is no distortion table of {width} x {height} frames (only {100 * inside.mean():.0f} % of its "
            f"points lie inside such a frame): {_WHENCE}"
        )
    if _growth(x.reshape(height, width)) < width / 8 or _growth(y.reshape(height, width).T) < height / 8:
        raise BadInput(f"{path} is no distortion table (its x do not grow to the right and y downwards): {_WHENCE}")
    column = np.clip(np.floor(np.where(inside, x, 0)), 0, width - 2).astype(np.int32)
    row = np.clip(np.floor(np.where(inside, y, 0)), 0, height - 2).astype(np.int32)
    return Calibration(
        camera,
        hashlib.sha256(content).hexdigest(),
        np.where(inside, row * np.int32(width) + column, np.int32(-1)),
        np.where(inside, x - column, 0).astype(np.float32),
        np.where(inside, y - row, 0).astype(np.float32),
    )


@contextmanager
def opened(path: Path) -> Iterator[PillowImage.Image]:
    """Open a frame; raises BadInput, in the caller's reading too, for a file that is no image."""
    try:
        with open_image(path) as image:
            yield image
    except (OSError, SyntaxError) as error:
        reason = str(error).replace(str(path), "it").splitlines()[0]
        raise BadInput(f"{path} cannot be read as an image ({reason}): restore the file; none is skipped") from error


def read_raw(path: Path, camera: Camera) -> npt.NDArray[np.uint8]:
    """Read a frame as the camera recorded it, (height, width), one colour a pixel; raises BadInput for any other."""
    with opened(path) as image:
        if image.mode != "L":
            raise BadInput(
                f"{path} is of mode {image.mode} among raw frames, which are grey with 8 bit (mode L): restore the "
                "file as downloaded, or give processed frames a folder of their own"
            )
        if image.size != (camera.width, camera.height):
            raise BadInput(
                f"{path} is {image.width} x {image.height}; raw frames are {camera.width} x {camera.height}: restore "
                "the file as downloaded"
            )
        return np.asarray(image)


def undistorted(raw: npt.NDArray[np.uint8], calibration: Calibration) -> Image:
    """Return a raw frame (height, width) demosaiced and undistorted, (height, width, 3).

    Both are bilinear, decimals are cut off at the end alone and pixels from outside the frame are 0, as in
    robotcar-dataset-sdk 16ce332, which VPRTempo's process_orc.py calls. At the outermost pixels the demosaicing differs
    from theirs.
    """
    levels = cv2.cvtColor(raw.astype(np.uint16) * _EXACT, cv2.COLOR_BayerGBRG2RGB)
    image = np.empty((len(calibration.source), 3), np.uint8)
    undistort(
        np.ascontiguousarray(levels, np.uint16).reshape(-1, 3),
        raw.shape[1],
        calibration.source,
        calibration.right,
        calibration.down,
        1 / _EXACT,
        image,
    )
    return image.reshape(*raw.shape, 3)


def _growth(values: npt.NDArray[np.float64]) -> float:
    """Return how much larger the right half of a table is than the left one, in the mean."""
    middle = values.shape[1] // 2
    return float(values[:, middle:].mean() - values[:, :middle].mean())
