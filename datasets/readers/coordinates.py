"""Coordinates of images: metres of one grid, or degrees and the points that they stand for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from vprbench.api import Paths

Metres = npt.NDArray[np.float64]  # (n, 2) east and north, or (n, 3)
Degrees = npt.NDArray[np.float64]  # (n, 2) latitude and longitude, WGS 84

WithoutPosition = Literal["error", "keep", "drop"]  # of images without a position: keep takes what is said for one
MOST_METRES = 1e8  # the way round the Earth is 4e7; of much larger numbers centimetres are lost, and squares overflow
_EQUATOR_METRES = 6378137.0  # WGS 84
_FLATTENING = 1 / 298.257223563


@dataclass(frozen=True)
class Positions:
    """Where the images of one traverse were taken."""

    files: Paths
    said: npt.NDArray[np.float64]  # (n, 2), the two numbers that somebody gave; NaN: none
    metres: Metres
    in_degrees: bool = False  # what was said

    @classmethod
    def of_metres(cls, files: Sequence[Path], metres: Metres) -> Positions:
        """Return positions that were given in metres, (n, 2)."""
        return cls(Paths.of(files), metres, metres)

    @classmethod
    def of_degrees(cls, files: Sequence[Path], degrees: Degrees) -> Positions:
        """Return positions that were given in degrees, (n, 2)."""
        return cls(Paths.of(files), degrees, earth_centred(*degrees.T), in_degrees=True)

    def __len__(self) -> int:
        """Return the number of images."""
        return len(self.said)

    def __getitem__(self, chosen: npt.NDArray[np.bool_]) -> Positions:
        """Return the positions of some images, chosen by yes and no, (n,)."""
        return Positions(self.files[chosen], self.said[chosen], self.metres[chosen], self.in_degrees)


def are_metres(numbers: npt.NDArray[Any], without: WithoutPosition) -> bool:
    """Tell whether all numbers are at most 100,000 km; NaN is none, and allowed where such images are left out."""
    nothing = np.isnan(numbers) & (without == "drop")
    return bool((nothing | (np.abs(numbers) <= MOST_METRES)).all())


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
