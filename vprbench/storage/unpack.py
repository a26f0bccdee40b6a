"""Archives from the net, however damaged or hostile: unpacked whole or not at all, and never beside their folder."""

from __future__ import annotations

import bz2
import gzip
import lzma
import re
import shutil
import stat
import struct
import sys
import tarfile
import uuid
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import partial
from pathlib import Path
from typing import IO, Any, ClassVar, Literal, cast

from vprbench.errors import BadInput
from vprbench.progress import report

UNFINISHED = ".unpacking-"  # how the names of folders begin whose files are not whole yet

_CHUNK = 1 << 20  # bytes read at once
_HEADER_BYTES = 1 << 20  # of one member in a tar, far more than any honest header has
_XZ_BYTES = 1 << 27  # of memory; a file that the strongest preset of xz made takes half of them
_ZIP, _GZIP, _BZ2, _XZ = (b"PK\x03\x04", b"PK\x05\x06"), b"\x1f\x8b", b"BZh", b"\xfd7zXZ\0"
_DAMAGE = (  # the errors by which the libraries report damage
    *(zipfile.BadZipFile, tarfile.TarError, zlib.error, lzma.LZMAError, struct.error),
    *(EOFError, ValueError, OverflowError, IndexError, RuntimeError),
)
_FORBIDDEN = re.compile(r"^/|\\|[\x00-\x1f\x7f]|(^|/)(\.\.(/|$)|[A-Za-z]:)")


class DamagedArchive(BadInput):
    """An archive that cannot be read to its end: it has to be downloaded anew."""


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


@dataclass(frozen=True)
class _Member:
    """A file, a folder or something else in an archive."""

    name: str
    kind: str  # "file", "folder", or a description of anything else
    size_bytes: int  # as the archive states it
    open: Callable[[], IO[bytes]]  # of a file


def unpack(
    archive: Path, destination: Path, wanted: Wanted, approve: Callable[[Path], None] = lambda folder: None
) -> int:
    """Put the wanted files of a zip, tar, tar.gz, tar.bz2 or tar.xz, or a plain file, into a folder; returns how many.

    Hidden files are left out. The files are unpacked into a folder of their own, and get to their places after
    `approve`, given that folder, has not raised. Nothing that is there is replaced.

    Raises:
        DamagedArchive: The file ends early or is no archive.
        BadInput: The archive holds links, devices, duplicates, paths that lead out, or more than is wanted; files are
            in the way, or the disk refuses. Nothing is unpacked then.
    """
    try:
        destination.mkdir(parents=True, exist_ok=True)
        folder = destination / f"{UNFINISHED}{uuid.uuid4().hex[:8]}"
        folder.mkdir()
        try:
            n_files = _fill(folder, archive, wanted)
            approve(folder)
            _move(folder, destination)
        finally:
            shutil.rmtree(folder, ignore_errors=True)
    except BadInput as error:
        raise type(error)(f"{archive} {error}; nothing was unpacked") from error
    except OSError as error:
        if error.errno is None:  # gzip and bz2 report damage by it
            raise _describe_damage(archive, error) from error
        raise BadInput(
            f"{archive} cannot be unpacked into {destination} ({error.strerror}), and nothing was: free some space, or "
            "choose another folder"
        ) from error
    except _DAMAGE as error:
        raise _describe_damage(archive, error) from error
    return n_files


def _describe_damage(archive: Path, error: Exception) -> DamagedArchive:
    reason = " ".join(str(error).split()) or type(error).__name__
    return DamagedArchive(f"{archive} is damaged, or no archive ({reason}): download it anew")


def _fill(folder: Path, archive: Path, wanted: Wanted) -> int:
    """Unpack the wanted files into an empty folder; returns how many files."""
    n_files = done_bytes = 0
    stage = f"unpacking {archive.name}"
    report(stage, 0.0)
    plain = _Member(archive.name, "file", archive.stat().st_size, lambda: archive.open("rb"))
    for n_seen, member in enumerate([plain] if wanted.plain else _list_members(archive), start=1):
        if n_seen > wanted.most_files:
            raise BadInput(f"holds more than {wanted.most_files} files, the most expected")
        path = _place_of(member, wanted)
        if path is None:
            continue
        done_bytes += member.size_bytes  # no more come: zipfile and tarfile end a file there
        if done_bytes > wanted.unpacked_bytes:
            raise BadInput(f"holds more than {wanted.unpacked_bytes} bytes, the most expected")
        target = folder / path
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            file = target.open("xb")
        except (FileExistsError, NotADirectoryError) as error:
            raise BadInput(f"holds {path} twice") from error
        with file, member.open() as content:
            shutil.copyfileobj(content, file, _CHUNK)
        report(stage, done_bytes / wanted.unpacked_bytes)
        n_files += 1
    if not n_files:
        raise BadInput(f"holds no file like {wanted.only}: it is another archive than expected")
    report(stage, 1.0)
    return n_files


