"""Lazy image sequences: decoded when looked at, read ahead by threads, never a whole traverse in memory."""

from __future__ import annotations

import hashlib
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from functools import cache
from itertools import chain, islice
from pathlib import Path
from typing import overload

import numpy as np
import numpy.typing as npt

from vprbench.api.arrays import Image
from vprbench.api.decoding import UPRIGHT, Decoding, as_rgb, read_head, read_image
from vprbench.errors import BadInput
from vprbench.storage.cores import count_cores
from vprbench.storage.hashes import FileHash, hash_each_file
from vprbench.storage.paths import Paths, choose_names

Codes = npt.NDArray[np.uint64]  # (n,), of images: alike for images of the same content

CHUNK = 4  # images that a reading thread takes at a time
_AHEAD = 128  # images under way, at most
_AHEAD_BYTES = 1 << 26  # that these have, at most, unless a chunk has more
_BLOCK_BYTES = 1 << 28  # of decoded images that are held together, unless a single one has more
_REPORT_EVERY = 50  # images
_FINGERPRINT_SAMPLE = 16
_READERS = min(64, count_cores())


class ReadingTime:
    """The seconds that a program waited for images; all views of one sequence share them."""

    def __init__(self) -> None:
        """Start at zero."""
        self.seconds = 0.0

    @contextmanager
    def waiting(self) -> Iterator[None]:
        """Count the seconds of the block."""
        started = time.perf_counter()
        yield
        self.seconds += time.perf_counter() - started

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
        `stamp(i)` changes with anything else about image i and is cheap, `content(i)` is everything else that image i
        is made from. Without files and `stamp`, `fingerprint` decodes sixteen images; without files and `content`,
        `content_hash` decodes every image.
        """
        self._read = read
        self._files = None if files is None else Paths.of(files)
        self._stamp = stamp
        self._content = content
        self._in_memory = in_memory
        self._report: Callable[[int], None] | None = None
        self.names = tuple(names)
        self.reading = ReadingTime()

    @classmethod
    def from_files(cls, paths: Sequence[Path], decoding: Decoding | None = None) -> Images:
        """Decode image files; an unreadable or truncated one raises BadInput with its path when it is read.

        Of `decoding`, how EXIF tags and deep levels are read, None is the usual one; `decoding_of` tells that of a
        dataset, and what of it belongs to the protocol.
        """
        paths, decoding = Paths.of(paths), decoding or Decoding()
        return cls(lambda i: read_image(paths[i], decoding), paths.names, files=paths)

    @classmethod
    def from_arrays(cls, arrays: Sequence[Image], names: Sequence[str] | None = None) -> Images:
        """Wrap decoded images, (height, width, 3) or grey (height, width), uint8."""
        arrays = [as_rgb(array) for array in arrays]
        if names is not None and len(names) != len(arrays):
            raise BadInput(f"{len(arrays)} images came with {len(names)} names: give one for each")
        return cls(arrays.__getitem__, names or [f"image {i}" for i in range(len(arrays))], in_memory=True)

    @property
    def files(self) -> Paths | None:
        """The files that the images are decoded from, one each; None where they are made otherwise."""
        return self._files

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
            with self.reading.waiting():
                return self._read(int(index) % len(self))
        chosen = np.arange(len(self))[index]
        files, stamp, content = self._files, self._stamp, self._content
        view = Images(
            lambda i: self._read(int(chosen[i])),
            choose_names(self.names, index),
            files=None if files is None else files[index],
            stamp=None if stamp is None else lambda i: stamp(int(chosen[i])),
            content=None if content is None else lambda i: content(int(chosen[i])),
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
        # Frames that are computed keep the interpreter busy: several threads would only wait for one another.
        n_readers = 1 if self._files is None else _READERS
        starts = iter(range(0, len(self), CHUNK))
        n_chunks, largest = 2 * n_readers, 1  # under way, and bytes of the largest image so far
        with ThreadPoolExecutor(n_readers) as readers:
            ahead: deque[Future[list[Image]]] = deque()
            try:
                while True:
                    more = islice(starts, max(0, n_chunks - len(ahead)))
                    ahead.extend(readers.submit(self._read_chunk, at) for at in more)
                    if not ahead:
                        return
                    with self.reading.waiting():
                        images = ahead.popleft().result()
                    largest = max(largest, *(image.nbytes for image in images))
                    n_chunks = max(1, min(2 * n_chunks, _AHEAD // CHUNK, _AHEAD_BYTES // (CHUNK * largest)))
                    yield from images
                    del images  # or they would be held while the next ones are read
            finally:
                readers.shutdown(cancel_futures=True)

    def decoded_bytes(self) -> int:
        """Return the bytes of all images once they are decoded: of files by their heads, of others by the first."""
        if self._files is not None:
            return sum(read_head(path).n_bytes for path in self._files)
        return len(self) * self[0].nbytes if len(self) else 0

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

    def changed(self, change: Callable[[Image, str], Image], how: str) -> Images:
        """Return images that `change(image, name)` makes of these when they are read; `how` is all it depends on.

        Hashes tell them from these images, and from what another change makes of these.
        """
        names, in_files = self.names, self._files is not None
        whole = cache(lambda: self.fingerprint().encode())
        stamp = self._stamp or (lambda i: b"" if in_files else whole())
        content = self._content or (lambda i: b"" if in_files else _serialise_pixels(self._read(i)))
        images = Images(
            lambda i: change(self._read(i), names[i]),
            names,
            files=self._files,
            stamp=lambda i: how.encode() + stamp(i),
            content=lambda i: f"{how} {names[i]} ".encode(errors="surrogateescape") + content(i),
        )
        images.reading = self.reading
        return images

    def in_memory(self) -> Images:
        """Return the same images, all decoded now."""
        return self if self._in_memory else Images.from_arrays(list(self), self.names)

    def turned(self) -> npt.NDArray[np.int64]:
        """Return which images come from files with an EXIF tag that turns or mirrors them, whether it is obeyed or not.

        Looks at the head of every file.
        """
        files: Sequence[Path] = () if self._files is None else self._files
        return np.flatnonzero([read_head(path).orientation != UPRIGHT for path in files])

    def file_hashes(self) -> list[FileHash] | None:
        """Return the size and SHA-256 of the file behind each image; None if there are no files."""
        return None if self._files is None else hash_each_file(self._files)

    def content_codes(self, pixels: bool = False) -> Codes | None:
        """Return a number for each image, (n,), which images of the same content share; None if they are computed.

        Images of files go by the content of these, or by their `pixels` once they are decoded; images in memory by
        their pixels. Raises BadInput for a file that cannot be read.
        """
        if self._in_memory or (pixels and self._files is not None):
            return _pack_codes(hashlib.sha256(_serialise_pixels(image)).digest() for image in self)
        files, content = self.file_hashes(), self._content
        if files is None or content is None:
            return None if files is None else _pack_codes(sha256 for _, sha256 in files)
        return _pack_codes(hashlib.sha256(sha256 + content(i)).digest() for i, (_, sha256) in enumerate(files))

    def fingerprint(self, hashed: list[FileHash] | None = None) -> str:
        """Return a hash that changes when images are added, removed, renamed, reordered or replaced.

        Files count by name, size and content, which `hashed` holds if they were looked at just now. Of images that have
        neither files nor a stamp sixteen are decoded, of those in memory all count.
        """
        digest = names_hash(self.names)
        files = hashed or self.file_hashes()
        for size, sha256 in files or ():
            digest.update(b"%d%b" % (size, sha256))
        if self._stamp is not None:
            for i in range(len(self)):
                digest.update(self._stamp(i))
        elif files is None:
            most = len(self) if self._in_memory else _FINGERPRINT_SAMPLE
            for i in np.linspace(0, len(self) - 1, min(len(self), most)).astype(int).tolist():
                digest.update(_serialise_pixels(self._read(i)))
        return digest.hexdigest()

    def content_hash(self) -> str:
        """Return a hash of everything that the images are made from, whatever their names.

        Files count by their content; images without files are decoded.
        """
        files = self.file_hashes()
        digest = hashlib.sha256(b"".join(sha256 for _, sha256 in files or ()))
        if self._content is not None:
            for i in range(len(self)):
                digest.update(hashlib.sha256(self._content(i)).digest())
        elif files is None:
            for i in range(len(self)):
                digest.update(hashlib.sha256(_serialise_pixels(self._read(i))).digest())
        return digest.hexdigest()

    def _read_chunk(self, start: int) -> list[Image]:
        return [self._read(i) for i in range(start, min(start + CHUNK, len(self)))]


def names_hash(*lists: Sequence[str]) -> hashlib._Hash:
    """Return the SHA-256 of all names of all lists, joined by line feeds."""
    return hashlib.sha256("\n".join(chain(*lists)).encode(errors="surrogateescape"))


def hash_images_of_both(one: Images, other: Images) -> tuple[Codes, Codes] | None:
    """Return the codes of the content of two sequences, by pixels if one of them is in memory; None if one is computed.

    Raises BadInput for a file that cannot be read.
    """
    pixels = one._in_memory or other._in_memory
    codes = one.content_codes(pixels), other.content_codes(pixels)
    return None if codes[0] is None or codes[1] is None else (codes[0], codes[1])


def _pack_codes(hashes: Iterable[bytes]) -> Codes:
    """Return the first eight bytes of each SHA-256 as a number."""
    return np.frombuffer(b"".join(hashes), ">u8")[::4].astype(np.uint64)


def _serialise_pixels(image: Image) -> bytes:
    return repr(image.shape).encode() + image.tobytes()
