"""Paints the view through the windscreen, in integers only: a pure function of seed, traverse and place."""

from __future__ import annotations

import cv2
import numpy as np

from vprbench.api import Image

from ..rendering.chance import FULL, Chance
from ..rendering.film import BOTTOM, FAR, HEIGHT, PIXEL, WIDTH, Canvas, Film, develop, roughen, sky
from .faces import METRE, Camera, project
from .furniture import Furniture
from .ground import ground
from .houses import houses
from .town import PLACE_SPACING, Lie, Town
from .weather import WEATHERS, Weather

#: Raise it whenever a change in this folder, or in what it shares, changes a pixel: it is part of the protocol.
VERSION = 1

# How many places it takes until the mood of a traverse is another: overcast, haze, camera to the right, heading,
# offset along the street, exposure, pitch.
_MOOD_PLACES = np.array([40, 60, 9, 6, 8, 14, 5])
_HORIZON = 41 * PIXEL
_SKY_ROWS = 52
_BRIGHT = np.uint8(150)  # what is brighter glows at dusk
_STONE = np.array([128, 120, 112])


class Renderer:
    """Renders any place of the drive of one seed; keeps nothing between frames, so threads may share it."""

    def __init__(self, seed: int) -> None:
        """Prepare the textures, the only thing that frames share."""
        self._chance = Chance(seed)
        self._town = Town(self._chance)
        self._furniture = Furniture(self._chance)
        self._film = Film(self._chance)

    def render(self, traverse: str, place: int, ahead: int = 0) -> Image:
        """Return the frame of a place, or from 1/16 metres `ahead` of it, uint8 (HEIGHT, WIDTH, 3), RGB."""
        weather = WEATHERS[traverse]
        own = 600 + 20 * weather.number
        luck = self._chance.dice(own + 15, np.array([place]))[:, 0].tolist()
        mood = self._chance.smooth(own + np.arange(len(_MOOD_PLACES)), np.array(place), _MOOD_PLACES).tolist()
        position = place * PLACE_SPACING + ahead + (mood[4] - FULL // 2) * 4 * METRE // FULL + (luck[0] - 128) // 16
        lie, lots = self._town.lie(position), self._town.lots(position)
        camera = self._camera(weather, lie, luck, mood)

        canvas = self._sky(weather, place, mood, camera)
        _paint_skyline(canvas, weather, lie, camera)
        shade = 256 + lots.sign * lie.sun_side * weather.sunshine * -2 // FULL
        rows = np.concatenate([
            *ground(lots, lie, position, weather, self._chance),
            *houses(lots, weather, self._chance, shade),
            *self._furniture.faces(position, place, weather, lots),
        ])  # fmt: skip
        scene = project(rows, camera)
        for outline, paint in zip(scene.outlines, scene.paints, strict=True):
            cv2.fillConvexPoly(canvas, outline, paint, shift=4)
        _mirror(canvas, weather, camera)
        return self._expose(canvas, weather, place, luck, mood)

    def _camera(self, weather: Weather, lie: Lie, luck: list[int], mood: list[int]) -> Camera:
        return Camera(
            lateral=-24 + weather.lateral + (mood[2] - FULL // 2) * 20 // FULL,
            centre=WIDTH * PIXEL // 2 + weather.shift_x + (mood[3] - FULL // 2) // 12 + (luck[1] - 128) // 24,
            horizon=_HORIZON + lie.climb + weather.shift_y + (mood[6] - FULL // 2) // 20 + (luck[2] - 128) // 24,
            bend=lie.bend,
            light=np.array(weather.light) * (240 + mood[0] // 32) >> 8,
            grey=weather.grey,
            haze=np.array(weather.sky_low) * 15 >> 4,
            thickness=weather.haze * (300 + mood[1]) // FULL,
        )

    def _sky(self, weather: Weather, place: int, mood: list[int], camera: Camera) -> Canvas:
        """Return a canvas with the sky on it."""
        cloud = self._film.clouds(_SKY_ROWS, mood[1], place * 11 + weather.number * 171)
        overcast = min(max(weather.overcast + (mood[0] - FULL // 2) // 6, 0), 256)
        return sky(cloud, overcast, camera.horizon // PIXEL, weather.sky_top, weather.sky_low, weather.cloud)

    def _expose(self, canvas: Canvas, weather: Weather, place: int, luck: list[int], mood: list[int]) -> Image:
        """Return the picture the camera takes of the canvas: texture, glow, drops, exposure and sharpness."""
        picture = roughen(canvas, self._film.grain(luck[3:6]), weather.sensor)
        if weather.lamps > 200:
            bright = cv2.GaussianBlur(np.maximum(picture, _BRIGHT) - _BRIGHT, (15, 15), 0)
            picture = np.asarray(cv2.add(picture, bright), np.uint8)
        if weather.drops:
            self._put_drops(picture, weather, place, luck[6])
        gain = weather.exposure + (mood[5] - FULL // 2) // 12 + (luck[7] - 128) // 12
        return develop(picture, 5 if luck[6] < weather.softness else 3, gain)

    def _put_drops(self, picture: Image, weather: Weather, place: int, luck: int) -> None:
        """Put drops on the lens: each shows what lies on its other side."""
        number = np.arange(weather.drops * (96 + luck) // 352)
        dice = self._chance.dice(700, place * 64 + number)
        for x, y, size in zip(
            (dice[0] * WIDTH >> 8).tolist(), (dice[1] * HEIGHT >> 8).tolist(), (dice[2] >> 6).tolist(), strict=True
        ):
            seen = picture[HEIGHT - 1 - y * 3 // 4, x].tolist()
            cv2.circle(picture, (x, y), 1 + size, [min(value + 24, 255) for value in seen], -1)


def _paint_skyline(canvas: Canvas, weather: Weather, lie: Lie, camera: Camera) -> None:
    """Paint the roofs and the tower that stand beyond the end of the street."""
    light = camera.light
    colour = _STONE * light >> 8
    colour += (camera.haze - colour) * (90 + camera.thickness // 2) >> 8
    knots = np.arange(len(lie.skyline))
    left = (knots * 8 - 16) * PIXEL + camera.centre - WIDTH * PIXEL // 2
    tops = camera.horizon - lie.skyline
    roofs = np.stack([np.repeat(left, 2), np.repeat(tops, 2)], axis=1)
    roofs[1::2, 0] += 8 * PIXEL
    outline = np.concatenate([[[-FAR, BOTTOM]], roofs, [[FAR, BOTTOM]]]).astype(np.int32)
    x, base = camera.centre + lie.spire, camera.horizon
    if abs(lie.spire) < WIDTH * PIXEL:
        spire = [(x - 50, base), (x - 50, base - 210), (x, base - 400), (x + 50, base - 210), (x + 50, base)]
        cv2.fillConvexPoly(canvas, np.array(spire, np.int32), [*(colour * 7 >> 3).tolist(), 10], shift=4)
    cv2.fillPoly(canvas, [outline], [*colour.tolist(), 20], shift=4)


def _mirror(canvas: Canvas, weather: Weather, camera: Camera) -> None:
    """Let the wet ground mirror what stands above it."""
    if not weather.wet:
        return
    first = camera.horizon // PIXEL + 2
    above = np.maximum(2 * first - 1 - np.arange(first, HEIGHT), 0)
    mirrored = cv2.GaussianBlur(canvas[above, :, :3], (3, 7), 0).astype(np.int16)
    below = canvas[first:, :, :3]
    # Only bare ground is a mirror, known by its roughness.
    rough = canvas[first:, :, 3:]
    slant = 256 - 3 * np.arange(HEIGHT - first)[:, None, None]
    strength = np.where((rough >= 25) & (rough < 60), weather.wet * slant >> 8, 0).astype(np.int16)
    below[:] = below + ((mirrored - below) * strength >> 8)
