"""One pass over the frames of a traverse: the facts that checks need are kept, the frames are not."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from vprbench import progress
from vprbench.api.arrays import Image
from vprbench.api.images import Images
from vprbench.errors import BadInput
from vprbench.storage.cores import core_count

from .offsets import HEIGHT, WIDTH, Small

#: Mean grey value, of 255, below which a frame is black: of Nordland's tunnels, not of its winter or of a night drive.
BLACK_MEAN = 16.0
#: Standard deviation of the grey values, of 255, below which a frame shows nothing.
UNIFORM_STD = 3.0
#: Grey levels of 256 below which little of a frame is left, as of 12 bits read as 16.
FEW_LEVELS = 32

_GREY_STEP = 4  # every so many-th pixel tells whether a frame has colours
_READERS = min(8, core_count())

Which = npt.NDArray[np.bool_]  # (n,), of the frames
_Look = tuple[bytes, tuple[int, int], bool, float, float, int, Small]  # of a frame, in the order of the fields of Looks
_NOTHING: _Look = (b"", (0, 0), False, 0.0, 0.0, 0, np.zeros((HEIGHT, WIDTH), np.uint8))


@dataclass(frozen=True)
class Looks:
    """The facts kept of a traverse's frames, in order; of an unreadable frame its error alone."""

    traverse: str
    names: tuple[str, ...]
    turned: Which  # whether the file has an EXIF tag that turns the frame, obeyed or not
    unreadable: Mapping[int, str]  # the complaint by the number of the frame
    contents: tuple[bytes, ...]  # hash of the pixels; empty if unreadable
    sizes: npt.NDArray[np.int64]  # (n, 2), height and width; 0 if unreadable
    grey: Which  # whether red, green and blue are the same
    mean: npt.NDArray[np.float64]  # (n,), of the grey values
    std: npt.NDArray[np.float64]  # (n,)
    n_levels: npt.NDArray[np.int64]  # (n,), different grey values
    small: Small  # (n, 16, 32)

    @property
    def readable(self) -> Which:
        """Which frames were decoded, (n,)."""
        return self.sizes[:, 0] > 0

    @property
    def black(self) -> Which:
        """Which frames are black, (n,)."""
        return self.readable & (self.mean < BLACK_MEAN)

    @property
    def uniform(self) -> Which:
        """Which frames show nothing, black or not, (n,)."""
        return self.readable & (self.std < UNIFORM_STD)

    @property
    def of_few_levels(self) -> Which:
        """Which frames have few grey levels, (n,)."""
        return self.readable & (self.n_levels < FEW_LEVELS)

    def named(self, which: Which) -> list[str]:
        """Return the names of some of the frames."""
        return [self.names[number] for number in np.flatnonzero(which)]


def look_at(images: Images, traverse: str) -> Looks:
    """Decode every image once, in threads, and keep what the checks need; an unreadable image ends nothing."""
    unreadable: dict[int, str] = {}

    def at(number: int) -> _Look:
        try:
            return _look(images[number])
        except BadInput as error:
            unreadable[number] = str(error)
            return _NOTHING

    looks: list[_Look] = []
    with ThreadPoolExecutor(_READERS) as readers:
        for look in readers.map(at, range(len(images))):
            looks.append(look)
            progress.report(f"looking at {traverse}", len(looks) / len(images))
    contents, *values = zip(*looks, strict=True)
    arrays = [np.array(value) for value in values]
    turned = np.isin(np.arange(len(images)), images.turned())
    return Looks(traverse, images.names, turned, dict(sorted(unreadable.items())), contents, *arrays)


def _look(image: Image) -> _Look:
    grey = cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_RGB2GRAY)
    mean, std = cv2.meanStdDev(grey)
    sample = image[::_GREY_STEP, ::_GREY_STEP]
    content = hashlib.sha256(repr(image.shape).encode() + image.tobytes()).digest()
    colourless = bool((sample == sample[:, :, :1]).all())
    n_levels = int(np.count_nonzero(cv2.calcHist([grey], [0], None, [256], [0, 256])))
    small = cv2.resize(grey, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA).astype(np.uint8, copy=False)
    return content, (image.shape[0], image.shape[1]), colourless, float(mean[0, 0]), float(std[0, 0]), n_levels, small
