"""The image files of a folder, in an order that does not depend on the file system."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Literal, NoReturn

from natsort import natsorted

from vprbench.interface import NotThere

SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp", ".ppm", ".pgm")


def images_in(
    folder: str | Path,
    option: str,
    advice: str,
    *,
    order: Literal["natural", "plain"] = "natural",
    deep: bool = True,
) -> list[Path]:
    """Return the image files of a folder, those of its sub-folders too where `deep`, links followed.

    Names that begin with a dot are none: systems put files of their own there (._1.jpg). A link to a file that is gone
    is returned, so that nothing moves up in its place. In natural order 2.jpg stands before 10.jpg, in plain order
    (that of Python's `sorted` on whole paths) after it. Raises NotThere, with the `option` that named the folder and
    `advice`, where it is none or holds no images, and for a folder that cannot be read.
    """
    top = Path(folder).expanduser()
    if not str(folder) or not top.is_dir():
        raise NotThere(f"{option}: {folder or 'nothing'} is no folder: {advice}")
    named = (path for path in _files(top, deep) if path.suffix.lower() in SUFFIXES)
    files = [path for path in named if path.is_file() or not path.exists()]
    if not files:
        raise NotThere(f"{option}: {folder} holds no images ({', '.join(SUFFIXES)}): {advice}")
    if order == "plain":
        return sorted(files, key=str)
    # Sorted first, so that names which count as equal (1.png, 01.png) have an order too.
    return [Path(path) for path in natsorted(sorted(files))]


def check_listed(files: list[Path], listed_in: str, advice: str) -> None:
    """Raise NotThere, with the first of them and `advice`, where some of the files that a list names are missing."""
    missing = [path for path in files if not path.is_file()]
    if missing:
        raise NotThere(
            f"{missing[0]} does not exist ({len(missing)} of {len(files)} images in {listed_in} are missing): {advice}"
        )


def _files(top: Path, deep: bool) -> Iterator[Path]:
    """Yield the files of a folder that are not hidden, and those of its sub-folders where `deep`."""
    for folder, inner, names in os.walk(top, onerror=_refuse, followlinks=True):
        here = Path(folder)
        inner[:] = [name for name in inner if deep and not name.startswith(".") and not _leads_back(here / name)]
        yield from (here / name for name in names if not name.startswith("."))


def _leads_back(folder: Path) -> bool:
    """Tell whether a folder is a link to one that it lies in."""
    return folder.is_symlink() and folder.parent.resolve().is_relative_to(folder.resolve())


def _refuse(error: OSError) -> NoReturn:
    raise NotThere(f"{error.filename} cannot be read ({error.strerror}): make it readable; none is skipped") from error
