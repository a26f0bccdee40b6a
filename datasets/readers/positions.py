"""Ground truth by position, of coordinates or of names `@UTM_east@UTM_north@zone@letter@...`."""

from __future__ import annotations

import re
from array import array
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from vprbench.api import BadInput, Paths

from .coordinates import MOST_METRES, Metres, Positions, WithoutPosition
from .drives import position_jumps
from .file_dataset import GroundTruth, each_a_place
from .position_checks import check_coordinates, last_stand, name_without_position, without_position

Zones = Literal["error", "apart"]  # of images in different UTM zones: apart means that they never show one place

_ROUNDING_METRES = 1e-7  # of coordinates of some million metres: decides about nothing but the edge of the radius
_BAND = re.compile("[C-HJ-NP-X]")
_APART_METRES = 1e9  # farther than any two points of one grid
_AT_ONCE = 1024  # queries whose neighbours are lists of Python


def by_positions(
    references: Sequence[Positions], queries: Positions, radius_metres: float, without: WithoutPosition = "error"
) -> GroundTruth:
    """Return every reference as a place of its own; right is what lies within the radius, the radius included.

    `references` are traverses. Images without a position (`position_checks.without_position`) are an error, are left
    out (`drop`), or count where they say (`keep`). Raises BadInput for them, for a bad radius, and for coordinates
    that are no metres.
    """
    _check_radius(radius_metres)
    traverses = [*references, queries]
    lacking = without_position(traverses, radius_metres)
    if without == "error" and any(map(np.any, lacking)):
        raise BadInput(
            f"{name_without_position(traverses, lacking)}: correct them, or pass dataset.without_position=drop to "
            "leave them out, dataset.without_position=keep if they were taken there"
        )
    counts = {
        "references_without_position": sum(int(lacks.sum()) for lacks in lacking[:-1]),
        "queries_without_position": int(lacking[-1].sum()),
    }
    kept = [~lacks if without == "drop" else np.full(len(lacks), True) for lacks in lacking]
    mapped, asked = np.flatnonzero(np.concatenate(kept[:-1])), np.flatnonzero(kept[-1])
    if not (len(mapped) and len(asked)):
        raise BadInput(f"{name_without_position(traverses, lacking)}, and dataset.without_position=drop leaves none")
    left = [each[which] for each, which in zip(traverses, kept, strict=True)]
    check_coordinates(left, radius_metres)
    truth = by_radius(np.concatenate([each.metres for each in left[:-1]]), left[-1].metres, radius_metres)
    outcome = "are left out" if without == "drop" else "count where they say"
    told = f"{name_without_position(traverses, lacking)}; they {outcome}" if any(counts.values()) else ""
    return replace(
        truth,
        references=mapped if without == "drop" else None,
        queries=asked if without == "drop" else None,
        protocol={} if without == "error" else {"without_position": without, **counts},
        notes=tuple(filter(None, [told, *map(last_stand, left)])),
    )


def by_radius(references: Metres, queries: Metres, radius_metres: float) -> GroundTruth:
    """Return every reference as a place of its own; right is what lies within the radius, the radius included.

    Raises BadInput for a radius that is not above 0, or that spans more than the Earth.
    """
    _check_radius(radius_metres)
    near = _near(references, queries, radius_metres + _ROUNDING_METRES)
    truth = each_a_place(len(references), near, f"no reference within {radius_metres:g} m")
    jumps = position_jumps(references, radius_metres), position_jumps(queries, radius_metres)
    return replace(truth, jumps=jumps)


def _check_radius(radius_metres: float) -> None:
    if not 0 < radius_metres <= MOST_METRES:
        raise BadInput(f"dataset.radius_metres={radius_metres:g}: give more than 0 metres, at most {MOST_METRES:g}")


