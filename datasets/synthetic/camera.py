"""Where a point beside the line lies in the picture, and what light and air do to its colour."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .chance import Ints
from .film import PIXEL
from .route import DEPTHS, METRE

SIGNS = np.array([-1, 1])  # left, right

_FOCAL = 120 * PIXEL
_EYE = 3 * METRE  # above the rails


@dataclass(frozen=True)
class Camera:
    """Where the picture's axes lie and what the air and the light do, for one frame."""

    centre: int  # of the picture, in 1/16 pixel
    horizon: int
    bend: int  # of the track at the farthest cross-section
    light: Ints  # (3,), in 1/256
    sun: int  # how much brighter the right side is than the left, in 1/256
    haze: Ints  # (3,), the colour of distance
    thickness: int  # of the haze at the farthest cross-section, 0 to 256

    def across(self, x: Ints, depth: Ints) -> Ints:
        """Return picture columns in 1/16 pixel."""
        column: Ints = self.centre + self.bend * depth // DEPTHS[0] + _FOCAL * x // depth
        return column

    def down(self, z: Ints, depth: Ints) -> Ints:
        """Return picture rows in 1/16 pixel."""
        return self.horizon - _FOCAL * (z - _EYE) // depth

    def lit(self, colour: Ints, depth: Ints, sign: Ints) -> Ints:
        """Return colours (..., 3) as light and haze leave them; sign is -1 on the left, 1 on the right."""
        gain = (256 + self.sun * sign)[..., None] * self.light
        seen = np.minimum(colour * gain >> 16, 255)
        lost = (self.thickness * depth // DEPTHS[0])[..., None]
        final: Ints = seen + ((self.haze - seen) * lost >> 8)
        return final
