"""The image files of a folder, in an order that does not depend on the file system."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from natsort import natsorted

from vprbench.interface import NotThere

SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp", ".ppm", ".pgm")


def images_in(
    folder: str | Path, option: str, *, order: Literal["natural", "plain"] = "natural", deep: bool = True
) -> list[Path]:
    """Return the image files of a folder, those of its sub-folders too where `deep`.

    In natural order 2.jpg stands before 10.jpg, in plain order (that of Python's `sorted` on whole paths) after it.
    Raises NotThere, with the `option` that named the folder, where it is none or holds no images.
    """
    top = Path(folder).expanduser()
    if not str(folder) or not top.is_dir():
        raise NotThere(f"{option}: {folder or 'nothing'} is no folder")
    entries = top.rglob("*") if deep else top.iterdir()
    files = [path for path in entries if path.suffix.lower() in SUFFIXES and path.is_file()]
    if not files:
        raise NotThere(f"{option}: {folder} holds no images ({', '.join(SUFFIXES)})")
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
