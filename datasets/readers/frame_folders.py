"""Frames that somebody put into folders, one for each traverse: found, and checked before anything is read."""

from __future__ import annotations

import os
from collections.abc import Collection, Sequence
from pathlib import Path

from vprbench.api import FrameFolder, NotThere, checkout_folder, data_folder

_SUFFIXES = (".png", ".jpg", ".jpeg")
_ARCHIVES = "archives"  # what was downloaded and not unpacked yet


def root_folder(
    name: str,
    root: str | None,
    holding: str,
    layout: str,
    download: str | None = None,
    default_root: str | None = None,
) -> Path:
    """Return the folder of dataset `name` that holds what `holding` says; raises NotThere with `layout`, what to do.

    A `root` of None is the folder that downloads of the dataset lie in, if it holds anything, else `default_root`
    (relative to the checkout) if it exists; `download` names the download folder if several datasets share one.
    """
    if root is None:
        kept = data_folder(download or name)
        if _holds_data(kept):
            return kept
        default = checkout_folder() / (default_root or "")
        if default_root is not None and is_readable_folder(default):
            return default
        unfinished = " (which holds no frames yet: a download was not finished)" if is_readable_folder(kept) else ""
        raise NotThere(
            f"dataset.root is not set: {name} needs the folder that holds {holding}; {layout}, "
            f"or call that folder {kept}{unfinished}"
        )
    folder = Path(root).expanduser()
    if not is_readable_folder(folder):
        raise NotThere(
            f"dataset.root={root} is no folder that can be read: {name} needs the one that holds {holding}; {layout}"
        )
    return folder


def _holds_data(folder: Path) -> bool:
    """Tell whether there is more in a folder than a download that was not finished leaves."""
    return is_readable_folder(folder) and any(
        not entry.name.startswith(".") and entry.name != _ARCHIVES for entry in folder.iterdir()
    )


def is_readable_folder(folder: Path) -> bool:
    """Tell whether a path is a folder whose files this process may list and open; never raises."""
    own = os.access in os.supports_effective_ids  # else the system knows the real user alone
    try:
        return os.access(folder, os.R_OK | os.X_OK, effective_ids=own) and folder.is_dir()
    except ValueError:  # no path has a zero byte
        return False


def files_in(folder: Path) -> set[str]:
    """Return the names of the files in a folder, links to files included; folders, devices and the like are none."""
    with os.scandir(folder) as entries:
        return {entry.name for entry in entries if entry.is_file()}


def check_folders(folders: Sequence[FrameFolder], layout: str, suffix_option: str | None = None) -> None:
    """Raise NotThere, with `layout`, for a folder that is missing or lacks some of the file names used of it.

    The message tells where so many images are known to be a wrong copy, and where the frames are there under another
    suffix, which the option `suffix_option` chooses.
    """
    for folder in folders:
        if not is_readable_folder(folder.path):
            raise NotThere(f"{folder.path} does not exist or cannot be read: {layout}")
        present = files_in(folder.path)
        missing = [name for name in folder.used if name not in present]
        if missing:
            told = _what_to_do(folder, missing, present, layout, suffix_option)
            raise NotThere(
                f"{missing[0]} is missing from {folder.path} ({len(missing)} of {len(folder.used)} expected frames are "
                f"missing, {len(present)} files are there): {told}"
            )


def _what_to_do(
    folder: FrameFolder, missing: Sequence[str], present: Collection[str], layout: str, suffix_option: str | None
) -> str:
    """Return `layout`, or what is known better of a folder with such files."""
    alike = [name for suffix in _SUFFIXES if (name := str(Path(missing[0]).with_suffix(suffix))) in present]
    if alike and suffix_option:
        return f"{alike[0]} is there: pass {suffix_option}={Path(alike[0]).suffix}"
    images = sum(Path(name).suffix.lower() in _SUFFIXES for name in present)
    if meaning := folder.wrong_counts.get(images):
        return f"{images:,} images are {meaning}; {layout}"
    if 2 * len(missing) < len(folder.used):
        return "copy or download them again; none is skipped, for that would shift all that follow"
    return layout
