"""Positions in file names, `@UTM_east@UTM_north@zone@letter@...`, as VPR-datasets-downloader writes them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from vprbench.api import BadInput

from .file_dataset import GroundTruth
from .positions import METRES_WANTED, Metres, are_metres, by_radius

Zones = Literal["error", "apart"]  # of images in different UTM zones: apart means that they never show one place

_BAND = re.compile("[C-HJ-NP-X]")
_APART_METRES = 1e9  # farther than any two points of one grid


class Position(NamedTuple):
    """What a file name says of where its image was taken."""

    east: float  # metres
    north: float  # metres
    grid: str  # zone and hemisphere, as in "33 north"; empty where the name has none


def by_names(
    references: Sequence[Path], queries: Sequence[Path], radius_metres: float, zones: Zones = "error"
) -> GroundTruth:
    """Return every reference as a place of its own; right is what lies within the radius, the radius included.

    Raises BadInput for a name without a position, and for names of several UTM zones unless they are kept apart.
    """
    named = [[position_in(path) for path in files] for files in (references, queries)]
    grids = {
        position.grid: path for path, position in zip([*references, *queries], [*named[0], *named[1]], strict=True)
    }
    several = [grid for grid in grids if grid] if zones == "error" else [*grids] if "" in grids else []
    if len(several) > 1:
        first, second = (f"{grids[grid].name} in {grid or 'no zone'}" for grid in several[:2])
        raise BadInput(
            f"names of {len(several)} UTM zones came ({first}, {second}), whose metres do not compare: "
            + (
                "choose images of one zone; dataset=utm_folders has dataset.zones=apart, for images of different zones "
                "that never show one place"
                if zones == "error"
                else "with dataset.zones=apart every name has to hold its zone"
            )
        )
    shelf = {grid: number * _APART_METRES for number, grid in enumerate(grids)} if zones == "apart" else {}

    def metres(positions: list[Position]) -> Metres:
        return np.array([(east, north, shelf.get(grid, 0.0)) for east, north, grid in positions])

    return by_radius(metres(named[0]), metres(named[1]), radius_metres)


def position_in(path: Path) -> Position:
    """Return the position that the base name of a file holds; raises BadInput with the name where it holds none."""
    parts = path.name.split("@")
    try:
        east, north = float(parts[1]), float(parts[2])
    except (IndexError, ValueError) as error:
        raise BadInput(f"{path} names no position: a name has to begin with @UTM_east@UTM_north@") from error
    if not are_metres([east, north]):
        raise BadInput(f"{path} names the position {east}, {north}: metres are wanted, {METRES_WANTED}")
    zone, letter = (parts[3], parts[4].upper()) if len(parts) > 4 else ("", "")
    if not (zone.isascii() and zone.isdigit() and 1 <= int(zone) <= 60 and _BAND.fullmatch(letter)):
        return Position(east, north, "")
    return Position(east, north, f"{int(zone)} {'north' if letter >= 'N' else 'south'}")