def _list_members(archive: Path) -> Iterator[_Member]:
    with ExitStack() as stack:
        file: IO[bytes] = stack.enter_context(archive.open("rb"))
        start = file.read(_CHUNK)
        file.seek(0)
        if start.startswith(_ZIP):
            yield from _list_zip(file)
            return
        if start.startswith(_GZIP):
            file = cast(IO[bytes], stack.enter_context(gzip.open(file)))
        elif start.startswith(_BZ2):
            file = stack.enter_context(bz2.open(file))
        elif start.startswith(_XZ):
            lzma.LZMADecompressor(lzma.FORMAT_XZ, memlimit=_XZ_BYTES).decompress(start, 1)  # as its header asks for
            file = stack.enter_context(lzma.open(file))
        yield from _list_tar(file)


def _list_zip(file: IO[bytes]) -> Iterator[_Member]:
    with zipfile.ZipFile(file) as opened:
        for info in opened.infolist():
            mode = stat.S_IFMT(info.external_attr >> 16)  # 0 if the archive was not made under Unix
            kind = "file" if mode in (0, stat.S_IFREG) else "no plain file"
            if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
                kind = "compressed in a way that may fill the memory"  # zipfile bounds no other way
            kind = "folder" if info.is_dir() else kind
            yield _Member(info.orig_filename, kind, info.file_size, partial(opened.open, info))


def _list_tar(file: IO[bytes]) -> Iterator[_Member]:
    bounded = _BoundedHeaders(file)
    with tarfile.open(fileobj=cast(IO[bytes], bounded), mode="r:") as opened:
        while info := opened.next():
            kind = "file" if info.isreg() and not info.issparse() else "no plain file"
            content = cast(Callable[[], IO[bytes]], partial(opened.extractfile, info))
            bounded.left = sys.maxsize
            yield _Member(info.name, "folder" if info.isdir() else kind, info.size, content)
            bounded.left = _HEADER_BYTES
        while file.read(_CHUNK):  # gzip compares its checksum at the very end
            pass


class _BoundedHeaders:
    """A tar whose headers are read to 1 MiB: a name or a map of a sparse file may state gigabytes."""

    def __init__(self, file: IO[bytes]) -> None:
        self.tell, self.seek = file.tell, file.seek
        self._file = file
        self.left = _HEADER_BYTES  # bytes that may be read

    def read(self, n_bytes: int) -> bytes:
        """Read some bytes; raises ReadError if the header of a member takes more than 1 MiB."""
        self.left -= n_bytes
        if self.left < 0:
            raise tarfile.ReadError(f"a header takes more than {_HEADER_BYTES} bytes")
        return self._file.read(n_bytes)


def _place_of(member: _Member, wanted: Wanted) -> Path | None:
    """Return where a member goes, None if it is not wanted; raises BadInput for a member that nobody should want."""
    name, shown = member.name, ascii(member.name)
    if _FORBIDDEN.search(name):
        raise BadInput(f"holds {shown}, which leads out of its folder or is no name of a file: do not use it")
    parts = [part for part in name.split("/") if part not in ("", ".")]
    hidden = any(part.startswith(".") or part == "__MACOSX" for part in parts)
    if hidden or member.kind == "folder" or not fnmatchcase("/".join(parts), wanted.only):
        return None
    if member.kind != "file":
        raise BadInput(f"holds {shown}, which is {member.kind}: do not use it")
    strip = len(parts) - 1 if wanted.strip == "all" else wanted.strip
    if strip >= len(parts):
        raise BadInput(f"holds {shown}, expected in {strip} folders: it is another archive")
    return Path(wanted.into, *parts[strip:])


def _move(folder: Path, destination: Path) -> None:
    """Rename every entry of a folder to its place in the destination, where nothing but empty folders may be."""
    entries = sorted(folder.iterdir())
    for entry in entries:
        target = destination / entry.name
        is_empty = target.is_dir() and not any(target.iterdir())
        if target.is_symlink() or (target.exists() and not is_empty):
            raise BadInput(f"is not unpacked, for {target} is there already: move it away and run again")
    for entry in entries:
        entry.replace(destination / entry.name)
