"""Archives from the net, however damaged or hostile: read member by member, unpacked whole or not at all."""

from __future__ import annotations

import bz2
import errno
import gzip
import lzma
import re
import shutil
import stat
import struct
import tarfile
import uuid
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import partial
from pathlib import Path
from typing import IO, Any, BinaryIO, ClassVar, Literal, cast

from vprbench.errors import BadInput
from vprbench.progress import report

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
def _explaining_damage(archive: Path) -> Iterator[None]:
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

    For a file that is none of these, or ends early, it raises what `_explaining_damage` turns into one error.
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


UNFINISHED = ".unpacking-"  # how the names of folders begin whose files are not whole yet

_DRIVE = re.compile(r"[A-Za-z]:")
_CONTROL = re.compile(r"[\x00-\x1f\x7f]")
_FULL = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG})
_NOTHING = "nothing was unpacked"


@dataclass(frozen=True)
class Wanted:
    """Which files of an archive are wanted, where they go, and how much they may be."""

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}

    unpacked_bytes: int  # of the wanted files together, at most
    only: str = "*"  # pattern (`fnmatch`) of their paths in the archive; "*" matches "/" too
    strip: int | Literal["all"] = 0  # leading folders that are left out
    into: str = "."  # folder below the destination
    most_files: int = 200_000  # members of the archive, wanted or not
    plain: bool = False  # the file is no archive: it is wanted itself


def unpack(
    archive: Path, destination: Path, wanted: Wanted, approve: Callable[[Path], None] = lambda folder: None
) -> int:
    """Put the wanted files of a zip, tar, tar.gz, tar.bz2 or tar.xz, or a plain file, into a folder; returns how many.

    They get there when all are unpacked and `approve`, given the folder that holds them until then, has not raised.
    Hidden files are left out. Raises DamagedArchive for a file that ends early or is no archive, and BadInput for
    links, devices, duplicates, paths that lead out, more than is wanted, a full disk, and if something would be
    replaced. The destination is then as it was.
    """
    try:
        destination.mkdir(parents=True, exist_ok=True)
        folder = destination / f"{UNFINISHED}{uuid.uuid4().hex[:8]}"
        folder.mkdir()
        try:
            with _explaining_damage(archive):
                n_files = _fill(folder, archive, wanted)
            approve(folder)
            _move(folder, destination)
        finally:
            shutil.rmtree(folder, ignore_errors=True)
    except OSError as error:
        advice = "free some space" if error.errno in _FULL else "mend that"
        cause = f"{error.filename or destination}: {error.strerror or error}"
        raise BadInput(f"{archive} cannot be unpacked ({cause}), {_NOTHING}: {advice} and run again") from error
    return n_files


def _fill(folder: Path, archive: Path, wanted: Wanted) -> int:
    """Unpack the wanted files into an empty folder; returns how many files."""
    n_files = done_bytes = 0
    stage = f"unpacking {archive.name}"
    report(stage, 0.0)
    plain = Member(archive.name, "file", archive.stat().st_size, lambda: archive.open("rb"))
    for n_seen, member in enumerate([plain] if wanted.plain else members(archive), start=1):
        if n_seen > wanted.most_files:
            raise BadInput(f"{archive} holds more than {wanted.most_files} files, the most expected: {_NOTHING}")
        path = _path(archive, member, wanted)
        if path is None:
            continue
        if done_bytes + member.size_bytes > wanted.unpacked_bytes:
            raise BadInput(f"{archive} holds more than {wanted.unpacked_bytes} bytes, the most expected: {_NOTHING}")
        target = folder / path
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            file = target.open("xb")
        except (FileExistsError, NotADirectoryError) as error:
            raise BadInput(f"{archive} holds {path} twice: {_NOTHING}, do not use it") from error
        with file, member.open() as content:
            while chunk := content.read(CHUNK):
                done_bytes += len(chunk)
                file.write(chunk)
                report(stage, done_bytes / wanted.unpacked_bytes)
        n_files += 1
    if not n_files:
        raise BadInput(f"{archive} holds no file like {wanted.only}: {_NOTHING}, it is another archive than expected")
    report(stage, 1.0)
    return n_files


def _path(archive: Path, member: Member, wanted: Wanted) -> Path | None:
    """Return where a member goes, None if it is not wanted; raises BadInput for a member that nobody should want."""
    name, shown = member.name, ascii(member.name)
    parts = [part for part in name.split("/") if part not in ("", ".")]
    if name.startswith("/") or ".." in parts or "\\" in name or any(map(_DRIVE.match, parts)):
        raise BadInput(f"{archive} holds {shown}, which leads out of its folder: {_NOTHING}, do not use it")
    if _CONTROL.search(name):
        raise BadInput(f"{archive} holds {shown}, which is no name of a file: {_NOTHING}, do not use it")
    hidden = any(part.startswith(".") or part == "__MACOSX" for part in parts)
    if hidden or member.kind == "folder" or not fnmatchcase("/".join(parts), wanted.only):
        return None
    if member.kind != "file":
        raise BadInput(f"{archive} holds {shown}, which is {member.kind}: {_NOTHING}, do not use it")
    strip = len(parts) - 1 if wanted.strip == "all" else wanted.strip
    if strip >= len(parts):
        raise BadInput(f"{archive} holds {shown}, expected in {strip} folders: {_NOTHING}, it is another archive")
    return Path(wanted.into, *parts[strip:])


def _move(folder: Path, destination: Path) -> None:
    """Rename every entry of a folder to its place in the destination, or none of them."""
    entries = sorted(folder.iterdir())
    for entry in entries:
        target = destination / entry.name
        empty = target.is_dir() and not any(target.iterdir())
        if target.is_symlink() or (target.exists() and not empty):
            raise BadInput(f"{target} is there already: {_NOTHING}, move it away and run again")
    moved: list[Path] = []
    try:
        for entry in entries:
            target = destination / entry.name
            if target.exists():
                target.rmdir()
            entry.rename(target)
            moved.append(entry)
    except BaseException:
        for entry in moved:
            (destination / entry.name).rename(entry)
        raise
