"""Frames that somebody put into folders, one for each traverse: found, and checked before anything is read."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from vprbench.interface import NotThere


def root_folder(name: str, root: str | None, holding: str, layout: str) -> Path:
    """Return the folder of dataset `name` that holds what `holding` says; raises NotThere with `layout`, what to do."""
    if root is None:
        raise NotThere(f"dataset.root is not set: {name} needs the folder that holds {holding}; {layout}")
    folder = Path(root).expanduser()
    if not folder.is_dir():
        raise NotThere(f"dataset.root={root} is no folder: {name} needs the one that holds {holding}; {layout}")
    return folder


def check_frames(wanted: Mapping[Path, Sequence[str]], layout: str) -> None:
    """Raise NotThere, with `layout`, for a folder that is missing or lacks some of the file names wanted in it."""
    for folder, names in wanted.items():
        if not folder.is_dir():
            raise NotThere(f"{folder} does not exist: {layout}")
        present = {entry.name for entry in folder.iterdir()}
        missing = [name for name in names if name not in present]
        if missing:
            raise NotThere(
                f"{missing[0]} is missing from {folder} ({len(missing)} of {len(names)} expected frames are "
                f"missing, {len(present)} files are there): {layout}"
            )
