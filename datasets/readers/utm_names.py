"""Positions in file names `@UTM_east@UTM_north@zone@letter@...`, as VPR-datasets-downloader writes them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np

from vprbench.api import BadInput, Paths

from .file_dataset import GroundTruth
from .positions import MOST_METRES, Positions, WithoutPosition, match_positions

Zones = Literal["error", "apart"]  # of images in different UTM zones: apart means that they never show one place

#: Zone and latitude band, behind east and north.
_GRID = re.compile("(?:[^@]*@){3}(0?[1-9]|[1-5][0-9]|60)@([C-HJ-NP-X])(?:@|$)", re.IGNORECASE)


def match_names(
    references: Sequence[Path],
    queries: Sequence[Path],
    radius_metres: float,
    zones: Zones = "error",
    without: WithoutPosition = "error",
) -> GroundTruth:
    """Return the ground truth (`match_positions`) of file names.

    Raises BadInput for a name without a position, unless such images are left out (`drop`), and for names of several
    UTM zones or sides of the equator, unless these are kept apart.
    """
    grids: dict[str, tuple[int, str]] = {}  # number of each, and the first name that holds it
    mapped, queried = (_read_names(Paths.of(files), grids, zones, without) for files in (references, queries))
    named = [grid for grid in grids if grid]
    if zones == "apart" and "" in grids and named:
        raise BadInput(f"{grids[''][1]} names no UTM zone: with dataset.zones=apart every name has to hold its zone")
    if zones == "error" and len(named) > 1:
        first, second = (f"{grids[grid][1]} in {grid}" for grid in named[:2])
        raise BadInput(
            f"names of {len(named)} UTM zones came ({first}, {second}), whose metres do not compare: choose images of "
            "one zone, or pass dataset.zones=apart to dataset=utm_folders where two zones never show one place"
        )
    return match_positions([mapped], queried, radius_metres, without)


def _read_names(files: Paths, grids: dict[str, tuple[int, str]], zones: Zones, without: WithoutPosition) -> Positions:
    """Return east and north of the names of files, NaN of a name that has none; new grids are added to `grids`."""
    given, of_each = np.full((len(files), 2), np.nan), np.zeros(len(files), np.int64)
    for number, name in enumerate(files.names):
        try:
            _, east, north, *_ = name.split("@")
            given[number] = float(east), float(north)
        except ValueError:
            given[number] = np.nan
        if not (np.abs(given[number]) <= MOST_METRES).all():
            if without != "drop":
                raise BadInput(
                    f"{files[number]} names no position: a name has to begin with @UTM_east@UTM_north@, metres from "
                    "-1e8 to 1e8; or pass dataset.without_position=drop"
                )
            given[number] = np.nan
        elif given[number, 0] != given[number, 1]:  # else it may be 0, 0 for a position that is not known
            found = _GRID.match(name)
            grid = f"{int(found[1])} {'north' if found[2].upper() >= 'N' else 'south'}" if found else ""
            of_each[number] = grids.setdefault(grid, (len(grids), name))[0]
    return Positions(files, given, grids=of_each if zones == "apart" else None)
