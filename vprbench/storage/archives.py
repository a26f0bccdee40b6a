"""Zip and tar files, read member by member, however damaged or hostile they are."""

from __future__ import annotations

import bz2
import gzip
import io
import lzma
import stat
import struct
import tarfile
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, BinaryIO, cast

from vprbench.errors import BadInput

_CHUNK = 1 << 20  # bytes read at once
_HEADER_BYTES = 1 << 20  # of one member in a tar, far more than any honest one has
_PADDING_BYTES = 1 << 25  # after the last member of a tar, at most
_XZ_BYTES = 1 << 27  # of memory; what the strongest preset of xz made takes half of them
_ZIP, _GZIP, _BZIP2, _XZ = (b"PK\x03\x04", b"PK\x05\x06"), b"\x1f\x8b", b"BZh", b"\xfd7zXZ\0"
_DAMAGE = (
    *(zipfile.BadZipFile, tarfile.TarError, zlib.error, lzma.LZMAError, struct.error),
    *(EOFError, OSError, ValueError, OverflowError, IndexError, RuntimeError),  # what those libraries are led to
)


class DamagedArchive(BadInput):
    """An archive that cannot be read to its end: it has to be downloaded anew."""


@dataclass(frozen=True)
class Member:
    """A file, a folder or something else in an archive."""

    name: str  # as it stands there
    kind: str  # "file", "folder", or what it is instead
    size_bytes: int  # as it stands there
    chunks: Callable[[], Iterator[bytes]]  # its content, of a file; before the next member is asked for


@contextmanager
def members(archive: Path) -> Iterator[Iterator[Member]]:
    """Open a zip, tar, tar.gz, tar.bz2 or tar.xz, whatever its name is; yields its members in order.

    Raises DamagedArchive, now or when members and chunks are asked for, where it is none or ends early.
    """
    with archive.open("rb") as raw:
        start = raw.read(8)
        raw.seek(0)
        if start.startswith(_ZIP):
            with _reading(archive):
                opened = zipfile.ZipFile(raw)
            with opened:
                yield _guarded(archive, _in_zip(archive, opened))
        else:
            with _decompressed(raw, start) as stream:
                yield _guarded(archive, _in_tar(archive, _Forward(stream)))


@contextmanager
def _reading(archive: Path) -> Iterator[None]:
    """Turn what the libraries raise about a damaged archive into one error."""
    try:
        yield
    except _DAMAGE as error:
        if isinstance(error, OSError) and error.errno is not None:
            raise  # of the disk
        reason = " ".join(str(error).split()) or type(error).__name__
        raise DamagedArchive(f"{archive} is damaged, or no archive ({reason}): download it anew") from error


def _guarded(archive: Path, found: Iterator[Member]) -> Iterator[Member]:
    while True:
        with _reading(archive):
            member = next(found, None)
        if member is None:
            return
        yield member


def _chunks(archive: Path, opened: Callable[[], IO[bytes]]) -> Iterator[bytes]:
    with _reading(archive):
        source = opened()
    with source:
        while True:
            with _reading(archive):
                chunk = source.read(_CHUNK)
            if not chunk:
                return
            yield chunk


@contextmanager
def _decompressed(raw: BinaryIO, start: bytes) -> Iterator[IO[bytes]]:
    if start.startswith(_GZIP):
        with gzip.GzipFile(fileobj=raw) as stream:
            yield cast(IO[bytes], stream)
    elif start.startswith(_BZIP2):
        with bz2.BZ2File(raw) as stream:
            yield stream
    elif start.startswith(_XZ):
        with io.BufferedReader(_Xz(raw)) as stream:
            yield stream
    else:
        yield raw


