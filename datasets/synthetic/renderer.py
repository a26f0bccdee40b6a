"""Paints the view from the driver's seat, in integers only: a pure function of seed, season and place."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from vprbench.api import Image

from .camera import Camera
from .chance import FULL, Chance
from .film import PIXEL, WIDTH, Canvas, Film, Outlines, Paint, develop, roughen, sky
from .land import belts, ground_colours, land_outlines, paint_ridges, water_colours
from .route import BELTS, DEPTHS, METRE, PLACE_SPACING, Route, View
from .scenery import Scenery, Things
from .seasons import SEASONS, Season, SnowCover
from .shapes import OUTLINES, UNIT
from .track import ribbons

#: Raise it whenever a change in this folder changes a pixel: it is part of the protocol.
VERSION = 2

# How many places it takes until the mood of a traverse is another: overcast, haze, camera to the right,
# camera down, offset along the track, exposure, depth of snow, snow on the line, wet windscreen, side of the sun.
_MOOD_PLACES = np.array([25, 60, 7, 9, 12, 18, 9, 14, 16, 11])
_HORIZON = 38 * PIXEL
_SKY_ROWS = 58


class Renderer:
    """Renders any place of the journey of one seed; keeps nothing between frames, so threads may share it."""

    def __init__(self, seed: int) -> None:
        """Prepare the textures, the only thing that frames share."""
        self._chance = Chance(seed)
        self._route = Route(self._chance)
        self._scenery = Scenery(self._chance)
        self._film = Film(self._chance)

    def render(self, season_name: str, place: int) -> Image:
        """Return the frame of a place, uint8 (HEIGHT, WIDTH, 3), RGB."""
        season = SEASONS[season_name]
        luck = self._chance.dice(600 + season.number, np.array([place]))[:, 0].tolist()
        mood = self._chance.smooth(
            600 + 10 * season.number + np.arange(len(_MOOD_PLACES)), np.array([place]), _MOOD_PLACES
        ).tolist()
        astray = (mood[4] - FULL // 2) * season.astray * METRE // FULL + (luck[0] - 128) // 16
        position = place * PLACE_SPACING + astray
        view = self._route.view(position)
        overcast = min(max(season.overcast + (mood[0] - FULL // 2) // 4, 0), 256)
        camera = self._camera(season, view, luck, mood, overcast)
        fallen = season.snow * (700 + mood[6] - FULL // 2) // 700
        snow = np.clip(fallen + (view.altitude - 380) * season.snow_uphill // 500, 0, 256)  # (n,)
        line = snow * min(max(mood[7] - 160, 0), 400) // 400
        cover = SnowCover(snow, line, np.minimum(snow, min(max(fallen - 130, 0), 200)))

        canvas = self._sky(season, place, mood, overcast, camera)
        paint_ridges(canvas, season, view, camera, snow)
        things = _project(self._scenery.things(view, season_name, position, cover), camera)
        _paint_land(canvas, season, view, camera, cover, things, luck)
        return self._expose(canvas, season, luck, mood)

    def _camera(self, season: Season, view: View, luck: list[int], mood: list[int], overcast: int) -> Camera:
        sun = season.sunshine * (mood[9] - FULL // 2) * (256 - overcast) >> 17
        return Camera(
            centre=WIDTH * PIXEL // 2 + season.shift_x + (mood[2] - 512) // 32 + (luck[1] - 128) // 24,
            horizon=_HORIZON + view.grade + season.shift_y + (mood[3] - 512) // 40 + (luck[2] - 128) // 32,
            bend=view.bend,
            light=np.array(season.light) * (280 - overcast // 4) >> 8,
            sun=sun,
            haze=np.array(season.sky_low) * 15 >> 4,
            thickness=min(season.haze * (300 + mood[1]) // FULL + overcast // 8, 230),
        )

    def _sky(self, season: Season, place: int, mood: list[int], overcast: int, camera: Camera) -> Canvas:
        """Return a canvas with the sky on it."""
        cloud = self._film.clouds(_SKY_ROWS, mood[1], place * 5 + season.number * 171)
        shape = min(max(256 - ((overcast - 100) * season.stratus >> 6), 0), 256)
        softened = np.asarray(cv2.LUT(cloud, (128 + ((np.arange(256) - 128) * shape >> 8)).astype(np.uint8)), np.uint8)
        return sky(softened, overcast, camera.horizon // PIXEL, season.sky_top, season.sky_low, season.cloud)

    def _expose(self, canvas: Canvas, season: Season, luck: list[int], mood: list[int]) -> Image:
        """Return the picture the camera takes of the canvas: texture, exposure and sharpness."""
        picture = roughen(canvas, self._film.grain(luck[3:6]), sensor=1)
        gain = season.exposure + (mood[5] - FULL // 2) // 16 + (luck[7] - 128) // 16
        smear = (mood[8] * season.softness >> 15) + (luck[6] < season.softness)
        return develop(picture, 3 + 2 * smear, gain)


@dataclass(frozen=True)
class _Painted:
    """Things in the picture, far to near; those before cross-section s are starts[s] to starts[s + 1] - 1."""

    outlines: Outlines  # (things, corners, 2), in 1/16 pixel
    colours: list[Paint]
    starts: list[int]


def _project(things: Things, camera: Camera) -> _Painted:
    """Bring things into the picture, drop those beside it, and sort them far to near."""
    outline = OUTLINES[things.shape]  # (things, corners, 2)
    depth = things.depth[:, None]
    points = np.empty(outline.shape, np.int32)
    x = things.x[:, None] + outline[..., 0] * things.half_width[:, None] // UNIT
    z = things.foot[:, None] + outline[..., 1] * things.height[:, None] // UNIT
    points[..., 0], points[..., 1] = camera.across(x, depth), camera.down(z, depth)
    inside = np.flatnonzero((points[..., 0].max(1) > 0) & (points[..., 0].min(1) < WIDTH * PIXEL))
    order = inside[np.argsort(-things.depth[inside], kind="stable")]
    nearness = -things.depth[order]
    colours = np.empty((len(order), 4), np.int64)
    colours[:, :3] = camera.lit(things.colour[order], -nearness, np.sign(things.x[order]))
    colours[:, 3] = things.rough[order]
    starts = np.append(np.searchsorted(nearness, -DEPTHS), len(order))
    return _Painted(points[order], colours.tolist(), starts.tolist())


def _paint_land(
    canvas: Canvas, season: Season, view: View, camera: Camera, snow: SnowCover, things: _Painted, luck: list[int]
) -> None:
    """Paint cross-section after cross-section, far to near, each with what stands before it."""
    ground = ground_colours(season, view, camera, snow.land)
    water = water_colours(season, camera)
    land, shore = land_outlines(view, camera)
    woods, wood_colours = belts(season, view, camera, snow.woods)
    strips = ribbons(view, camera, snow.line, luck)
    wet = (view.wet > 0).tolist()
    wooded = (view.forest > 380).tolist()
    for section in range(len(DEPTHS)):
        for side in (0, 1):
            if wet[section][side]:
                cv2.fillConvexPoly(canvas, shore[section, side], water[section], shift=4)
            cv2.fillPoly(canvas, [land[section, side]], ground[section][side], shift=4)
            if section < BELTS and wooded[section][side]:
                cv2.fillPoly(canvas, [woods[section, side]], wood_colours[section][side], shift=4)
        for outline, colour in strips[section]:
            cv2.fillConvexPoly(canvas, outline, colour, shift=4)
        for thing in range(things.starts[section], things.starts[section + 1]):
            cv2.fillConvexPoly(canvas, things.outlines[thing], things.colours[thing], shift=4)
