"""Frames that are costly to make, kept on disk as they are: whoever needs them next reads instead of making them."""

from __future__ import annotations

import hashlib
import json
import logging
import shutil
import threading
import zlib
from collections import OrderedDict
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from vprbench.api.arrays import Image
from vprbench.api.images import Images
from vprbench.errors import BadInput
from vprbench.storage.atomic import remove_leftovers, replace_bytes
from vprbench.storage.folders import cache_folder

logger = logging.getLogger(__name__)

FORMAT = 1
_FOLDER = "VPRBENCH_FRAMES"  # environment variable
_MOST_BYTES = 1 << 30  # of all frames that are kept
_FEWEST = 256  # frames that are worth keeping
_TOGETHER = 64  # frames in a file
_UNFINISHED = 8  # files for which frames are collected at once: bounds the memory
_CHECK_BYTES = 4

_keeping: ContextVar[bool] = ContextVar("frames_are_kept", default=True)
Frames = npt.NDArray[np.uint8]  # (n_frames, height, width, 3)


@contextmanager
def frames_kept(wanted: bool) -> Iterator[None]:
    """Let the images that are built inside the block keep their frames, or make each whenever it is looked at."""
    token = _keeping.set(wanted)
    try:
        yield
    finally:
        _keeping.reset(token)


def are_kept() -> bool:
    """Tell whether images that are built now may keep their frames."""
    return _keeping.get()


def kept_frames(images: Images, what: Mapping[str, Any]) -> Images:
    """Return images of equal shape that are kept in VPRBENCH_FRAMES, or a folder in the user's cache, once made.

    `what` (plain JSON) is all that decides about the frames besides their names: others have a folder of their own. A
    file holds several frames, and is written once all of them were looked at. What is kept stays below 1 GiB; who was
    not read for longest makes room. A missing or damaged file, or a full disk, costs time alone. Few frames, and more
    than fit, are not kept.
    """
    if len(images) < _FEWEST or not _keeping.get():
        return images
    text = json.dumps({"format": FORMAT, "what": what, "names": images.names}, sort_keys=True)
    try:
        folder = cache_folder(_FOLDER, "frames") / hashlib.sha256(text.encode()).hexdigest()
    except BadInput:  # nobody knows a home
        return images
    return Images(_Kept(images, folder).read, images.names)


class _Kept:
    """The frames of one sequence; several threads and processes may read them and keep them."""

    def __init__(self, images: Images, folder: Path) -> None:
        self._images, self._folder = images, folder
        self._one_at_a_time = threading.Lock()
        self._shape: tuple[int, ...] | None = None  # of a frame
        self._files: dict[int, Frames | None] = {}  # mapped into memory; None: to be written
        self._collected: OrderedDict[int, dict[int, Image]] = OrderedDict()
        self._refused = False

    def read(self, number: int) -> Image:
        """Return a frame, from its file or made anew."""
        at, within = divmod(number, _TOGETHER)
        with self._one_at_a_time:
            if self._shape is None:
                self._begin()
            if at not in self._files:
                self._files[at] = self._mapped(at)
            file = self._files[at]
        if file is not None:
            return np.array(file[within])
        image = self._images[number]
        with self._one_at_a_time:
            self._collect(at, within, image)
        return image

    def _begin(self) -> None:
        self._shape = self._images[0].shape
        n_bytes = len(self._images) * int(np.prod(self._shape))
        self._refused = n_bytes > _MOST_BYTES
        if self._refused:
            return
        with suppress(OSError):
            self._folder.mkdir(parents=True, exist_ok=True)
            self._folder.touch()  # read now
            remove_leftovers(self._folder)
            _make_room(self._folder, _MOST_BYTES - n_bytes)

    def _path(self, at: int) -> Path:
        return self._folder / f"{at:05d}.frames"

    def _mapped(self, at: int) -> Frames | None:
        """Return the frames of a file; None if it is missing or not what was written."""
        assert self._shape is not None
        shape = (min(_TOGETHER, len(self._images) - at * _TOGETHER), *self._shape)
        try:
            content = np.memmap(self._path(at), np.uint8, "r")
        except (OSError, ValueError):
            return None
        frames, check = content[:-_CHECK_BYTES], content[-_CHECK_BYTES:]
        if len(frames) != np.prod(shape) or _check(frames) != bytes(check):
            return None
        return frames.reshape(shape)

    def _collect(self, at: int, within: int, image: Image) -> None:
        """Take a frame that was made, and write those of its file once all are there."""
        if self._refused or self._files.get(at) is not None:
            return
        frames = self._collected.setdefault(at, {})
        frames[within] = image
        if len(frames) == min(_TOGETHER, len(self._images) - at * _TOGETHER):
            del self._collected[at]
            content = np.stack([frames[number] for number in range(len(frames))])
            try:
                replace_bytes(self._path(at), content.tobytes() + _check(content))
                self._files[at] = self._mapped(at)  # who looks at them again makes none anew
            except OSError as error:
                self._refused = True
                logger.info("frames are not kept in %s: %s", self._folder, error.strerror or error)
        elif len(self._collected) > _UNFINISHED:
            self._collected.popitem(last=False)


def _check(frames: Frames) -> bytes:
    return zlib.crc32(np.ascontiguousarray(frames).data).to_bytes(_CHECK_BYTES, "little")


def _make_room(own: Path, most_bytes: int) -> None:
    """Remove the folders of frames that were not read for longest, until all but `own` have at most so many bytes."""
    others = [folder for folder in own.parent.iterdir() if folder != own and len(folder.name) == len(own.name)]
    sizes = {folder: sum(file.stat().st_size for file in folder.iterdir()) for folder in others}
    for folder in sorted(others, key=lambda folder: folder.stat().st_mtime):
        if sum(sizes.values()) <= most_bytes:
            break
        shutil.rmtree(folder, ignore_errors=True)
        del sizes[folder]
