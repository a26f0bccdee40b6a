"""Processed frames kept on disk: each names its raw frame and calibration, and is made anew if they differ."""

from __future__ import annotations

import hashlib
import io
import json
import logging
import threading
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image as PillowImage
from PIL.PngImagePlugin import PngInfo

from vprbench.api import Decoding, Image, Images, open_image, replace_bytes

from .calibration import VERSION, Calibration, read_raw, undistorted

logger = logging.getLogger(__name__)

RECORD = "vprbench.json"  # stands beside frames that we processed
_MARK = "vprbench"  # the text of a frame's PNG that says what it was made of
_COMPRESSION = 1  # the fastest

#: How the frames of the published lists are decoded.
PUBLISHED = Decoding(exif="ignore")


class KeptFrames:
    """Raw frames of one calibration, processed when they are looked at, and kept.

    A kept frame is taken if it was made of the same raw frame with the same calibration, by the same code. Several
    threads and processes may read and write at once. A disk that refuses costs what would have been kept, never the
    frames: it is said once.
    """

    def __init__(self, calibration: Calibration, folders: Mapping[Path, Path]) -> None:
        """Keep processed frames in the folders that `folders` names by the folder that the raw ones are in."""
        self._calibration = calibration
        self._folders = folders
        self._one_at_a_time = threading.Lock()
        self._recorded: set[Path] = set()  # the folders that say how their frames were made
        self._refused = False

    def images(self, paths: Sequence[Path]) -> Images:
        """Return images of files, the raw frames among them processed and the others as they are.

        Reading raises BadInput for a file that is no raw frame.
        """
        files = Images.from_files(paths, PUBLISHED)
        made_with = f"{self._calibration.sha256} {VERSION}".encode()

        def read(i: int) -> Image:
            folder = self._folders.get(paths[i].parent)
            if folder is None:
                return files[i]
            mark = {"raw": files[i : i + 1].content_hash(), "calibration": self._calibration.sha256, "version": VERSION}
            path = folder / paths[i].name
            image = _read(path, mark)
            if image is None:
                image = undistorted(read_raw(paths[i], self._calibration.camera), self._calibration)
                self._keep(path, image, mark)
            return image

        def besides(i: int) -> bytes:
            return made_with if paths[i].parent in self._folders else b""

        return Images(read, files.names, files=paths, stamp=besides, content=besides)

    def _keep(self, path: Path, image: Image, mark: Mapping[str, Any]) -> None:
        if self._refused:
            return
        try:
            self._record(path.parent)
            _write(path, image, mark)
        except OSError as error:
            with self._one_at_a_time:
                told, self._refused = self._refused, True
            advice = "each is processed whenever it is read; make room, or set dataset.processed to another folder"
            if not told:
                why = error.strerror or error
                logger.warning("processed frames cannot be kept in %s (%s): %s", path.parent, why, advice)

    def _record(self, folder: Path) -> None:
        """Say beside the frames how they were made, before the first of them is there."""
        with self._one_at_a_time:
            if folder in self._recorded:
                return
            content = {
                "what": "frames of stereo/left, demosaiced and undistorted by vprbench",
                "calibration_sha256": self._calibration.sha256,
                "code_version": VERSION,
                **asdict(self._calibration.camera),
            }
            folder.mkdir(parents=True, exist_ok=True)
            replace_bytes(folder / RECORD, f"{json.dumps(content, indent=1)}\n".encode())
            self._recorded.add(folder)


def recorded_calibration(folder: Path) -> str | None:
    """Return the hash of the calibration that our frames in a folder were last made with; None if none are ours."""
    try:
        return str(json.loads((folder / RECORD).read_text("utf-8"))["calibration_sha256"])
    except (OSError, ValueError, KeyError, TypeError):
        return None


def is_made_with(path: Path, calibration: str) -> bool:
    """Tell whether a file is a frame that we made with the calibration of this hash."""
    try:
        with open_image(path) as image:
            return bool(_mark(image)["calibration"] == calibration)
    except Exception:  # a damaged file may upset its reader in any way
        return False


def _read(path: Path, wanted: Mapping[str, Any]) -> Image | None:
    """Return a frame that was kept; None if it is missing, damaged or made of something else."""
    try:
        with open_image(path) as image:
            mark = _mark(image)
            pixels = mark.pop("pixels")
            if mark != wanted or image.mode != "RGB":
                return None
            frame = np.asarray(image)
    except Exception:  # there is none, or a damaged file upset its reader in any way: it is made anew
        return None
    return frame if _digest(frame) == pixels else None


def _write(path: Path, image: Image, mark: Mapping[str, Any]) -> None:
    """Write a frame so that a reader sees all of it or none."""
    text, content = PngInfo(), io.BytesIO()
    text.add_text(_MARK, json.dumps({**mark, "pixels": _digest(image)}))
    PillowImage.fromarray(image).save(content, "PNG", pnginfo=text, compress_level=_COMPRESSION)
    replace_bytes(path, content.getvalue())


def _mark(image: PillowImage.Image) -> dict[str, Any]:
    return dict(json.loads(image.info[_MARK]))


def _digest(image: Image) -> str:
    return hashlib.sha256(np.ascontiguousarray(image).data).hexdigest()