def _near(references: Metres, queries: Metres, radius_metres: float) -> Iterator[npt.NDArray[np.int64]]:
    """Yield of every query the references within the radius, ascending."""
    tree = KDTree(references)
    for first in range(0, len(queries), _AT_ONCE):
        found = tree.query_ball_point(queries[first : first + _AT_ONCE], radius_metres, return_sorted=True)
        yield from (np.array(right, np.int64) for right in found)


def by_names(
    references: Sequence[Path],
    queries: Sequence[Path],
    radius_metres: float,
    zones: Zones = "error",
    without: WithoutPosition = "error",
) -> GroundTruth:
    """Return the ground truth `by_positions` of what the names of images say.

    Raises BadInput for a name that says no position unless such images are left out, and for names of several UTM
    zones unless they are kept apart.
    """
    listed = [Paths.of(files) for files in (references, queries)]
    grids: dict[str, str] = {}  # each with the last name that holds it
    numbers: dict[str, int] = {}  # of all grids
    named = [_positions(files, grids, numbers, without) for files in listed]
    several = [grid for grid in grids if grid] if zones == "error" else [*grids] if "" in grids else []
    if len(several) > 1:
        first, second = (f"{grids[grid]} in {grid or 'no zone'}" for grid in several[:2])
        raise BadInput(
            f"names of {len(several)} UTM zones came ({first}, {second}), whose metres do not compare: "
            + (
                "choose images of one zone; dataset=utm_folders has dataset.zones=apart, for images of different zones "
                "that never show one place"
                if zones == "error"
                else "with dataset.zones=apart every name has to hold its zone"
            )
        )
    shelf = np.arange(len(numbers)) * (_APART_METRES if zones == "apart" else 0)
    mapped, asked = (
        Positions(files, said, np.column_stack([said, shelf[of_each]]) if zones == "apart" else said)
        for files, (said, of_each) in zip(listed, named, strict=True)
    )
    return by_positions([mapped], asked, radius_metres, without)


def _positions(
    files: Paths, grids: dict[str, str], numbers: dict[str, int], without: WithoutPosition
) -> tuple[Metres, npt.NDArray[np.int32]]:
    """Return what the names of files say, (n, 2) and (n,): east and north, NaN if nothing, and the number of the grid.

    New grids get a number in `numbers`, and in `grids` the last name that holds them and a position. Raises BadInput
    with a name that says none unless such images are left out.
    """
    metres, of_each = array("d"), array("i")
    for number, name in enumerate(files.names):
        try:
            east, north, grid = _position(name)
        except ValueError as error:
            if without != "drop":
                raise BadInput(f"{files[number]} names {error}; or pass dataset.without_position=drop") from error
            east, north, grid = np.nan, np.nan, ""
        metres.append(east)
        metres.append(north)
        of_each.append(numbers.setdefault(grid, len(numbers)))
        if east < north or east > north:  # else it may be 0, 0 for a position that is not known
            grids[grid] = name
    return np.array(metres).reshape(-1, 2), np.array(of_each)


def _position(name: str) -> tuple[float, float, str]:
    """Return what a file name says of where its image was taken: east and north in metres, and its grid.

    The grid is zone and hemisphere, as in "33 north", empty if the name has none. Raises ValueError with what the name
    says instead.
    """
    parts = name.split("@", 5)
    try:
        east, north = float(parts[1]), float(parts[2])
    except (IndexError, ValueError) as error:
        raise ValueError("no position: a name has to begin with @UTM_east@UTM_north@") from error
    if not (abs(east) <= MOST_METRES and abs(north) <= MOST_METRES):
        raise ValueError(f"the position {east}, {north}: wanted are metres from -1e8 to 1e8")
    return east, north, _grid(parts[3], parts[4].upper()) if len(parts) > 4 else ""


@lru_cache(1000)  # names may hold anything there
def _grid(zone: str, letter: str) -> str:
    if not (zone.isascii() and zone.isdigit() and 1 <= int(zone) <= 60 and _BAND.fullmatch(letter)):
        return ""
    return f"{int(zone)} {'north' if letter >= 'N' else 'south'}"
