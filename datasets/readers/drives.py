"""The drives that a traverse consists of: where its journey breaks off, by folders and by positions."""

from __future__ import annotations

from collections.abc import Sequence, Sized
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt

from vprbench.api import BadInput, Images, Paths, Places

Breaks = Literal["auto", "none"]  # auto: another folder begins another drive, and so does a position that jumps
Starts = npt.NDArray[np.int64]  # the frames of a traverse, ascending, that are the first of another drive

NO_STARTS: Starts = np.empty(0, np.int64)
_JUMP = 10  # times the usual step
_SHOWN = 9  # sub-folders in a message


@dataclass(frozen=True)
class DriveStarts:
    """Where references and queries begin another drive, and by what that was seen."""

    references: Starts
    queries: Starts
    seen_by: str  # folders, positions, or both

    def find_place_starts(self, places: Places) -> Starts:
        """Return the places that no drive shows beside the place before; `places` (n_references,) are those shown."""
        if not len(self.references):
            return NO_STARTS
        drives = np.searchsorted(self.references, np.arange(len(places)), side="right")
        shown = np.unique(np.stack([drives, places], axis=1), axis=0)
        joined = shown[1:][(np.diff(shown, axis=0) == (0, 1)).all(axis=1), 1]
        return np.setdiff1d(np.arange(1, int(places.max()) + 1), joined)


def find_drives(
    references: Sequence[Path] | Images,
    queries: Sequence[Path] | Images,
    breaks: Breaks,
    jumps: tuple[Starts, Starts] = (NO_STARTS, NO_STARTS),
) -> DriveStarts:
    """Return where the files of references and queries begin another drive; `jumps` are those of their positions.

    Nothing is seen under `none`, and no folders where the frames are no files.
    """
    if breaks == "none":
        return DriveStarts(NO_STARTS, NO_STARTS, "")
    folders = [_find_folder_starts(files) for files in (references, queries)]
    found = {"folders": folders, "positions": jumps}
    seen_by = " and ".join(name for name, starts in found.items() if any(map(len, starts)))
    return DriveStarts(np.union1d(folders[0], jumps[0]), np.union1d(folders[1], jumps[1]), seen_by)


def _find_folder_starts(files: Sequence[Path] | Images) -> Starts:
    """Return which files are the first of another folder; none where most files have a folder of their own."""
    if isinstance(files, Images):
        return NO_STARTS
    starts = np.flatnonzero(np.diff(Paths.of(files).numbers)) + 1
    return starts if 2 * len(starts) < len(files) else NO_STARTS


def find_jumps(metres: npt.NDArray[np.float64], radius_metres: float) -> Starts:
    """Return which frames lie beyond the radius from the frame before, and beyond 10 usual steps; metres (n, d)."""
    steps = np.linalg.norm(np.diff(metres, axis=0), axis=1)
    moves = steps[steps > 0]
    usual = float(np.median(moves)) if len(moves) else 0.0
    return np.flatnonzero(steps > max(radius_metres, _JUMP * usual)) + 1


def check_by_order(traverses: Sequence[Sized], names: Sequence[str], breaks: Breaks, option: str, remedy: str) -> None:
    """Raise BadInput, with the `remedy`, for traverses whose i-th images cannot all show place i.

    So it is where their lengths differ, and under the `breaks` auto where their sub-folders do; `option` is what
    comes before the names of options. Frames that are no files have no sub-folders.
    """
    counts = [_count_by_folder(files) for files in traverses]
    in_folders = {own for own, files in zip(counts, traverses, strict=True) if isinstance(files, Paths)}
    if len(set(map(sum, counts))) > 1:
        differing = "different numbers of images"
    elif breaks == "auto" and len(in_folders) > 1:
        differing = "sub-folders with different numbers of images"
        remedy += f"; {option}breaks=none takes all as one drive"
    else:
        return
    listed = ", ".join(
        f"{name} {'+'.join(map(str, own)) if len(own) <= _SHOWN else sum(own)}"
        for name, own in zip(names, counts, strict=True)
    )
    raise BadInput(
        f"{option}references and {option}queries hold {differing} ({listed}), so that the i-th of each may not show "
        f"one place: {remedy}"
    )


def _count_by_folder(files: Sized) -> tuple[int, ...]:
    """Return how many files follow one another in each folder."""
    starts = np.flatnonzero(np.diff(files.numbers)) + 1 if isinstance(files, Paths) else NO_STARTS
    return tuple(np.diff([0, *starts, len(files)]).tolist())


def keep_in_drive(right: Sequence[Places], starts: Starts) -> list[Places]:
    """Return of the right places of each query, the i-th of which is at place i, those that lie in its own drive."""
    drives = np.searchsorted(starts, np.arange(len(right)), side="right")
    return [own[np.searchsorted(starts, own, side="right") == drives[query]] for query, own in enumerate(right)]
