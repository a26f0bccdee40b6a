"""Ground truth by position: which references lie within a radius of a query."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from vprbench.api import BadInput

from .file_dataset import GroundTruth

METRES_WANTED = "a number from -1e8 to 1e8 is wanted"

Metres = npt.NDArray[np.float64]  # (n, 2) east and north, or (n, 3)

_ROUNDING_METRES = 1e-7  # of coordinates of some million metres: decides about nothing but the edge of the radius
_MOST_METRES = 1e8  # the way round the Earth is 4e7; of much larger numbers centimetres are lost, and squares overflow
_EQUATOR_METRES = 6378137.0  # WGS 84
_FLATTENING = 1 / 298.257223563


def by_radius(references: Metres, queries: Metres, radius_metres: float) -> GroundTruth:
    """Return every reference as a place of its own; right is what lies within the radius, the radius included.

    Raises BadInput for a radius that is not above 0, or that spans more than the Earth.
    """
    if not 0 < radius_metres <= _MOST_METRES:
        raise BadInput(f"dataset.radius_metres={radius_metres:g}: give more than 0 metres, at most {_MOST_METRES:g}")
    near = KDTree(references).query_ball_point(queries, radius_metres + _ROUNDING_METRES, return_sorted=True)
    return GroundTruth(
        places=np.arange(len(references)),
        positives=[np.array(found, dtype=np.int64) for found in near],
        lacking=f"no reference within {radius_metres:g} m",
    )


def are_metres(numbers: npt.ArrayLike) -> bool:
    """Tell whether all numbers are coordinates of places on the Earth: finite, and of no more than 100,000 km."""
    return bool((np.abs(numbers) <= _MOST_METRES).all())


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
