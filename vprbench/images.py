"""Lazy image sequences: decoded when looked at, read ahead by threads, never a whole traverse in memory."""

from __future__ import annotations

import hashlib
import os
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import overload

import numpy as np
import numpy.typing as npt
from PIL import Image as PillowImage

from vprbench.interface import BadInput, Image

_CHUNK = 4  # images a reading thread takes at a time
_REPORT_EVERY = 50  # images
_STAMP_BYTES = 4096
_FINGERPRINT_SAMPLE = 16
_READERS = min(8, len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1)


class ReadingTime:
    """The seconds that somebody waited for images; shared by all views of one sequence."""

    def __init__(self) -> None:
        """Start at zero."""
        self.seconds = 0.0


class Images(Sequence[Image]):
    """A sequence of RGB images, uint8 (height, width, 3), read when they are looked at.

    An integer index gives an image, a slice or an index array gives a view that has read nothing yet.
    Iterating reads ahead in threads and holds a bounded number of images.
    """

    def __init__(
        self,
        read: Callable[[int], Image],
        names: Sequence[str],
        *,
        stamp: Callable[[int], bytes] | None = None,
        content: Callable[[int], bytes] | None = None,
        in_memory: bool = False,
    ) -> None:
        """Take `read(i)` for the i-th image and one name per image; `read` is called from several threads.

        `stamp(i)` tells cheaply whether an image changed; without it `fingerprint` looks at some of the images.
        `content(i)` is all that an image is decoded from; without it `content_hash` decodes every image.
        """
        self._read = read
        self._stamp = stamp
        self._content = content
        self._in_memory = in_memory
        self._report: Callable[[int], None] | None = None
        self.names = tuple(names)
        self.reading = ReadingTime()

    @classmethod
    def from_files(cls, paths: Sequence[Path]) -> Images:
        """Decode image files; an unreadable or truncated one raises BadInput with its path when it is read."""
        paths = list(paths)
        return cls(
            lambda i: read_image(paths[i]),
            [path.name for path in paths],
            stamp=lambda i: _file_stamp(paths[i]),
            content=lambda i: _file_content(paths[i]),
        )

    @classmethod
    def from_arrays(cls, arrays: Sequence[Image], names: Sequence[str] | None = None) -> Images:
        """Wrap decoded images, (height, width, 3) or grey (height, width), uint8."""
        arrays = [_as_rgb(array) for array in arrays]
        if names is not None and len(names) != len(arrays):
            raise BadInput(f"{len(arrays)} images came with {len(names)} names: give one for each")
        return cls(arrays.__getitem__, names or [f"image {i}" for i in range(len(arrays))], in_memory=True)

    def __len__(self) -> int:
        """Return the number of images."""
        return len(self.names)

    @overload
    def __getitem__(self, index: int) -> Image: ...
    @overload
    def __getitem__(self, index: slice | npt.NDArray[np.int64]) -> Images: ...
    def __getitem__(self, index: int | slice | npt.NDArray[np.int64]) -> Image | Images:
        """Return one image, or a lazy view of several."""
        if isinstance(index, int | np.integer):
            if not -len(self) <= index < len(self):
                raise IndexError(f"image {index} of {len(self)}")
            started = time.perf_counter()
            image = self._read(int(index) % len(self))
            self.reading.seconds += time.perf_counter() - started
            return image
        chosen = np.arange(len(self))[index].tolist()
        stamp, content = self._stamp, self._content
        view = Images(
            lambda i: self._read(chosen[i]),
            [self.names[i] for i in chosen],
            stamp=None if stamp is None else lambda i: stamp(chosen[i]),
            content=None if content is None else lambda i: content(chosen[i]),
            in_memory=self._in_memory,
        )
        view.reading = self.reading
        return view

    def __iter__(self) -> Iterator[Image]:
        """Yield the images in order, read ahead by threads."""
        for number, image in enumerate(self._ahead()):
            yield image
            if self._report is not None and number % _REPORT_EVERY == 0:
                self._report(number + 1)

    def _ahead(self) -> Iterator[Image]:
        if self._in_memory or len(self) <= 1:
            yield from (self[i] for i in range(len(self)))
            return
        starts = iter(range(0, len(self), _CHUNK))
        with ThreadPoolExecutor(_READERS) as readers:
            ahead: deque[Future[list[Image]]] = deque()
            try:
                for start in starts:
                    ahead.append(readers.submit(self._read_chunk, start))
                    if len(ahead) > 2 * _READERS:
                        yield from self._wait(ahead.popleft())
                while ahead:
                    yield from self._wait(ahead.popleft())
            finally:
                readers.shutdown(cancel_futures=True)

    def blocks(self, size: int) -> Iterator[Images]:
        """Yield consecutive views of up to `size` decoded images each."""
        block: list[Image] = []
        start = 0
        for image in self:
            block.append(image)
            if len(block) == size or start + len(block) == len(self):
                yield Images.from_arrays(block, self.names[start : start + len(block)])
                start += len(block)
                block = []

    def unnamed(self) -> Images:
        """Return the same images under names that say nothing."""
        view = self[:]
        view.names = tuple(f"image {i}" for i in range(len(self)))
        return view

    def watched(self, report: Callable[[int], None]) -> Images:
        """Return the same images; `report` is told now and then how many an iteration has handed out."""
        view = self[:]
        view._report = report
        return view

    def in_memory(self) -> Images:
        """Return the same images, all decoded now."""
        return self if self._in_memory else Images.from_arrays(list(self), self.names)

    def fingerprint(self) -> str:
        """Return a hash that changes when images are added, removed, renamed, reordered or replaced.

        Of files it sees name, size, first and last bytes (the end of a PNG holds a checksum of its pixels); of
        other images the pixels of sixteen.
        """
        digest = hashlib.sha256("\n".join(self.names).encode())
        if self._stamp is not None:
            for i in range(len(self)):
                digest.update(self._stamp(i))
        else:
            for i in np.linspace(0, len(self) - 1, min(len(self), _FINGERPRINT_SAMPLE)).astype(int).tolist():
                image = self._read(i)
                digest.update(repr(image.shape).encode() + image.tobytes())
        return digest.hexdigest()

    def content_hash(self) -> str:
        """Return a hash of everything that the images are decoded from, whatever their names.

        It reads every file whole, and decodes what is no file.
        """
        digest = hashlib.sha256()
        for i in range(len(self)):
            if self._content is not None:
                content = self._content(i)
            else:
                image = self._read(i)
                content = repr(image.shape).encode() + image.tobytes()
            digest.update(hashlib.sha256(content).digest())
        return digest.hexdigest()

    def _read_chunk(self, start: int) -> list[Image]:
        return [self._read(i) for i in range(start, min(start + _CHUNK, len(self)))]

    def _wait(self, chunk: Future[list[Image]]) -> list[Image]:
        started = time.perf_counter()
        images = chunk.result()
        self.reading.seconds += time.perf_counter() - started
        return images


