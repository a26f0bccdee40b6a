"""The land in the picture: ground, water, distant woods and mountains."""

from __future__ import annotations

import cv2
import numpy as np

from .camera import SIGNS, Camera
from .chance import Ints
from .film import BOTTOM, FAR, PIXEL, WIDTH, Canvas, Outlines, Paint
from .route import BELTS, COLUMNS, DEPTHS, METRE, RIDGE_X, TOPS, WATER_LEVEL, View
from .scenery import SNOW
from .seasons import Season

_ROCK = np.array([118, 114, 110])
_FOREST_FLOOR = np.array([72, 74, 56])
_TWIGS = (112, 104, 98)

_BED_TO_HILLS = SIGNS[:, None] * np.append(0, COLUMNS)
_TOP_X = METRE * 6 + METRE * np.arange(TOPS) ** 2 // 3
_TOP_COLUMN = np.searchsorted(COLUMNS[:-1], _TOP_X) - 1
_TOP_REST = ((_TOP_X - COLUMNS[_TOP_COLUMN]) << 8) // (COLUMNS[_TOP_COLUMN + 1] - COLUMNS[_TOP_COLUMN])


def paint_ridges(canvas: Canvas, season: Season, view: View, camera: Camera, snow: Ints) -> None:
    """Paint the mountains behind the land: rock with snow above the snow line, then wooded hills."""
    far, near = view.ridges
    snow_line = 400 - int(snow[0]) - season.snow_uphill // 3 - (near >> 1) + (near[::-1] >> 2)
    woods = np.array(season.conifer) + ((SNOW - season.conifer) * snow[0] >> 10)
    layers = ((SNOW * 7 >> 3, far, 190), (_ROCK, np.minimum(far, snow_line), 180), (woods, near, 120))
    corners = np.empty((len(RIDGE_X) + 2, 2), np.int32)
    corners[:, 0] = np.append(RIDGE_X * PIXEL + camera.centre - WIDTH * PIXEL // 2, [FAR, -FAR])
    corners[:, 1] = BOTTOM
    for colour, tops, air in layers:
        corners[:-2, 1] = camera.horizon - tops
        seen = colour * camera.light >> 8
        seen += (camera.haze - seen) * (air * (200 + camera.thickness) // 400) >> 8
        cv2.fillPoly(canvas, [corners], (*seen.tolist(), 18), shift=4)


def ground_colours(season: Season, view: View, camera: Camera, snow: Ints) -> list[list[Paint]]:
    """Return colour and roughness of the land, (n, 2, 4)."""
    colour = np.empty((*view.tone.shape, 3), np.int64)
    colour[:] = season.grass
    shares = np.empty((4, *view.tone.shape), np.int64)
    shares[0], shares[1] = view.tillage - 560, view.forest - 560 >> 1
    shares[2], shares[3] = (view.altitude - 480)[:, None], view.rock - 800
    shares = np.minimum(np.maximum(shares, 0), 256)[..., None]
    for other, share in zip((season.field, _FOREST_FLOOR, season.heath, _ROCK), shares, strict=True):
        colour += (np.array(other) - colour) * share >> 8
    colour = colour * (208 + (view.tone >> 4))[..., None] >> 8
    blown = np.maximum(view.rock - 480, 0) // 2  # off by the wind
    covered = np.minimum(np.maximum(snow[:, None] * 3 // 2 - blown, 0), 256) * (snow > 0)[:, None]
    colour += (SNOW - colour) * covered[..., None] >> 8
    painted = np.empty((*view.tone.shape, 4), np.int64)
    painted[..., :3] = camera.lit(colour, DEPTHS[:, None], SIGNS)
    painted[..., 3] = 54 - (covered * 34 >> 8)
    paints: list[list[Paint]] = painted.tolist()
    return paints


def water_colours(season: Season, camera: Camera) -> list[Paint]:
    """Return colour and roughness of the water, (n, 4): it mirrors some of the sky."""
    painted = np.empty((len(DEPTHS), 4), np.int64)
    painted[:, :3] = camera.lit((np.array(season.water) * 3 + camera.haze >> 2)[None], DEPTHS, 0 * DEPTHS)
    painted[:, 3] = 6
    paints: list[Paint] = painted.tolist()
    return paints


def land_outlines(view: View, camera: Camera) -> tuple[Outlines, Outlines]:
    """Return the outlines of land and of water for each cross-section and side, (n, 2, corners, 2)."""
    depth = DEPTHS[:, None, None]
    land = np.empty((len(DEPTHS), 2, len(COLUMNS) + 4, 2), np.int32)
    land[:, :, :-3, 0] = camera.across(_BED_TO_HILLS, depth)
    land[:, :, -3:-1, 0] = (SIGNS * FAR)[:, None]
    land[:, :, -1, 0] = land[:, :, 0, 0]
    land[:, :, 0, 1] = camera.down(0 * DEPTHS, DEPTHS)[:, None]
    land[:, :, 1:-3, 1] = camera.down(view.heights, depth)
    land[:, :, -3, 1] = land[:, :, -4, 1]
    # Whatever lies below the next cross-section's lowest edge will be painted over anyway.
    lowest = np.append(land[1:, :, :-3, 1].max(axis=(1, 2)), BOTTOM)
    land[:, :, -2:, 1] = np.minimum(lowest + PIXEL, BOTTOM)[:, None, None]
    shore = np.empty((len(DEPTHS), 2, 4, 2), np.int32)
    shore[:, :, (0, 3), 0] = land[:, :, 3:4, 0]
    shore[:, :, 1:3, 0] = (SIGNS * FAR)[:, None]
    shore[:, :, :2, 1] = camera.down(0 * DEPTHS + WATER_LEVEL, DEPTHS)[:, None, None]
    shore[:, :, 2:, 1] = np.maximum(shore[:, :, :2, 1], BOTTOM)
    return land, shore


def belts(season: Season, view: View, camera: Camera, snow: Ints) -> tuple[Outlines, list[list[Paint]]]:
    """Return outlines and colours, (BELTS, 2, ...), of the woods behind the trees that stand alone."""
    heights, depths = view.heights[:BELTS], DEPTHS[:BELTS, None]
    low, high = heights[..., _TOP_COLUMN], heights[..., _TOP_COLUMN + 1]
    foot = low + ((high - low) * _TOP_REST >> 8)
    tall = 3 * METRE + np.minimum(np.maximum(view.forest[:BELTS] - 380, 0), 400)[..., None] * 10 * METRE // 400
    edge = view.clearing[:BELTS, :, None] * 10 * METRE >> 10
    tall = tall * np.minimum(np.maximum(_TOP_X - 3 * METRE - edge, METRE), 4 * METRE) // (4 * METRE)
    outlines = np.empty((BELTS, 2, 2 * TOPS, 2), np.int32)
    outlines[..., :TOPS, 0] = camera.across(SIGNS[:, None] * _TOP_X, depths[..., None])
    outlines[..., TOPS:, 0] = outlines[..., TOPS - 1 :: -1, 0][..., :TOPS]
    # Leaves, frost and growth: part of each crown is what another one is in summer.
    crowns = view.treetops + (np.roll(view.treetops, season.number, axis=-1) - view.treetops) * season.regrown // 256
    top = foot + (tall * (400 + crowns) >> 10)
    outlines[..., :TOPS, 1] = camera.down(top, depths[..., None])
    outlines[..., TOPS:, 1] = camera.down(foot, depths[..., None])[..., ::-1]
    conifer, leafy = np.array(season.conifer), np.array(season.leaf if season.foliage else _TWIGS)
    share = np.minimum(np.maximum(view.birch[:BELTS] - 300, 0), 512)[..., None]
    colour = conifer + ((leafy - conifer) * share >> 10)
    colour += (SNOW - colour) * snow[:BELTS, None, None] * 3 >> 10
    painted = np.empty((BELTS, 2, 4), np.int64)
    painted[..., :3] = camera.lit(colour, depths, SIGNS)
    painted[..., 3] = 80
    return outlines, painted.tolist()
