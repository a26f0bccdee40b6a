"""Ground truth by position, of coordinates or of names `@UTM_east@UTM_north@zone@letter@...`."""

from __future__ import annotations

import re
from array import array
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from vprbench.api import BadInput, Paths

from .drives import position_jumps
from .file_dataset import GroundTruth, each_a_place

Metres = npt.NDArray[np.float64]  # (n, 2) east and north, or (n, 3)
Zones = Literal["error", "apart"]  # of images in different UTM zones: apart means that they never show one place

_ROUNDING_METRES = 1e-7  # of coordinates of some million metres: decides about nothing but the edge of the radius
MOST_METRES = 1e8  # the way round the Earth is 4e7; of much larger numbers centimetres are lost, and squares overflow
_EQUATOR_METRES = 6378137.0  # WGS 84
_FLATTENING = 1 / 298.257223563
_BAND = re.compile("[C-HJ-NP-X]")
_APART_METRES = 1e9  # farther than any two points of one grid


def by_radius(references: Metres, queries: Metres, radius_metres: float) -> GroundTruth:
    """Return every reference as a place of its own; right is what lies within the radius, the radius included.

    Raises BadInput for a radius that is not above 0, or that spans more than the Earth.
    """
    if not 0 < radius_metres <= MOST_METRES:
        raise BadInput(f"dataset.radius_metres={radius_metres:g}: give more than 0 metres, at most {MOST_METRES:g}")
    near = KDTree(references).query_ball_point(queries, radius_metres + _ROUNDING_METRES, return_sorted=True)
    truth = each_a_place(len(references), near, f"no reference within {radius_metres:g} m")
    jumps = position_jumps(references, radius_metres), position_jumps(queries, radius_metres)
    return replace(truth, jumps=jumps)


def are_metres(numbers: npt.ArrayLike) -> bool:
    """Tell whether all numbers are coordinates of places on the Earth: finite, and of no more than 100,000 km."""
    return bool((np.abs(numbers) <= MOST_METRES).all())


def earth_centred(latitude: npt.NDArray[np.float64], longitude: npt.NDArray[np.float64]) -> Metres:
    """Return points of the WGS 84 ellipsoid, given in degrees, in metres from the centre of the Earth, (n, 3).

    The straight line between two points is shorter than the way on the ground by about its share d^2 / 24 R^2, at
    10 km 0.1 mm in a kilometre. There are no zones and no seam.
    """
    phi, lambda_ = np.radians(latitude), np.radians(longitude)
    eccentricity_squared = _FLATTENING * (2 - _FLATTENING)
    across = _EQUATOR_METRES / np.sqrt(1 - eccentricity_squared * np.sin(phi) ** 2)
    return np.stack(
        [
            across * np.cos(phi) * np.cos(lambda_),
            across * np.cos(phi) * np.sin(lambda_),
            across * (1 - eccentricity_squared) * np.sin(phi),
        ],
        axis=1,
    )


def by_names(
    references: Sequence[Path], queries: Sequence[Path], radius_metres: float, zones: Zones = "error"
) -> GroundTruth:
    """Return every reference as a place of its own; right is what lies within the radius, the radius included.

    Raises BadInput for a name without a position, and for names of several UTM zones unless they are kept apart.
    """
    listed = [Paths.of(files) for files in (references, queries)]
    grids: dict[str, str] = {}  # each with the last name that holds it
    named = [_positions(files, grids) for files in listed]
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
    if zones == "apart":
        shelf = np.arange(len(grids)) * _APART_METRES
        named = [(np.column_stack([metres, shelf[of_each]]), of_each) for metres, of_each in named]
    return by_radius(named[0][0], named[1][0], radius_metres)


def _positions(files: Paths, grids: dict[str, str]) -> tuple[Metres, npt.NDArray[np.int32]]:
    """Return what the names of files say, (n, 2) and (n,): east and north, and the number of the grid in `grids`.

    New grids are added, and each learns the last name that holds it. Raises BadInput with a name that holds none.
    """
    metres, of_each = array("d"), array("i")
    numbers = {grid: number for number, grid in enumerate(grids)}
    for number, name in enumerate(files.names):
        try:
            east, north, grid = _position(name)
        except ValueError as error:
            raise BadInput(f"{files[number]} names {error}") from error
        metres.append(east)
        metres.append(north)
        of_each.append(numbers.setdefault(grid, len(numbers)))
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
