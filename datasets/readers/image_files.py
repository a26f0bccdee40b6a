"""The image files of a folder, in an order that does not depend on the file system."""

from __future__ import annotations

import difflib
import os
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Literal

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

from .frame_folders import nearest_folder

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
        raise MissingData(f"{option}: {folder or 'nothing'} is no folder: {nearest_folder(top)}{advice}")
    frames, strangers = _entries(top, deep)
    if not frames:
        raise MissingData(f"{option}: {folder} holds no images ({', '.join(IMAGE_SUFFIXES)}): {advice}")
    if strangers:
        raise _stranger(option, min(strangers), len(strangers))
    if order == "plain":
        frames.sort()
    else:
        # Sorted first, so that names which count as equal (1.png, 01.png) have an order too.
        frames.sort(key=lambda frame: frame.replace(os.sep, "\0"))
        keys = natural_keys(frames)
        frames = [frames[number] for number in sorted(range(len(frames)), key=keys.__getitem__)]
        del keys  # as large as the list
    return Paths.below(top, frames)


def find_listed(files: Sequence[Path], listed_in: str, advice: str) -> Paths:
    """Return the files that a list names, as the folders have them.

    A file that is missing is the one under slashes for backslashes, or the only one whose name differs in capitals
    alone. Raises MissingData, with the first row, the names nearest to its name and `advice`, if none is there.
    """
    files = Paths.of(files)
    missing = [number for number, path in enumerate(files) if not path.is_file()]
    if not missing:
        return files
    in_folder = cache(_names_in)
    found = {number: there for number in missing if (there := _same_file(files[number], in_folder))}
    gone = [number for number in missing if number not in found]
    if gone:
        path = files[gone[0]]
        slashed = Path(str(path).replace("\\", "/"))
        close = difflib.get_close_matches(slashed.name, in_folder(slashed.parent)[:_MOST_NAMES])
        near = f"did you mean {' or '.join(close)}? else " * bool(close)
        raise MissingData(
            f"{path} does not exist ({len(gone)} of {len(files)} images in {listed_in} are missing), named in row "
            f"{gone[0] + 1}: {near}{advice}"
        )
    return Paths.of(found.get(number, path) for number, path in enumerate(files))


def _names_in(folder: Path) -> list[str]:
    try:
        return sorted(entry.name for entry in folder.iterdir())
    except OSError:
        return []


def _same_file(path: Path, in_folder: Callable[[Path], list[str]]) -> Path | None:
    """Return the file that a path means under other slashes or capitals; None if there is none, or are several."""
    slashed = Path(str(path).replace("\\", "/"))
    alike = [name for name in in_folder(slashed.parent) if name.casefold() == slashed.name.casefold()]
    named = [name for name in alike if name == slashed.name] or alike
    return slashed.parent / named[0] if len(named) == 1 and (slashed.parent / named[0]).is_file() else None


def _stranger(option: str, first: Path, count: int) -> BadInput:
    """Return what to raise for entries of a folder that are no images and may stand for frames."""
    if first.is_dir():
        kind = "a folder under the name of an image"
    elif is_image_name(first.name):
        kind = "no file but a pipe, a device or the like"
    else:
        kind = f"none of the images that are read ({', '.join(IMAGE_SUFFIXES)})"
    more = f", like {count - 1} more beside the frames" if count > 1 else ""
    return BadInput(
        f"{option}: {first} is {kind}{more}: save it as PNG or JPEG if it is a frame, else move it away; none is "
        "skipped, for that would shift all that follow"
    )


def _entries(top: Path, deep: bool) -> tuple[list[str], list[Path]]:
    """Return the frames in a folder, by their paths from it, and what is none and not known to lie beside frames.

    With `deep` those of its sub-folders too; one under the name of an image stands for what it holds. Raises
    MissingData for a folder that cannot be read, BadInput if links lead to one folder twice; a link to a folder that
    it lies in, by other links too, ends there.
    """
    frames: list[str] = []
    strangers: list[Path] = []
    real: dict[Path, Path] = {}  # of every folder met, by its path here
    met: dict[Path, Path] = {}
    waiting = [top]
    while waiting:
        here = waiting.pop()
        real[here] = here.resolve()
        if real[here] in met:
            raise BadInput(
                f"{here} is {met[real[here]]} once more, by way of a link: remove the link, or its frames count twice"
            )
        met[real[here]] = here
        below = "" if here == top else f"{here.relative_to(top)}{os.sep}"
        inner = []
        try:
            with os.scandir(here) as entries:
                for entry in entries:
                    name = entry.name
                    if _is_folder(entry):
                        inner.append(name)
                    elif not is_image_name(name):
                        strangers += [] if is_beside(name) else [here / name]
                    elif _is_frame(entry):
                        frames.append(below + name)
                    elif not is_beside(name):
                        strangers.append(here / name)
        except OSError as error:
            raise MissingData(
                f"{error.filename} cannot be read ({error.strerror}): make it readable; none is skipped"
            ) from error
        inner = [name for name in inner if not is_folder_beside(name)]
        strangers += [here / name for name in inner if is_image_name(name)]
        around = [real[above] for above in (here, *here.parents) if above in real]
        further = [here / name for name in inner if deep and not is_image_name(name)]
        waiting += [folder for folder in reversed(further) if not _leads_back(folder, around)]
    return frames, strangers


def _is_folder(entry: os.DirEntry[str]) -> bool:
    try:
        return entry.is_dir()
    except OSError:
        return False


def _is_frame(entry: os.DirEntry[str]) -> bool:
    """Tell whether an entry under the name of an image is a file, or a link to one that is gone."""
    if entry.name.startswith("."):
        return False
    return entry.is_file(follow_symlinks=False) or (path := Path(entry.path)).is_file() or not path.exists()


def _leads_back(folder: Path, around: list[Path]) -> bool:
    """Tell whether a folder is a link to one that it lies in; `around` are the real paths on the way to it."""
    return folder.is_symlink() and any(above.is_relative_to(folder.resolve()) for above in around)
