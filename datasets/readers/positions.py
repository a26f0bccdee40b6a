"""Ground truth by position, of coordinates or of names `@UTM_east@UTM_north@zone@letter@...`."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from vprbench.api import BadInput

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
    return each_a_place(len(references), near, f"no reference within {radius_metres:g} m")


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


class Position(NamedTuple):
    """What a file name says of where its image was taken."""

    east: float  # metres
    north: float  # metres
    grid: str  # zone and hemisphere, as in "33 north"; empty if the name has none


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
    """Return the position that the base name of a file holds; raises BadInput with the name if it holds none."""
    parts = path.name.split("@")
    try:
        east, north = float(parts[1]), float(parts[2])
    except (IndexError, ValueError) as error:
        raise BadInput(f"{path} names no position: a name has to begin with @UTM_east@UTM_north@") from error
    if not are_metres([east, north]):
        raise BadInput(f"{path} names the position {east}, {north}: wanted are metres from -1e8 to 1e8")
    zone, letter = (parts[3], parts[4].upper()) if len(parts) > 4 else ("", "")
    if not (zone.isascii() and zone.isdigit() and 1 <= int(zone) <= 60 and _BAND.fullmatch(letter)):
        return Position(east, north, "")
    return Position(east, north, f"{int(zone)} {'north' if letter >= 'N' else 'south'}")
