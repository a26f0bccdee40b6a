"""Frames that somebody put into folders, one for each traverse: found, and checked before anything is read."""

from __future__ import annotations

import difflib
import os
from collections.abc import Collection, Sequence
from itertools import chain
from pathlib import Path

from vprbench.api import FrameFolder, MissingData, checkout_folder, data_folder, is_folder_beside

_SUFFIXES = (".png", ".jpg", ".jpeg")
_PACKED = (".zip", ".tar", ".gz", ".tgz", ".bz2", ".xz", ".rar", ".7z")
_ARCHIVES = "archives"  # what was downloaded and not unpacked yet


def root_folder(
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
    if root is not None:
        folder = Path(root).expanduser()
        if not is_readable_folder(folder):
            raise MissingData(
                f"dataset.root={root} is no folder that can be read: {name} needs the one that holds {holding}; "
                f"{layout}" + ", unpacked" * (folder.suffix.lower() in _PACKED)
            )
        return _choose_folder(folder, parts)
    kept = data_folder(download or name)
    started = is_readable_folder(kept)
    if started and any(not entry.name.startswith(".") and entry.name != _ARCHIVES for entry in kept.iterdir()):
        return _choose_folder(kept, parts)
    default = checkout_folder() / (default_root or "")
    if default_root is not None and is_readable_folder(default):
        return default
    raise MissingData(
        f"dataset.root is not set: {name} needs the folder that holds {holding}; {layout}, or call that folder {kept}"
        + " (which holds no frames yet: a download was not finished)" * started
    )


def _choose_folder(folder: Path, parts: Collection[str]) -> Path:
    """Return a folder, or the only one in it that has these parts where the folder itself has not."""

    def has_all(each: Path) -> bool:
        return all(is_readable_folder(find_folder(each, part)) for part in parts)

    within = [] if has_all(folder) else list(filter(has_all, folders_in(folder)))
    return within[0] if len(within) == 1 else folder


def find_folder(top: Path, name: str) -> Path:
    """Return the folder `name` of a folder; where it is not there the only one whose name differs in capitals alone.

    Where it holds nothing but one folder, the frames lie in that, as in summer/summer.
    """
    alike = [folder for folder in folders_in(top) if folder.name.casefold() == name.casefold()]
    found = top / name
    if len(alike) == 1 and not found.is_dir():
        found = alike[0]
    inner = folders_in(found)
    return inner[0] if len(inner) == 1 and not files_in(found) else found


def folders_in(folder: Path) -> list[Path]:
    """Return the folders in a folder, by their names, but for hidden ones and those that systems put there."""
    if not is_readable_folder(folder):
        return []
    return sorted(each for each in folder.iterdir() if is_readable_folder(each) and not is_folder_beside(each.name))


def nearest_folder(path: Path) -> str:
    """Return words for the folder that may be meant by a path where there is none; empty if none is alike."""
    while path.parent != path and not is_readable_folder(path.parent):
        path = path.parent
    around = folders_in(path.parent)
    known = {folder.name.casefold(): folder for folder in [*chain(*map(folders_in, around)), *around]}
    close = difflib.get_close_matches(path.name.casefold(), known, n=1)
    return f"did you mean {known[close[0]]}? else " if close else ""


def is_readable_folder(folder: Path) -> bool:
    """Tell whether a path is a folder whose files this process may list and open."""
    return folder.is_dir() and os.access(folder, os.R_OK | os.X_OK)


def files_in(folder: Path) -> set[str]:
    """Return the names of the files in a folder, links to files included."""
    with os.scandir(folder) as entries:
        return {entry.name for entry in entries if entry.is_file()}


def check_folders(folders: Sequence[FrameFolder], layout: str, suffix_option: str | None = None) -> None:
    """Raise MissingData, with `layout`, for a folder that is missing or lacks some of the file names used of it.

    The message tells where so many images are known to be a wrong copy, and where the frames are there under another
    suffix, which the option `suffix_option` chooses.
    """
    for folder in folders:
        if not is_readable_folder(folder.path):
            raise MissingData(f"{folder.path} does not exist or cannot be read: {nearest_folder(folder.path)}{layout}")
        present = files_in(folder.path)
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
