"""Flat faces of houses and things: where their corners lie in the street, and how the camera sees them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..rendering.chance import Ints
from ..rendering.film import PIXEL, WIDTH, Outlines, Paint

METRE = 16  # units of length
NEAR, REACH = 3 * METRE, 112 * METRE  # faces are cut off nearer than this, and none begins farther away
CORNERS = 8

_FOCAL = 104 * PIXEL
_EYE = 25  # above the road, in units
_FIELDS = 7  # of a face, beside its corners
_LAYERS = 32  # that faces of one depth may be painted in

Mask = npt.NDArray[np.bool_]
Numbers = Ints | int
Corner = tuple[Numbers, Numbers, Numbers]  # to the right of the street's middle, above the road, ahead


@dataclass(frozen=True)
class Camera:
    """Where the picture's axes lie and what light and air do, for one frame."""

    lateral: int  # to the right of the street's middle, in units
    centre: int  # of the picture, in 1/16 pixel
    horizon: int
    bend: int  # of the street at REACH, in 1/16 pixel
    light: Ints  # (3,), in 1/256
    grey: int  # how much saturation is lost, 0 to 256
    haze: Ints  # (3,), the colour of distance
    thickness: int  # of the haze at REACH, 0 to 256

    def across(self, x: Ints, depth: Ints) -> Ints:
        """Return picture columns in 1/16 pixel."""
        column: Ints = self.centre + self.bend * depth // REACH + _FOCAL * (x - self.lateral) // depth
        return column

    def down(self, z: Ints, depth: Ints) -> Ints:
        """Return picture rows in 1/16 pixel."""
        row: Ints = self.horizon - _FOCAL * (z - _EYE) // depth
        return row

    def lit(self, colour: Ints, shade: Ints, glow: Ints, depth: Ints) -> Ints:
        """Return colours (n, 3) of surfaces that get `shade` / 256 of the light, and shine themselves where `glow`."""
        light = np.where(glow[:, None] > 0, 256, self.light * shade[:, None] >> 8)
        seen = np.minimum(colour * light >> 8, 255)
        seen += (seen.sum(1, keepdims=True) // 3 - seen) * np.where(glow[:, None] > 0, 0, self.grey) >> 8
        lost = self.thickness * np.minimum(depth, REACH)[:, None] // REACH
        final: Ints = seen + ((self.haze - seen) * lost >> 8)
        return final


def faces(
    corners: Sequence[Corner], colour: npt.ArrayLike, order: Ints, layer: int, *,
    shade: Numbers = 256, rough: Numbers = 16, glow: Numbers | Mask = 0,
) -> Ints:  # fmt: skip
    """Return rows (n, 31) for `paint`: one face each, painted after all of a larger `order` and of a lower layer.

    `corners` are up to eight, each with numbers or arrays (n,).
    """
    rows = np.empty((len(order), 3 * CORNERS + _FIELDS), np.int64)
    for number, (x, z, depth) in enumerate(corners):
        rows[:, number], rows[:, CORNERS + number], rows[:, 2 * CORNERS + number] = x, z, depth
    if len(corners) < CORNERS:  # the last corner is all the others too
        points = rows[:, : 3 * CORNERS].reshape(-1, 3, CORNERS)
        points[..., len(corners) :] = points[..., len(corners) - 1, None]
    rows[:, -7:-4], rows[:, -4], rows[:, -3], rows[:, -2] = colour, shade, rough, glow
    rows[:, -1] = order * _LAYERS - layer
    return rows


@dataclass(frozen=True)
class Painted:
    """Faces in the picture, far to near."""

    outlines: Outlines  # (n, CORNERS, 2), in 1/16 pixel
    paints: list[Paint]


def project(rows: Ints, camera: Camera) -> Painted:
    """Bring faces into the picture, drop those outside of it, and sort them far to near."""
    depth = rows[:, 2 * CORNERS : 3 * CORNERS]
    rows = rows[depth.max(1) > NEAR]
    depth = np.maximum(rows[:, 2 * CORNERS : 3 * CORNERS], NEAR)
    points = np.empty((len(rows), CORNERS, 2), np.int32)
    points[..., 0] = camera.across(rows[:, :CORNERS], depth)
    points[..., 1] = camera.down(rows[:, CORNERS : 2 * CORNERS], depth)
    left, right = points[..., 0].min(1), points[..., 0].max(1)
    seen = np.flatnonzero((right > 0) & (left < WIDTH * PIXEL) & (right > left))
    chosen = seen[np.argsort(-rows[seen, -1], kind="stable")]
    rows = rows[chosen]
    paint = np.empty((len(rows), 4), np.int64)
    paint[:, :3] = camera.lit(rows[:, -7:-4], rows[:, -4], rows[:, -2], depth[chosen].min(1))
    paint[:, 3] = rows[:, -3] * camera.light.sum() // 768  # relief is only seen as far as light falls on it
    return Painted(points[chosen], paint.tolist())
