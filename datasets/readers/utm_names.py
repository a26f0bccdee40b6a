"""Positions in file names `@UTM_east@UTM_north@zone@letter@...`, as VPR-datasets-downloader writes them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np

from vprbench.api import BadInput, Paths

from .file_dataset import GroundTruth
from .positions import MOST_METRES, Positions, WithoutPosition, by_positions

Zones = Literal["error", "apart"]  # of images in different UTM zones: apart means that they never show one place

_BAND = re.compile("[C-HJ-NP-X]")
_APART_METRES = 1e9  # farther than any two points of one grid


def by_names(
    references: Sequence[Path],
    queries: Sequence[Path],
    radius_metres: float,
    zones: Zones = "error",
    without: WithoutPosition = "error",
) -> GroundTruth:
    """Return the ground truth `by_positions` of file names.

    Raises BadInput for a name without a position unless such images are left out, and for names of several UTM zones
    unless they are kept apart.
    """
    mapped, asked = (_read_names(Paths.of(files), without) for files in (references, queries))
    names: dict[str, str] = {}  # by grid, one that holds it
    for files, given, grids in (mapped, asked):
        known = given[:, 0] != given[:, 1]  # else it may be 0, 0 for a position that is not known, or none
        names |= {grid: name for grid, name, own in zip(grids, files.names, known, strict=True) if own}
    differing = [grid for grid in names if grid or zones == "apart"]
    told = ", ".join(f"{names[grid]} in {grid or 'no zone'}" for grid in differing[:2])
    if zones == "error" and len(differing) > 1:
        raise BadInput(
            f"names of {len(differing)} UTM zones came ({told}), whose metres do not compare: choose images of one "
            "zone; dataset=utm_folders has dataset.zones=apart, for images of different zones that never show one place"
        )
    if len(differing) > 1 and "" in differing:
        raise BadInput(f"names with and without a zone came ({told}): with dataset.zones=apart every name needs one")
    numbers = {grid: number for number, grid in enumerate(dict.fromkeys([*mapped[2], *asked[2]]))}
    known, sought = (
        Positions(
            files,
            given,
            shelf=_APART_METRES * np.array([numbers[grid] for grid in grids]) if zones == "apart" else None,
        )
        for files, given, grids in (mapped, asked)
    )
    return by_positions([known], sought, radius_metres, without)


def _read_names(files: Paths, without: WithoutPosition) -> tuple[Paths, np.ndarray, list[str]]:
    """Return files with east and north of their names, (n, 2), NaN if there are none, and the grid of each.

    The grid is zone and hemisphere, as in "33 north", empty if the name has none.
    """
    given, grids = np.full((len(files), 2), np.nan), [""] * len(files)
    for number, name in enumerate(files.names):
        parts = name.split("@", 5)
        try:
            position = float(parts[1]), float(parts[2])
        except (IndexError, ValueError):
            position = np.nan, np.nan
        if all(abs(metres) <= MOST_METRES for metres in position):
            given[number] = position
            grids[number] = _name_grid(*parts[3:5]) if len(parts) > 4 else ""
        elif without != "drop":
            raise BadInput(
                f"{files[number]} names no position: a name has to begin with @UTM_east@UTM_north@, metres from -1e8 "
                "to 1e8; or pass dataset.without_position=drop"
            )
    return files, given, grids


def _name_grid(zone: str, letter: str) -> str:
    band = letter.upper()
    if not (zone.isascii() and zone.isdigit() and 1 <= int(zone) <= 60 and _BAND.fullmatch(band)):
        return ""
    return f"{int(zone)} {'north' if band >= 'N' else 'south'}"
