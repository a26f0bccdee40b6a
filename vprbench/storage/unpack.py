"""Archives from the net, damaged and hostile ones too: unpacked whole or not at all, and never beside their folder."""

from __future__ import annotations

import os
import shutil
import stat
import tarfile
import zipfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import partial
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import IO, Any, ClassVar, Literal, cast

from vprbench.errors import BadInput
from vprbench.progress import report

UNFINISHED = ".unpacking-"  # begins the names of folders whose files are not whole yet
_CHUNK = 1 << 20  # bytes read at once

_Member = tuple[str, int, bool, Callable[[], IO[bytes]]]  # name, bytes, whether it is a plain file, a way to open it


class DamagedArchive(BadInput):
    """An archive that cannot be read to its end: it has to be downloaded anew."""


@dataclass(frozen=True)
class Wanted:
    """Which files of an archive are wanted, where they go, and how much they may be."""

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}

    unpacked_bytes: int  # of the wanted files together, at most
    only: str = "*"  # pattern (`fnmatch`) of their paths in the archive; "*" matches "/" too
    strip: int | Literal["all"] = 0  # leading folders that are left out, with the files in fewer folders
    into: str = "."  # folder below the destination
    most_files: int = 200_000  # of the archive, wanted or not
    plain: bool = False  # the file is no archive: it is wanted itself


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
        with TemporaryDirectory(prefix=UNFINISHED, dir=destination, ignore_cleanup_errors=True) as folder:
            n_files = _unpack_members(Path(folder), archive, wanted)
            approve(Path(folder))
            _move_entries(Path(folder), destination)
            return n_files
    except BadInput as error:
        raise type(error)(f"{archive} {error}; nothing was unpacked") from error
    except Exception as error:  # a damaged archive fails in many ways, by an OSError without a number too
        if isinstance(error, OSError) and error.errno is not None:
            refusal = f"{archive} cannot be unpacked into {destination} ({error.strerror}), and nothing was"
            raise BadInput(f"{refusal}: free some space, or choose another folder") from error
        reason = " ".join(str(error).split()) or type(error).__name__
        raise DamagedArchive(f"{archive} is damaged, or no archive ({reason}): download it anew") from error


def _unpack_members(folder: Path, archive: Path, wanted: Wanted) -> int:
    """Unpack the wanted files into an empty folder; returns how many files."""
    if wanted.plain:
        members: Iterable[_Member] = [(archive.name, archive.stat().st_size, True, lambda: archive.open("rb"))]
    else:
        with archive.open("rb") as start:  # a tar may hold a zip, so that zipfile would take it for one
            members = (_list_zip if start.read(2) == b"PK" else _list_tar)(archive)
    n_files = done_bytes = 0
    for n_seen, (name, n_bytes, is_file, open_member) in enumerate(members, start=1):
        path = _choose_place(PurePosixPath(name), wanted)
        done_bytes += n_bytes if path else 0  # no more come: zipfile and tarfile end a file there
        if n_seen > wanted.most_files or done_bytes > wanted.unpacked_bytes:
            most = f"{wanted.most_files} files or {wanted.unpacked_bytes} bytes"
            raise BadInput(f"holds more than {most}, the most expected: do not use it")
        if path is None:
            continue
        if not is_file:
            raise BadInput(f"holds {name!a}, which is no plain file: do not use it")
        try:
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            with (folder / path).open("xb") as file, open_member() as content:
                shutil.copyfileobj(content, file, _CHUNK)
        except (FileExistsError, NotADirectoryError) as error:
            raise BadInput(f"holds {path} twice: do not use it") from error
        report(f"unpacking {archive.name}", done_bytes / wanted.unpacked_bytes)
        n_files += 1
    if not n_files:
        raise BadInput(f"holds no file like {wanted.only}: it is another archive than expected")
    return n_files


def _list_zip(archive: Path) -> Iterator[_Member]:
    with zipfile.ZipFile(archive) as opened:
        for info in opened.infolist():
            if not info.is_dir():
                mode = stat.S_IFMT(info.external_attr >> 16)  # 0 if the archive was not made under Unix
                yield info.filename, info.file_size, mode in (0, stat.S_IFREG), partial(opened.open, info)


def _list_tar(archive: Path) -> Iterator[_Member]:
    with tarfile.open(archive) as tar:
        for info in tar:
            if not info.isdir():
                yield info.name, info.size, info.isreg(), partial(cast(Any, tar.extractfile), info)
        while tar.fileobj and tar.fileobj.read(_CHUNK):  # gzip compares its checksum at the very end
            pass


def _choose_place(name: PurePosixPath, wanted: Wanted) -> Path | None:
    """Return where a member goes, None if it is not wanted; raises BadInput for a member that leads out."""
    if name.is_absolute() or ".." in name.parts:
        raise BadInput(f"holds {str(name)!a}, which leads out of its folder: do not use it")
    kept = name.parts[-1:] if wanted.strip == "all" else name.parts[wanted.strip :]
    is_hidden = any(part.startswith(".") or part == "__MACOSX" for part in name.parts)
    return None if is_hidden or not kept or not fnmatchcase(str(name), wanted.only) else Path(wanted.into, *kept)


def _move_entries(folder: Path, destination: Path) -> None:
    """Rename every entry of a folder to its place in the destination, where nothing but empty folders may be."""
    targets = {entry: destination / entry.name for entry in folder.iterdir()}
    for target in targets.values():
        with suppress(OSError):  # no folder, or one that is not empty
            target.rmdir()
        if os.path.lexists(target):
            raise BadInput(f"is not unpacked, for {target} is there already: move it away and run again")
    for entry, target in targets.items():
        entry.rename(target)
