"""Checks of the folders that frames lie in: what is missing, empty, no image, too many, or not used."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

import numpy as np

from vprbench.api.dataset import FrameFolder
from vprbench.api.decoding import is_beside, is_image_name
from vprbench.text import be, plural, some

from .finding import Finding, Level

_FAR_OFF = 4  # times the median size, or a part of it
_LOOKED_INTO = 200  # files of a folder whose first bytes are read
_SPREAD = 50  # among them of any size
_SPREAD_IN_ALL = 2000  # these in all folders, but one in each
_HEAD_BYTES = 64
_EMPTY, _STRANGE = "empty (0 bytes)", "no image that can be read, and not used"
_ADVICE = {
    _EMPTY: "copy or download them again; the disk may have been full",
    _STRANGE: "if it is a frame, save it as PNG or JPEG and list it; else move it away",
}
#: How files begin that stand in for an image after a download has failed.
_IMPOSTORS = {
    b"<": "a web page",
    b"{": "a message of a server",
    b"version https://git-lfs": "a Git LFS pointer, not the file it stands for",
    b"PK\x03\x04": "a zip archive",
    b"\x1f\x8b": "a gzip archive",
}


@dataclass(frozen=True)
class Contents:
    """The files of a folder, by one look into it."""

    folder: FrameFolder
    sizes: Mapping[str, int]  # bytes by file name
    images: list[str]  # by their suffix, sorted
    unused: list[str]  # images that the dataset does not use, sorted
    used: Mapping[str, int]  # bytes of the files that are used and there
    missing: list[str]  # what the dataset wants and the folder lacks
    unfit: Mapping[str, list[str]]  # used files that are no images, by what they are instead

    @property
    def broken(self) -> set[Path]:
        """The paths of files that are known to be unreadable without decoding them."""
        return {self.folder.path / name for name in (*self.missing, *chain(*self.unfit.values()))}


def contents(folder: FrameFolder, n_folders: int) -> Contents | None:
    """Return the files of one of so many folders; None if it is no folder."""
    if not folder.path.is_dir():
        return None
    with os.scandir(folder.path) as entries:
        sizes = {entry.name: entry.stat().st_size for entry in entries if entry.is_file()}
    images = sorted(filter(is_image_name, sizes))
    wanted = dict.fromkeys(folder.used)
    used = {name: sizes[name] for name in wanted if name in sizes}
    missing = [name for name in wanted if name not in sizes]
    unfit = _unfit(folder.path, used, min(_SPREAD, max(1, _SPREAD_IN_ALL // n_folders)))
    return Contents(folder, sizes, images, [name for name in images if name not in wanted], used, missing, unfit)


def _unfit(path: Path, used: Mapping[str, int], spread: int) -> dict[str, list[str]]:
    """Return the names of used files that are no images, by what they are instead.

    Looks into files of unusual size and `spread` others first, and into all files if one of these is no image.
    """
    kinds = {_EMPTY: empty} if (empty := [name for name, size in used.items() if not size]) else {}
    if any(_impostor(path / name) for name in _suspects(used, spread)):
        for name in used:
            if kind := _impostor(path / name):
                kinds.setdefault(kind, []).append(name)
    return kinds


def of_folder(folder: FrameFolder, found: Contents | None) -> Iterator[Finding]:
    """Find a folder that is not there, files that are missing or no images, and a number that no right copy has."""
    if found is None:
        advice = "put the frames there, or name the right folder"
        yield Finding("error", "files", f"{folder.path} is no folder", advice)
        return
    if found.missing:
        yield Finding(
            "error",
            "files",
            f"{len(found.missing):,} of {plural(len(set(folder.used)), 'frame')} are missing from {folder.path}: "
            f"{some(found.missing)}",
            "put them back: a frame that is skipped shifts all that follow against the ground truth",
        )
    yield from _count(folder, len(found.images))
    others = found.sizes.keys() - {*folder.used}
    strangers = sorted(name for name in others if not is_image_name(name) and not is_beside(name))
    for kind, names in {**found.unfit, _STRANGE: strangers}.items():
        if names:
            text = f"{plural(len(names), 'file')} of {folder.path} {be(names)} {kind}: {some(names)}"
            level: Level = "note" if kind == _STRANGE else "error"
            advice = _ADVICE.get(kind, "download them again, and look at how the download answers")
            yield Finding(level, "files", text, advice)


def _count(folder: FrameFolder, number: int) -> Iterator[Finding]:
    """Find a number of images that is not that of the right copy."""
    holds = f"{folder.path} holds {plural(number, 'image')}"
    if meaning := folder.wrong_counts.get(number):
        advice = "get the copy that the dataset's description names: the same file names show other places in this one"
        yield Finding("error", "count", f"{holds}: {meaning}", advice)
    elif folder.counts and number not in folder.counts:
        level: Level = "warning" if number > max(folder.counts) else "note"
        right = " or ".join(f"{known:,}" for known in folder.counts)
        advice = "make sure that it is the copy that the dataset's description names"
        yield Finding(level, "count", f"{holds}; a whole copy has {right}", advice)


def unused_images(found: Contents, looked_at: int = 0, black: int = 0) -> Iterator[Finding]:
    """Tell how many images of the folder are not used, and how many of the `looked_at` unused images are black."""
    unused = found.unused
    if not unused:
        return
    of_these = "of these" if looked_at == len(unused) else f"of {looked_at:,} of these that were looked at"
    dark = f"; {of_these} {black:,} {'is' if black == 1 else 'are'} black, as in tunnels" if black else ""
    yield Finding(
        "note",
        "unused",
        f"{found.folder.path.name} holds {plural(len(found.images), 'image')}, of which the dataset uses "
        f"{len(found.used):,} and leaves {len(unused):,} out{dark}",
    )


def _suspects(sizes: Mapping[str, int], spread: int) -> Iterable[str]:
    """Return the names of files far from the usual size, and of some spread evenly over all; no empty ones."""
    names = [name for name, size in sizes.items() if size]
    if not names:
        return []
    usual = float(np.median([sizes[name] for name in names]))
    odd = [name for name in names if not usual / _FAR_OFF <= sizes[name] <= usual * _FAR_OFF]
    evenly = np.linspace(0, len(names) - 1, min(len(names), spread)).astype(int)
    return dict.fromkeys([*odd[:_LOOKED_INTO], *(names[number] for number in evenly)])


def _impostor(path: Path) -> str | None:
    with path.open("rb") as file:
        head = file.read(_HEAD_BYTES).removeprefix(b"\xef\xbb\xbf").lstrip()
    return next((kind for start, kind in _IMPOSTORS.items() if head.startswith(start)), None)
