"""Checks of the folders that frames lie in: what is missing, empty, or no right copy."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from vprbench.api.dataset import FrameFolder
from vprbench.api.decoding import is_image_name
from vprbench.text import format_count, join_names, pick_verb

from .finding import Finding, Level

_HEAD_BYTES = 64
#: How files begin that stand in for an image after a download has failed.
_IMPOSTORS = {
    b"<": "a web page",
    b"{": "a message of a server",
    b"version https://git-lfs": "a Git LFS pointer, not the file it stands for",
    b"PK\x03\x04": "a zip archive",
    b"\x1f\x8b": "a gzip archive",
}


def check_folder(folder: FrameFolder) -> Iterator[Finding]:
    """Find a folder that is not there, files that are missing or empty, and a number that no right copy has.

    Looks at the names and sizes of the files alone.
    """
    if not folder.path.is_dir():
        yield Finding("error", "files", f"{folder.path} is no folder", "put the frames there, or name the right folder")
        return
    with os.scandir(folder.path) as entries:
        sizes = {entry.name: entry.stat().st_size for entry in entries if entry.is_file()}
    used = dict.fromkeys(folder.used)
    if missing := [name for name in used if name not in sizes]:
        yield Finding(
            "error",
            "files",
            f"{len(missing):,} of {format_count(len(used), 'frame')} are missing from {folder.path}: "
            f"{join_names(missing)}",
            "put them back: a frame that is skipped shifts all that follow against the ground truth",
        )
    if empty := [name for name in used if sizes.get(name) == 0]:
        files = f"{format_count(len(empty), 'file')} of {folder.path}"
        text = f"{files} {pick_verb(empty)} empty (0 bytes): {join_names(empty)}"
        yield Finding("error", "files", text, "copy or download them again; the disk may have been full")
    number = sum(map(is_image_name, sizes))
    holds = f"{folder.path} holds {format_count(number, 'image')}"
    if meaning := folder.wrong_counts.get(number):
        advice = "get the copy that the dataset's description names: the same file names show other places in this one"
        yield Finding("error", "count", f"{holds}: {meaning}", advice)
    elif folder.counts and number not in folder.counts:
        level: Level = "warning" if number > max(folder.counts) else "note"
        right = " or ".join(f"{known:,}" for known in folder.counts)
        advice = "make sure that it is the copy that the dataset's description names"
        yield Finding(level, "count", f"{holds}; a whole copy has {right}", advice)


def name_impostor(path: Path) -> str | None:
    """Return what a file that is no image is instead; None if its first bytes do not tell."""
    with path.open("rb") as file:
        head = file.read(_HEAD_BYTES).removeprefix(b"\xef\xbb\xbf").lstrip()
    return next((kind for start, kind in _IMPOSTORS.items() if head.startswith(start)), None)
