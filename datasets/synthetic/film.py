"""What every rendered frame is made on: a canvas with roughness, textures from chance, and how it is developed."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
import numpy.typing as npt

from vprbench.api import Image

from .chance import FULL, Chance

Canvas = npt.NDArray[np.uint8]  # (HEIGHT, WIDTH, 4), RGB and roughness
Outlines = npt.NDArray[np.int32]  # (..., corners, 2), in 1/16 pixel
Colour = tuple[int, int, int]  # RGB, 0 to 255
Paint = list[int]  # red, green, blue, roughness

WIDTH, HEIGHT = 160, 90
PIXEL = 16  # coordinates are in 1/16 pixel, what OpenCV calls shift=4
BOTTOM = (HEIGHT + 2) * PIXEL
FAR = 40_000  # beyond every edge of the picture, in 1/16 pixel
ATLAS = 512  # width of a texture, which then repeats


class Film:
    """What the frames of one seed share: the grain of surfaces and the clouds."""

    def __init__(self, chance: Chance) -> None:
        """Make both textures, (2 * HEIGHT, ATLAS + WIDTH)."""
        self._grain = _texture(chance, 500, ((2, 90), (4, 90), (9, 76))).astype(np.int16) - 128
        self._clouds = _texture(chance, 510, ((4, 30), (8, 46), (16, 70), (32, 110)))

    def grain(self, luck: Sequence[int]) -> npt.NDArray[np.int16]:
        """Return what makes rough surfaces rough, (HEIGHT, WIDTH), -128 to 127, from where three dice say."""
        top, left = luck[0] * HEIGHT >> 8, (luck[1] * 256 + luck[2]) % ATLAS
        return self._grain[top : top + HEIGHT, left : left + WIDTH]

    def clouds(self, rows: int, mood: int, drift: int) -> npt.NDArray[np.uint8]:
        """Return the density of clouds, (rows, WIDTH): `mood`, 0 to FULL - 1, chooses them, `drift` is in pixels."""
        top, left = mood * HEIGHT // FULL, drift % ATLAS
        return self._clouds[top : top + rows, left : left + WIDTH]


def _texture(chance: Chance, channel: int, octaves: tuple[tuple[int, int], ...]) -> npt.NDArray[np.uint8]:
    """Return smooth noise (2 * HEIGHT, ATLAS + WIDTH) that repeats; octaves are (pixels, amplitude)."""
    total = np.zeros((2 * HEIGHT, ATLAS), np.uint16)
    for number, (spacing, amplitude) in enumerate(octaves):
        shape = (2 * HEIGHT // spacing + 1, ATLAS // spacing)
        knots = chance.dice(channel + number, np.arange(shape[0] * shape[1]))[0] * amplitude >> 8
        layer = knots.reshape(shape).astype(np.uint8)
        total += cv2.resize(layer, (ATLAS, 2 * HEIGHT), interpolation=cv2.INTER_LINEAR_EXACT)
    return np.concatenate([total, total[:, :WIDTH]], axis=1).clip(0, 255).astype(np.uint8)


def sky(
    cloud: npt.NDArray[np.uint8], overcast: int, horizon: int, top: Colour, low: Colour, cloud_colour: Colour
) -> Canvas:
    """Return a canvas with the sky on its upper rows, as many as the density of clouds has, (rows, WIDTH).

    `overcast` is the cover, 0 to 256; the colour changes from `top` to `low` at picture row `horizon`.
    """
    rows = len(cloud)
    density = np.arange(256)
    cover = np.minimum(np.maximum((density - (215 - overcast * 3 // 4)) * 2, 0), 127).astype(np.uint8)
    cover_here = cv2.LUT(cloud, cover).astype(np.int16)
    shade = np.maximum(density - 128, 0) * (overcast // 4 + 20) // 64
    fall = np.minimum(np.arange(rows) * 256 // horizon, 256)
    canvas = np.zeros((HEIGHT, WIDTH, 4), np.uint8)
    for band in range(3):  # band by band: a last axis of three is slow
        tint = np.maximum(cloud_colour[band] - shade, 0).astype(np.uint8)
        shaded = cv2.LUT(cloud, tint).astype(np.int16)
        clear = (top[band] + ((low[band] - top[band]) * fall >> 8)).astype(np.int16)[:, None]
        canvas[:rows, :, band] = clear + ((shaded - clear) * cover_here >> 7)
    return canvas


def roughen(canvas: Canvas, grain: npt.NDArray[np.int16], sensor: int) -> Image:
    """Return the canvas's colours with grain (HEIGHT, WIDTH): that of each surface, and the sensor's in 1/32."""
    *bands, rough = cv2.split(canvas)
    relief = (grain * rough.astype(np.int16) >> 8) + (grain * np.int16(sensor) >> 5)
    lighter, darker = np.maximum(relief, 0).astype(np.uint8), np.maximum(-relief, 0).astype(np.uint8)
    return np.asarray(cv2.merge([cv2.subtract(cv2.add(band, lighter), darker) for band in bands]), np.uint8)


def develop(picture: Image, blur: int, gain: int) -> Image:
    """Return the picture blurred over `blur` pixels (odd) and exposed by `gain` in 1/256."""
    # exact on uint8: OpenCV blurs it in fixed point
    soft = cv2.GaussianBlur(picture, (blur, blur), 0)
    exposed = np.minimum(np.arange(256) * gain >> 8, 255).astype(np.uint8)
    return np.asarray(cv2.LUT(soft, exposed), np.uint8)
