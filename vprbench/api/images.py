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

from vprbench.api import png
from vprbench.api.arrays import Image
from vprbench.api.image_formats import open_image
from vprbench.api.read_ahead import Window
from vprbench.errors import BadInput
from vprbench.storage.hashes import FileHash, file_hashes

_BLOCK_BYTES = 1 << 28  # of decoded images that are held together, unless a single one has more
_REPORT_EVERY = 50  # images
_FINGERPRINT_SAMPLE = 16
_UNREADABLE = (  # how Pillow and the reader of PNG say what a file is not
    *(OSError, SyntaxError, ValueError),
    *(PillowImage.DecompressionBombError, PillowImage.DecompressionBombWarning),
)
_READERS = min(64, len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1)


class ReadingTime:
    """The seconds that somebody waited for images; shared by all views of one sequence."""

    def __init__(self) -> None:
        """Start at zero."""
        self.seconds = 0.0

    def limit(self, before: float, most: float) -> None:
        """Take back what exceeds `most` seconds since there were `before`: other threads worked on while one waited."""
        self.seconds = min(self.seconds, before + max(0.0, most))


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
        files: Sequence[Path] | None = None,
        stamp: Callable[[int], bytes] | None = None,
        content: Callable[[int], bytes] | None = None,
        in_memory: bool = False,
    ) -> None:
        """Take `read(i)` for the i-th image and one name per image; `read` is called from several threads.

        `files` are what the images are decoded from, one each; `fingerprint` and `content_hash` see their content.
        `stamp(i)` tells cheaply whether anything else about an image changed, `content(i)` is all else that it is made
        from. With no files and no stamp `fingerprint` looks at some of the images; with no files and no content
        `content_hash` decodes every one.
        """
        self._read = read
        self._files = files
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
            files=paths,
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
        files, stamp, content = self._files, self._stamp, self._content
        view = Images(
            lambda i: self._read(chosen[i]),
            [self.names[i] for i in chosen],
            files=None if files is None else [files[i] for i in chosen],
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
        window = Window(len(self), self._file_bytes if self._files else None, _READERS)
        with ThreadPoolExecutor(_READERS) as readers:
            ahead: deque[tuple[range, Future[list[Image]]]] = deque()
            try:
                while (chunk := window.take()) or ahead:
                    if chunk:
                        ahead.append((chunk, readers.submit(self._read_chunk, chunk.start, len(chunk))))
                        continue
                    chunk, reading = ahead.popleft()
                    images = self._wait(reading)
                    window.give(chunk, max(image.nbytes for image in images))
                    yield from images
                    del images, reading  # or they would be held while the next ones are read
            finally:
                readers.shutdown(cancel_futures=True)

    def decoded_bytes(self) -> int:
        """Return the bytes of all images once they are decoded: of files by their heads, of others by the first."""
        if self._files is None and not self._in_memory:
            return len(self) * self[0].nbytes if len(self) else 0
        return sum(self._file_bytes(i) if self._files else self._read(i).nbytes for i in range(len(self)))

    def blocks(self, size: int, n_bytes: int = _BLOCK_BYTES) -> Iterator[Images]:
        """Yield consecutive views of decoded images, up to `size` of up to `n_bytes` together, or a single one."""
        block: list[Image] = []
        held = 0
        for number, image in enumerate(self):
            if block and (len(block) == size or held + image.nbytes > n_bytes):
                yield Images.from_arrays(block, self.names[number - len(block) : number])
                block, held = [], 0
            block.append(image)
            held += image.nbytes
            del image  # or the last one would be held with the next block
        if block:
            yield Images.from_arrays(block, self.names[-len(block) :])

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

    def file_hashes(self) -> list[FileHash] | None:
        """Return the hash of the file behind each image; None where there are no files."""
        return None if self._files is None else file_hashes(self._files)

    def fingerprint(self) -> str:
        """Return a hash that changes when images are added, removed, renamed, reordered or replaced.

        Of files it sees name, size and content; of images that are no files, and have no stamp, sixteen.
        """
        digest = hashlib.sha256("\n".join(self.names).encode(errors="surrogateescape"))
        files = self.file_hashes()
        for file in files or ():
            digest.update(b"%d" % file.size_bytes + file.sha256)
        if self._stamp is not None:
            for i in range(len(self)):
                digest.update(self._stamp(i))
        elif files is None:
            for i in np.linspace(0, len(self) - 1, min(len(self), _FINGERPRINT_SAMPLE)).astype(int).tolist():
                image = self._read(i)
                digest.update(repr(image.shape).encode() + image.tobytes())
        return digest.hexdigest()

    def content_hash(self) -> str:
        """Return a hash of everything that the images are made from, whatever their names.

        Of files it sees the content; it decodes what is no file.
        """
        digest = hashlib.sha256()
        files = self.file_hashes()
        for file in files or ():
            digest.update(file.sha256)
        if self._content is not None:
            for i in range(len(self)):
                digest.update(hashlib.sha256(self._content(i)).digest())
        elif files is None:
            for i in range(len(self)):
                image = self._read(i)
                digest.update(hashlib.sha256(repr(image.shape).encode() + image.tobytes()).digest())
        return digest.hexdigest()

    def _file_bytes(self, number: int) -> int:
        """Return the bytes of a file's image once it is decoded; looking takes part of the reading."""
        assert self._files is not None
        started = time.perf_counter()
        n_bytes = _decoded_bytes(self._files[number])
        self.reading.seconds += time.perf_counter() - started
        return n_bytes

    def _read_chunk(self, start: int, size: int) -> list[Image]:
        return [self._read(i) for i in range(start, start + size)]

    def _wait(self, chunk: Future[list[Image]]) -> list[Image]:
        started = time.perf_counter()
        images = chunk.result()
        self.reading.seconds += time.perf_counter() - started
        return images


def read_image(path: Path) -> Image:
    """Decode one image file to RGB uint8 (height, width, 3); grey is repeated, alpha dropped, 16 bit reduced to 8.

    Raises BadInput with the path where the file is missing, truncated or no image, and, undecoded, where it has more
    pixels than `PIL.Image.MAX_IMAGE_PIXELS` (89,478,485 unless a program sets another number).
    """
    try:
        if (pixels := _decoded_png(path)) is not None:
            return pixels
        with open_image(path) as image:
            _insist_on_size(image)
            if image.mode.startswith("I"):
                return _as_rgb((np.asarray(image) >> 8).astype(np.uint8))
            if image.mode == "RGB":
                return np.asarray(image)
            # A palette with transparency has to become RGBA first.
            return np.asarray((image.convert("RGBA") if image.mode == "P" else image).convert("RGB"))
    except FileNotFoundError as error:
        raise BadInput(f"{path} does not exist: restore the file or choose other places") from error
    except _UNREADABLE as error:
        reason = str(error).replace(f" {str(path)!r}", "").replace(str(path), "it").splitlines()[0]
        raise BadInput(f"{path} cannot be read as an image ({reason}): replace the file; none is skipped") from error


def _insist_on_size(image: PillowImage.Image) -> None:
    most = PillowImage.MAX_IMAGE_PIXELS
    if most is not None and image.width * image.height > most:
        raise ValueError(f"{image.width} x {image.height} pixels; at most {most:,} may be decoded")


def _decoded_png(path: Path) -> Image | None:
    """Return what is read fastest; None for anything but a plain, whole PNG."""
    with path.open("rb") as file:
        start = file.read(len(png.SIGNATURE))
        return png.decoded(start + file.read()) if start == png.SIGNATURE else None


def _decoded_bytes(path: Path) -> int:
    """Return the bytes of an image once it is decoded, from the head of its file; 1 where that cannot be read."""
    try:
        with open_image(path) as image:
            return max(1, 3 * image.width * image.height)
    except _UNREADABLE:  # said when the image is read
        return 1


def _as_rgb(array: Image) -> Image:
    if array.ndim == 2 and array.dtype == np.uint8:
        return np.repeat(array[:, :, None], 3, axis=2)
    if array.ndim != 3 or array.shape[2] not in (3, 4) or array.dtype != np.uint8:
        raise BadInput(
            f"an image of shape {array.shape} and type {array.dtype} came; wanted uint8 (height, width, 3), "
            "or (height, width) for grey"
        )
    return array[:, :, :3]