def read_image(path: Path) -> Image:
    """Decode one image file to RGB uint8 (height, width, 3); grey is repeated, alpha dropped, 16 bit reduced to 8.

    Raises BadInput with the path where the file is missing, truncated or no image.
    """
    try:
        with PillowImage.open(path) as image:
            if image.mode.startswith("I"):
                return _as_rgb((np.asarray(image) >> 8).astype(np.uint8))
            # A palette with transparency has to become RGBA first.
            return np.asarray((image.convert("RGBA") if image.mode == "P" else image).convert("RGB"))
    except FileNotFoundError as error:
        raise BadInput(f"{path} does not exist: restore the file or choose other places") from error
    except (OSError, SyntaxError, ValueError, PillowImage.DecompressionBombError) as error:
        reason = str(error).replace(str(path), "it").splitlines()[0]
        raise BadInput(f"{path} cannot be read as an image ({reason}): replace the file; none is skipped") from error


def _file_stamp(path: Path) -> bytes:
    try:
        size = path.stat().st_size
        with path.open("rb") as file:
            start = file.read(_STAMP_BYTES)
            file.seek(max(0, size - _STAMP_BYTES))
            return b"%d" % size + start + file.read()
    except OSError as error:
        raise BadInput(f"{path} cannot be read ({error.strerror}): restore the file") from error


def _file_content(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise BadInput(f"{path} cannot be read ({error.strerror}): restore the file") from error


def _as_rgb(array: Image) -> Image:
    if array.ndim == 2 and array.dtype == np.uint8:
        return np.repeat(array[:, :, None], 3, axis=2)
    if array.ndim != 3 or array.shape[2] not in (3, 4) or array.dtype != np.uint8:
        raise BadInput(
            f"an image of shape {array.shape} and type {array.dtype} came; wanted uint8 (height, width, 3), "
            "or (height, width) for grey"
        )
    return array[:, :, :3]