def _in_zip(archive: Path, opened: zipfile.ZipFile) -> Iterator[Member]:
    for info in opened.infolist():
        mode = info.external_attr >> 16  # 0 where the archive was not made under Unix
        if stat.S_ISLNK(mode):
            kind = "a link"
        elif info.flag_bits & 1:
            kind = "encrypted"
        elif info.is_dir():
            kind = "folder"
        elif info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            kind = "compressed in a way that may fill the memory"  # zipfile bounds no other one
        else:
            kind = "file" if stat.S_IFMT(mode) in (0, stat.S_IFREG) else "no plain file"

        def chunks(info: zipfile.ZipInfo = info) -> Iterator[bytes]:
            return _chunks(archive, lambda: opened.open(info))

        yield Member(info.orig_filename, kind, info.file_size, chunks)


def _in_tar(archive: Path, stream: _Forward) -> Iterator[Member]:
    stream.allow(_HEADER_BYTES)
    with tarfile.TarFile(fileobj=cast(IO[bytes], stream)) as opened:
        while (info := opened.next()) is not None:
            if info.issym() or info.islnk():
                kind = "a link"
            elif info.isdir():
                kind = "folder"
            else:
                kind = "file" if info.isreg() and not info.issparse() else "no plain file"

            def chunks(info: tarfile.TarInfo = info) -> Iterator[bytes]:
                return _chunks(archive, lambda: cast(IO[bytes], opened.extractfile(info)))

            stream.allow(info.size)
            yield Member(info.name, kind, info.size, chunks)
            opened.members.clear()  # type: ignore[attr-defined]  # it would keep them all ...
            opened.pax_headers.clear()  # type: ignore[attr-defined]  # ... and each header for all that follow
            stream.allow(_HEADER_BYTES)
    if stream.last != bytes(tarfile.BLOCKSIZE):  # tarfile takes the first header that it cannot read for the end
        raise tarfile.ReadError("it ends early")
    stream.allow(_PADDING_BYTES)
    while stream.read(_CHUNK):  # gzip compares its checksum at the very end
        pass


class _Xz(io.RawIOBase):
    """An xz file decompressed in bounded memory: its header may ask for gigabytes."""

    def __init__(self, raw: BinaryIO) -> None:
        self._raw = raw
        self._stream = _xz_stream()

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:
        """Write what comes next to a buffer; returns how many bytes, 0 at the end."""
        while True:
            content = b""
            if self._stream.eof:
                content = self._stream.unused_data.lstrip(b"\0") or self._raw.read(_CHUNK).lstrip(b"\0")
                if not content:
                    return 0
                self._stream = _xz_stream()  # several may follow one another
            elif self._stream.needs_input:
                content = self._raw.read(_CHUNK)
                if not content:
                    raise EOFError("it ends early")
            if found := self._stream.decompress(content, len(buffer)):
                buffer[: len(found)] = found
                return len(found)


def _xz_stream() -> lzma.LZMADecompressor:
    return lzma.LZMADecompressor(lzma.FORMAT_XZ, memlimit=_XZ_BYTES)


class _Forward:
    """A stream that is read forwards alone, and no further than allowed: a header may ask for any length."""

    def __init__(self, stream: IO[bytes]) -> None:
        self._stream = stream
        self._position = self._allowed = 0
        self.last = b""  # what the latest read gave

    def allow(self, n_bytes: int) -> None:
        """Allow so many bytes to be read from here on."""
        self._allowed = n_bytes

    def tell(self) -> int:
        return self._position

    def read(self, n_bytes: int) -> bytes:
        if not 0 <= n_bytes <= self._allowed:
            raise tarfile.ReadError(f"{n_bytes} bytes where so many cannot be")
        self.last = self._stream.read(n_bytes)
        self._allowed -= len(self.last)
        self._position += len(self.last)
        return self.last

    def seek(self, position: int) -> None:
        if position < self._position:
            raise tarfile.ReadError("it goes back")
        while self._position < position:
            skipped = self._stream.read(min(position - self._position, _CHUNK))
            if not skipped:
                raise tarfile.ReadError("it ends early")
            self._position += len(skipped)
