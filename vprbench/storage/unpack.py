"""Archives from the net, unpacked whole or not at all: nothing leaves its folder, fills the disk or links elsewhere."""

from __future__ import annotations

import errno
import re
import shutil
import uuid
from collections.abc import Callable
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, ClassVar, Literal

from vprbench.errors import BadInput
from vprbench.progress import report
from vprbench.storage.archives import CHUNK, Member, damage_told, members

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
            with damage_told(archive):
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
