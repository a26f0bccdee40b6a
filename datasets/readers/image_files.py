"""The image files of a folder, in an order that does not depend on the file system."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Literal, NoReturn

from natsort import natsorted

from vprbench.api import IMAGE_SUFFIXES, BadInput, NotThere, is_beside, is_folder_beside, is_image_name


def images_in(
    folder: str | Path,
    option: str,
    advice: str,
    *,
    order: Literal["natural", "plain"] = "natural",
    deep: bool = True,
) -> list[Path]:
    """Return the image files of a folder, with `deep` those of its sub-folders too, links followed.

    Left out are lists and what systems put beside frames, such as names that begin with a dot (._1.jpg). A link to a
    file that is gone is returned, so that nothing moves up in its place. In natural order 2.jpg stands before 10.jpg,
    in plain order (that of Python's `sorted` on whole paths) after it. Raises NotThere, with the `option` that named
    the folder and `advice`, if it is none or holds no images, and for a folder that cannot be read; BadInput for
    anything else that may stand for a frame, and for a folder that links lead to a second time.
    """
    top = Path(folder).expanduser()
    if not str(folder) or not top.is_dir():
        raise NotThere(f"{option}: {folder or 'nothing'} is no folder: {advice}")
    files: list[Path] = []
    strangers: list[Path] = []
    for path in _entries(top, deep):
        is_frame = is_image_name(path.name) and (path.is_file() or not path.exists())
        (files if is_frame else strangers).append(path)
    if not files:
        raise NotThere(f"{option}: {folder} holds no images ({', '.join(IMAGE_SUFFIXES)}): {advice}")
    if strangers:
        raise _stranger(option, min(strangers), len(strangers))
    if order == "plain":
        return sorted(files, key=str)
    # Sorted first, so that names which count as equal (1.png, 01.png) have an order too.
    return [Path(path) for path in natsorted(sorted(files))]


def check_listed(files: list[Path], listed_in: str, advice: str) -> None:
    """Raise NotThere, with the first of them and `advice`, if files that a list names are missing."""
    missing = [path for path in files if not path.is_file()]
    if missing:
        raise NotThere(
            f"{missing[0]} does not exist ({len(missing)} of {len(files)} images in {listed_in} are missing): {advice}"
        )


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


def _entries(top: Path, deep: bool) -> Iterator[Path]:
    """Yield the files of a folder, with `deep` of its sub-folders too, but for what is known to lie beside frames.

    A sub-folder under the name of an image is yielded in place of what it holds. Raises BadInput if links lead to
    one folder twice; a link to a folder that it lies in, by other links too, ends there.
    """
    real: dict[Path, Path] = {}  # of every folder met, by its path here
    met: dict[Path, Path] = {}
    for folder, inner, names in os.walk(top, onerror=_refuse, followlinks=True):
        here = Path(folder)
        real[here] = here.resolve()
        if real[here] in met:
            raise BadInput(
                f"{here} is {met[real[here]]} once more, by way of a link: remove the link, or its frames count twice"
            )
        met[real[here]] = here
        around = [real[above] for above in (here, *here.parents) if above in real]
        yield from (here / name for name in names if not is_beside(name))
        inner[:] = [name for name in inner if not is_folder_beside(name)]
        yield from (here / name for name in inner if is_image_name(name))
        inner[:] = [name for name in inner if deep and not is_image_name(name) and not _leads_back(here / name, around)]


def _leads_back(folder: Path, around: list[Path]) -> bool:
    """Tell whether a folder is a link to one that it lies in; `around` are the real paths on the way to it."""
    return folder.is_symlink() and any(above.is_relative_to(folder.resolve()) for above in around)


def _refuse(error: OSError) -> NoReturn:
    raise NotThere(f"{error.filename} cannot be read ({error.strerror}): make it readable; none is skipped") from error
