"""Frames that somebody put into folders, one for each traverse: found, and checked before anything is read."""

from __future__ import annotations

import difflib
import os
from collections.abc import Collection, Sequence
from itertools import chain
from pathlib import Path

from vprbench.api import FrameFolder, MissingData, checkout_folder, data_folder, is_folder_beside

_SUFFIXES = (".png", ".jpg", ".jpeg")
_ARCHIVES = "archives"  # what was downloaded and not unpacked yet


def find_root(
    name: str,
    root: str | None,
    holding: str,
    layout: str,
    download: str | None = None,
    default_root: str | None = None,
    parts: Collection[str] = (),
) -> Path:
    """Return the folder of dataset `name` that holds what `holding` says; raises MissingData with `layout`, what to do.

    Where that has not the folders `parts`, it is the only folder in it that has them, as a zip is unpacked.

    A `root` of None is the folder that downloads of the dataset lie in, if it holds anything, else `default_root`
    (relative to the checkout) if it exists; `download` names the download folder if several datasets share one.
    """
    kept = data_folder(download or name)
    if root is not None:
        top = Path(root).expanduser()
        if not top.is_dir():
            raise MissingData(
                f"dataset.root={root} is no folder: {name} needs the unpacked one that holds {holding}; {layout}"
            )
    elif kept.is_dir() and any(each.name != _ARCHIVES and not each.name.startswith(".") for each in kept.iterdir()):
        top = kept
    elif default_root is not None and (checkout_folder() / default_root).is_dir():
        top = checkout_folder() / default_root
    else:
        raise MissingData(
            f"dataset.root is not set: {name} needs the folder that holds {holding}; {layout}, or call that folder "
            f"{kept}" + " (which holds no frames yet: a download was not finished)" * kept.is_dir()
        )
    inner = [] if _has_folders(top, parts) else [each for each in list_folders(top) if _has_folders(each, parts)]
    return inner[0] if len(inner) == 1 else top


def _has_folders(top: Path, parts: Collection[str]) -> bool:
    return all(find_folder(top, part).is_dir() for part in parts)


def find_folder(top: Path, name: str) -> Path:
    """Return the folder `name` of a folder; where it is not there the only one whose name differs in capitals alone.

    Where it holds nothing but one folder, the frames lie in that, as in summer/summer.
    """
    alike = [folder for folder in list_folders(top) if folder.name.casefold() == name.casefold()]
    found = alike[0] if len(alike) == 1 else top / name
    inner = list_folders(found)
    return inner[0] if len(inner) == 1 and not list_files(found) else found


def list_folders(folder: Path) -> list[Path]:
    """Return the folders in a folder, by their names, but for hidden ones and those that systems put there."""
    inner = folder.iterdir() if folder.is_dir() else ()
    return sorted(each for each in inner if each.is_dir() and not is_folder_beside(each.name))


def suggest_folder(path: Path) -> str:
    """Return words for the folder that may be meant by a path where there is none; empty if none is alike."""
    while path.parent != path and not path.parent.is_dir():
        path = path.parent
    around = list_folders(path.parent)
    known = {folder.name.casefold(): folder for folder in [*chain(*map(list_folders, around)), *around]}
    close = difflib.get_close_matches(path.name.casefold(), known, n=1)
    return f"did you mean {known[close[0]]}? else " if close else ""


def list_files(folder: Path) -> set[str]:
    """Return the names of the files in a folder, links to files included."""
    with os.scandir(folder) as entries:
        return {entry.name for entry in entries if entry.is_file()}


def check_folders(folders: Sequence[FrameFolder], layout: str, suffix_option: str | None = None) -> None:
    """Raise MissingData, with `layout`, for a folder that is missing or lacks some of the file names used of it.

    The message tells where so many images are known to be a wrong copy, and where the frames are there under another
    suffix, which the option `suffix_option` chooses.
    """
    for folder in folders:
        if not folder.path.is_dir():
            raise MissingData(f"{folder.path} does not exist: {suggest_folder(folder.path)}{layout}")
        present = list_files(folder.path)
        missing = [name for name in folder.used if name not in present]
        if not missing:
            continue
        advice = layout
        alike = [name for suffix in _SUFFIXES if (name := str(Path(missing[0]).with_suffix(suffix))) in present]
        images = sum(Path(name).suffix.lower() in _SUFFIXES for name in present)
        if alike and suffix_option:
            advice = f"{alike[0]} is there: pass {suffix_option}={Path(alike[0]).suffix}"
        elif meaning := folder.wrong_counts.get(images):
            advice = f"{images:,} images are {meaning}; {layout}"
        elif 2 * len(missing) < len(folder.used):
            advice = "copy or download them again; none is skipped, for that would shift all that follow"
        raise MissingData(
            f"{missing[0]} is missing from {folder.path} ({len(missing)} of {len(folder.used)} expected frames are "
            f"missing, {len(present)} files are there): {advice}"
        )
