"""The image files of a folder, in an order that does not depend on the file system."""

from __future__ import annotations

import difflib
import os
from collections.abc import Sequence
from functools import cache
from itertools import chain, islice
from pathlib import Path
from typing import Literal, NoReturn

from vprbench.api import (
    IMAGE_SUFFIXES,
    BadInput,
    MissingData,
    Paths,
    is_beside,
    is_folder_beside,
    is_image_name,
    natural_keys,
)

from .frame_folders import suggest_folder

_MOST_NAMES = 10_000  # of a folder that are compared with a missing one


def images_in(
    folder: str | Path,
    option: str,
    advice: str,
    *,
    order: Literal["natural", "plain"] = "natural",
    deep: bool = True,
) -> Paths:
    """Return the image files of a folder, with `deep` those of its sub-folders too, links followed.

    Left out are lists and what systems put beside frames, such as names that begin with a dot (._1.jpg). A link to a
    file that is gone is returned, so that nothing moves up in its place. In natural order 2.jpg stands before 10.jpg,
    in plain order (that of Python's `sorted` on whole paths) after it. Raises MissingData, with the `option` that named
    the folder and `advice`, if it is none or holds no images, and for a folder that cannot be read; BadInput for
    anything else that may stand for a frame, and for a folder that links lead to a second time.
    """
    top = Path(folder).expanduser()
    if not str(folder) or not top.is_dir():
        raise MissingData(f"{option}: {folder or 'nothing'} is no folder: {suggest_folder(top)}{advice}")
    frames, strangers = _list_entries(top, deep)
    if not frames:
        raise MissingData(f"{option}: {folder} holds no images ({', '.join(IMAGE_SUFFIXES)}): {advice}")
    if strangers:
        raise BadInput(
            f"{option}: {min(strangers)} is no image file ({len(strangers)} such beside the frames; read are "
            f"{', '.join(IMAGE_SUFFIXES)}): save it as PNG or JPEG if it is a frame, else move it away; none is "
            "skipped, for that would shift all that follow"
        )
    if order == "plain":
        frames.sort()
    else:
        # Sorted first, so that names which count as equal (1.png, 01.png) have an order too.
        frames.sort(key=lambda frame: frame.replace(os.sep, "\0"))
        keys = natural_keys(frames)
        frames = [frames[number] for number in sorted(range(len(frames)), key=keys.__getitem__)]
    return Paths.below(top, frames)


def find_listed(files: Sequence[Path], listed_in: str, advice: str) -> Paths:
    """Return the files that a list names, as the folders have them.

    A file that is missing is the one under slashes for backslashes, or the only one whose name differs in capitals
    alone. Raises MissingData, with the first row, the names nearest to its name and `advice`, if none is there.
    """
    names_in = cache(_group_names)
    found, gone = [], []
    for row, path in enumerate(files, 1):
        there = path
        if not there.is_file():
            there = Path(str(path).replace("\\", "/"))
            alike = names_in(there.parent).get(there.name.casefold(), [])
            if not there.is_file() and len(alike) == 1:
                there = there.with_name(alike[0])
            gone += [] if there.is_file() else [(row, path, there)]
        found.append(there)
    if gone:
        row, path, there = gone[0]
        around = islice(chain(*names_in(there.parent).values()), _MOST_NAMES)
        close = difflib.get_close_matches(there.name, around)
        near = f"did you mean {' or '.join(close)}? else " * bool(close)
        raise MissingData(
            f"{path} does not exist ({len(gone)} of {len(files)} images in {listed_in} are missing), named in row "
            f"{row}: {near}{advice}"
        )
    return Paths.of(found)


def _group_names(folder: Path) -> dict[str, list[str]]:
    """Return the names in a folder by their small letters, in their order; none if it is no folder."""
    groups: dict[str, list[str]] = {}
    for name in sorted(os.listdir(folder) if folder.is_dir() else ()):  # noqa: PTH208 (names alone)
        groups.setdefault(name.casefold(), []).append(name)
    return groups


def _list_entries(top: Path, deep: bool) -> tuple[list[str], list[Path]]:
    """Return the frames in a folder, by their paths from it, and what is none and not known to lie beside frames."""
    frames: list[str] = []
    strangers: list[Path] = []
    met: dict[str, str] = {}  # each folder by its real path
    for here, inner, names in os.walk(top, onerror=_refuse_folder, followlinks=True):
        real = os.path.realpath(here)
        if real in met:
            raise BadInput(
                f"{here} is {met[real]} once more, by way of a link: remove the link, or its frames count twice"
            )
        met[real] = here
        below = Path(here).relative_to(top)
        frames += [str(below / name) for name in names if is_image_name(name) and not name.startswith(".")]
        strangers += [Path(here, name) for name in names if not (is_image_name(name) or is_beside(name))]
        strangers += [Path(here, name) for name in inner if is_image_name(name) and not is_folder_beside(name)]
        inner[:] = [name for name in inner if deep and not is_folder_beside(name)]
    return frames, strangers


def _refuse_folder(error: OSError) -> NoReturn:
    reason = f"{error.filename} cannot be read ({error.strerror})"
    raise MissingData(f"{reason}: make it readable; none is skipped") from error
