"""Archives from the net, however damaged or hostile: unpacked whole or not at all, and never beside their folder."""

from __future__ import annotations

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
_ZIP, _XZ = (b"PK\x03\x04", b"PK\x05\x06"), b"\xfd7zXZ\0"
_LONG_HEADERS = (
    *(tarfile.GNUTYPE_LONGNAME, tarfile.GNUTYPE_LONGLINK),
    *(tarfile.XHDTYPE, tarfile.XGLTYPE, tarfile.SOLARIS_XHDTYPE),
)
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
    for n_seen, member in enumerate([plain] if wanted.plain else _members(archive), start=1):
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


def _members(archive: Path) -> Iterator[_Member]:
    with archive.open("rb") as file:
        start = file.read(_HEADER_BYTES)
    if start.startswith(_XZ):  # whose header may ask for gigabytes
        lzma.LZMADecompressor(lzma.FORMAT_XZ, memlimit=_XZ_BYTES).decompress(start, 1)
    return _members_of_zip(archive) if start.startswith(_ZIP) else _members_of_tar(archive)


def _members_of_zip(archive: Path) -> Iterator[_Member]:
    with zipfile.ZipFile(archive) as opened:
        for info in opened.infolist():
            yield _Member(info.orig_filename, _kind_in_zip(info), info.file_size, partial(opened.open, info))


def _members_of_tar(archive: Path) -> Iterator[_Member]:
    with tarfile.open(archive, tarinfo=_Header) as opened:
        for info in opened:
            content = cast(Callable[[], IO[bytes]], partial(opened.extractfile, info))
            yield _Member(info.name, _kind_in_tar(info), info.size, content)
        while opened.fileobj and opened.fileobj.read(_CHUNK):  # gzip compares its checksum at the very end
            pass


def _kind_in_zip(info: zipfile.ZipInfo) -> str:
    mode = stat.S_IFMT(info.external_attr >> 16)  # 0 if the archive was not made under Unix
    if info.is_dir():
        return "folder"
    if info.flag_bits & 1:
        return "encrypted"
    if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        return "compressed in a way that may fill the memory"  # zipfile bounds no other way
    return "file" if mode in (0, stat.S_IFREG) else "no plain file"


def _kind_in_tar(info: tarfile.TarInfo) -> str:
    if info.isdir():
        return "folder"
    return "file" if info.isreg() and not info.issparse() else "no plain file"


class _Header(tarfile.TarInfo):
    """The header of a member: a damaged one is no end of the archive, and none fills the memory."""

    @classmethod
    def frombuf(cls, buf: bytes | bytearray, encoding: str, errors: str) -> _Header:
        """Read 512 bytes; raises ReadError if they are neither a header nor the zeros that end an archive."""
        try:
            return super().frombuf(buf, encoding, errors)
        except tarfile.EOFHeaderError:  # type: ignore[attr-defined]
            raise
        except tarfile.HeaderError as error:
            raise tarfile.ReadError(f"it ends early: {error}") from error

    def _proc_member(self, tar: tarfile.TarFile) -> Any:
        if self.type in _LONG_HEADERS and self.size > _HEADER_BYTES:
            raise tarfile.ReadError(f"a header takes more than {_HEADER_BYTES} bytes")
        if self.type == tarfile.GNUTYPE_SPARSE:
            self._proc_gnusparse_10()
        return super()._proc_member(tar)  # type: ignore[misc]

    def _proc_gnusparse_10(self, *_: Any) -> None:
        raise tarfile.ReadError("it holds a sparse file, whose map may fill the memory")


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
