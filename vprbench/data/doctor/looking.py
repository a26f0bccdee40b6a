"""One look at every frame of a traverse: what the checks need of it is kept, the frame is not."""

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

_GREY_STEP = 4  # every so many-th pixel tells whether a frame has colours
_READERS = min(8, core_count())


@dataclass(frozen=True)
class Looks:
    """What is kept of the frames of a traverse, in order; of an unreadable one nothing but the complaint."""

    names: tuple[str, ...]
    unreadable: Mapping[int, str]  # the complaint by the number of the frame
    contents: tuple[bytes, ...]  # hash of the pixels; empty where unreadable
    sizes: npt.NDArray[np.int64]  # (n, 2), height and width; 0 where unreadable
    grey: npt.NDArray[np.bool_]  # (n,), whether red, green and blue are the same
    mean: npt.NDArray[np.float64]  # (n,), of the grey values
    std: npt.NDArray[np.float64]  # (n,)
    small: Small  # (n, 16, 32)

    @property
    def readable(self) -> npt.NDArray[np.bool_]:
        """Which frames were decoded, (n,)."""
        return self.sizes[:, 0] > 0

    @property
    def black(self) -> npt.NDArray[np.bool_]:
        """Which frames are black, (n,)."""
        return self.readable & (self.mean < BLACK_MEAN)

    @property
    def uniform(self) -> npt.NDArray[np.bool_]:
        """Which frames show nothing, black or not, (n,)."""
        return self.readable & (self.std < UNIFORM_STD)


@dataclass(frozen=True)
class _Look:
    content: bytes
    size: tuple[int, int]
    grey: bool
    mean: float
    std: float
    small: Small


_NOTHING = _Look(b"", (0, 0), False, 0.0, 0.0, np.zeros((HEIGHT, WIDTH), np.uint8))


def look_at(images: Images, stage: str) -> Looks:
    """Decode every image once, in threads, and keep what the checks need; one that is unreadable ends nothing."""
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
            progress.report(stage, len(looks) / len(images))
    return Looks(
        names=images.names,
        unreadable=dict(sorted(unreadable.items())),
        contents=tuple(look.content for look in looks),
        sizes=np.array([look.size for look in looks], np.int64).reshape(-1, 2),
        grey=np.array([look.grey for look in looks]),
        mean=np.array([look.mean for look in looks]),
        std=np.array([look.std for look in looks]),
        small=np.array([look.small for look in looks]),
    )


def _look(image: Image) -> _Look:
    grey = cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_RGB2GRAY)
    mean, std = cv2.meanStdDev(grey)
    sample = image[::_GREY_STEP, ::_GREY_STEP]
    return _Look(
        content=hashlib.sha256(repr(image.shape).encode() + image.tobytes()).digest(),
        size=(image.shape[0], image.shape[1]),
        grey=bool((sample == sample[:, :, :1]).all()),
        mean=float(mean[0, 0]),
        std=float(std[0, 0]),
        small=cv2.resize(grey, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA).astype(np.uint8, copy=False),
    )
