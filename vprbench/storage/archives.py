"""Zip and tar files, read member by member, however damaged or hostile they are."""

from __future__ import annotations

import bz2
import gzip
import lzma
import stat
import struct
import tarfile
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import IO, BinaryIO, cast

from vprbench.errors import BadInput

CHUNK = 1 << 20  # bytes read at once
_PIECE = 1 << 14  # bytes of a tar: tarfile copies the rest of a piece whenever it reads of it
_HEADER_BYTES = 1 << 20  # of one member in a tar, far more than any honest header has
_PADDING_BYTES = 1 << 25  # after the last member of a tar, at most
_XZ_BYTES = 1 << 27  # of memory; a file that the strongest preset of xz made takes half of them
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

    name: str  # as the archive has it
    kind: str  # "file", "folder", or what it is instead
    size_bytes: int  # as the archive states it; no more come
    open: Callable[[], IO[bytes]]  # of a file, before the next member is asked for


@contextmanager
def damage_told(archive: Path) -> Iterator[None]:
    """Turn what the libraries raise about a damaged archive into DamagedArchive; errors of the disk stay."""
    try:
        yield
    except BadInput:
        raise
    except _DAMAGE as error:
        if isinstance(error, OSError) and error.errno is not None:
            raise
        reason = " ".join(str(error).split()) or type(error).__name__
        raise DamagedArchive(f"{archive} is damaged, or no archive ({reason}): download it anew") from error


def members(archive: Path) -> Iterator[Member]:
    """Yield the members of a zip, tar, tar.gz, tar.bz2 or tar.xz in order, whatever its name is.

    For a file that is none of these, or ends early, it raises what `damage_told` turns into one error.
    """
    with archive.open("rb") as raw:
        start = raw.read(8)
        raw.seek(0)
        yield from _in_zip(raw) if start.startswith(_ZIP) else _in_tar(_decompressed(raw, start))


def _in_zip(raw: BinaryIO) -> Iterator[Member]:
    with zipfile.ZipFile(raw) as opened:
        for info in opened.infolist():
            mode = info.external_attr >> 16  # 0 if the archive was not made under Unix
            if stat.S_ISLNK(mode):
                kind = "a link"
            elif info.flag_bits & 1:
                kind = "encrypted"
            elif info.is_dir():
                kind = "folder"
            elif info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
                kind = "compressed in a way that may fill the memory"  # zipfile bounds no other way
            else:
                kind = "file" if stat.S_IFMT(mode) in (0, stat.S_IFREG) else "no plain file"
            yield Member(info.orig_filename, kind, info.file_size, partial(opened.open, info))


def _in_tar(pieces: Iterator[bytes]) -> Iterator[Member]:
    stream = _Bounded(pieces)
    with tarfile.open(fileobj=cast(IO[bytes], stream), mode="r|", tarinfo=_Header) as opened:
        while (info := opened.next()) is not None:
            if info.issym() or info.islnk():
                kind = "a link"
            elif info.isdir():
                kind = "folder"
            else:
                kind = "file" if info.isreg() and not info.issparse() else "no plain file"
            stream.left = opened.offset - info.offset + _HEADER_BYTES  # the content, and the next header
            content = cast(Callable[[], IO[bytes]], partial(opened.extractfile, info))
            yield Member(info.name, kind, info.size, content)
            opened.members.clear()  # type: ignore[attr-defined]  # tarfile would keep them all ...
            opened.pax_headers.clear()  # type: ignore[attr-defined]  # ... and each header for all that follow
    stream.left = _PADDING_BYTES
    while stream.read():  # gzip compares its checksum at the very end
        pass


class _Header(tarfile.TarInfo):
    """The header of a member, of which tarfile takes an unreadable one for the end of the archive."""

    @classmethod
    def frombuf(cls, buf: bytes | bytearray, encoding: str, errors: str) -> _Header:
        """Read 512 bytes; raises ReadError if they are neither a header nor the zeros that end an archive."""
        try:
            return super().frombuf(buf, encoding, errors)
        except tarfile.EOFHeaderError:  # type: ignore[attr-defined]
            raise
        except tarfile.HeaderError as error:
            raise tarfile.ReadError(f"it ends early: {error}") from error


class _Bounded:
    """What tarfile reads from: it gives no more bytes than are left, for a header may ask for any length."""

    def __init__(self, pieces: Iterator[bytes]) -> None:
        self._pieces = pieces
        self.left = _HEADER_BYTES

    def read(self, _: int = _PIECE) -> bytes:
        """Return the next piece, of any length, and nothing at the end; raises ReadError if no bytes are left."""
        if self.left < 0:
            raise tarfile.ReadError("more bytes than a header has")
        piece = next(self._pieces, b"")
        self.left -= len(piece)
        return piece


def _decompressed(raw: BinaryIO, start: bytes) -> Iterator[bytes]:
    """Yield the content of a tar in pieces, none of them empty."""
    if start.startswith(_XZ):
        yield from filter(None, _unxz(raw))
        return
    opened: IO[bytes] = raw
    if start.startswith(_GZIP):
        opened = cast(IO[bytes], gzip.GzipFile(fileobj=raw))
    elif start.startswith(_BZIP2):
        opened = bz2.BZ2File(raw)
    while piece := opened.read(_PIECE):
        yield piece


def _unxz(raw: BinaryIO) -> Iterator[bytes]:
    """Yield what an xz file holds, in bounded memory: its header may ask for gigabytes, and lzma.open sets no limit."""
    rest = b""
    while rest := rest.lstrip(b"\0") or raw.read(CHUNK).lstrip(b"\0"):  # several streams may follow one another
        stream = lzma.LZMADecompressor(lzma.FORMAT_XZ, memlimit=_XZ_BYTES)
        while not stream.eof:
            if stream.needs_input and not (rest := rest or raw.read(CHUNK)):
                raise EOFError("it ends early")
            yield stream.decompress(rest, _PIECE)
            rest = b""
        rest = stream.unused_data
