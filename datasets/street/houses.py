"""The faces of houses: fronts, roofs, gables, windows, doors and shops."""

from __future__ import annotations

import numpy as np

from ..rendering.chance import Chance, Ints
from .faces import METRE, Corner, Numbers, faces
from .town import MODERN, PARK, SHOP, STONE, TERRACE, Lots
from .weather import Weather

_DETAIL = 52 * METRE  # farther away windows are seen as rows
_DEEP = 9 * METRE  # houses
_COLUMNS, _FLOORS = 3, 5
_ROOFS = np.array([(96, 88, 84), (124, 92, 76), (70, 74, 84), (108, 100, 92)])
_GLASS = np.array([(44, 52, 62), (60, 70, 82), (30, 36, 44), (84, 96, 110)])
_DOORS = np.array([(120, 30, 30), (30, 56, 96), (34, 74, 52), (36, 36, 40)])
_SIGNS = np.array([
    (170, 36, 34), (34, 60, 128), (30, 96, 66), (226, 190, 60),
    (36, 36, 40), (220, 216, 206), (118, 50, 106), (206, 110, 40),
])  # fmt: skip
_LIGHTS = np.array([(255, 214, 130), (255, 226, 160), (250, 196, 104), (214, 226, 240)])


def houses(lots: Lots, weather: Weather, chance: Chance, shade: Ints) -> list[Ints]:
    """Return the faces of every house; `shade` (n,) is the light on each front, in 1/256."""
    built = (lots.kind < PARK) & (lots.end > 0)
    lots, shade = lots.take(built), shade[built]
    near = lots.start < _DETAIL
    return [
        *_walls(lots, weather, shade),
        *_windows(lots.take(near), weather, chance, shade[near]),
        *_rows_of_windows(lots.take(~near), weather, shade[~near]),
        *_ground_floors(lots.take(near), weather, chance, shade[near]),
    ]


def front(lots: Lots, low: Numbers, high: Numbers, start: Numbers, end: Numbers) -> list[Corner]:
    """Return a rectangle on the front of each lot's house."""
    x = lots.sign * lots.front
    return [(x, low, start), (x, high, start), (x, high, end), (x, low, end)]


def _walls(lots: Lots, weather: Weather, shade: Ints) -> list[Ints]:
    """Return fronts, the walls that face the camera, roofs and chimneys."""
    near, ridge, far = (lots.sign * (lots.front + beyond) for beyond in (0, _DEEP // 2, _DEEP))
    eaves, top = lots.eaves, lots.eaves + lots.rise
    gable: list[Corner] = [(near, 0, lots.start), (near, eaves, lots.start), (ridge, top, lots.start),
                           (far, eaves, lots.start), (far, 0, lots.start)]  # fmt: skip
    slope = [(near, eaves, lots.start), (ridge, top, lots.start), (ridge, top, lots.end), (near, eaves, lots.end)]
    roof = _ROOFS[lots.block[6] & 3]
    left, right = (lots.sign * (lots.front + beyond) for beyond in (3 * METRE, 9 * METRE // 2))
    chimney = [(left, eaves, lots.start), (left, top + METRE, lots.start), (right, top + METRE, lots.start),
               (right, eaves, lots.start)]  # fmt: skip
    smoking, bare = (lots.rise > 0) & (lots.dice[5] < 150), lots.bare
    trim = np.where((lots.block[2] & 1)[:, None] > 0, lots.wall * 5 >> 2, lots.wall * 3 >> 2)
    plinth = np.where((lots.kind == STONE) | (lots.kind == MODERN), 14, 8)
    return [
        faces(chimney, lots.wall * 3 >> 2, lots.end, 0, shade=200)[smoking],
        faces(gable, lots.wall, lots.end, 1, shade=214 + weather.sunshine // 8, rough=22)[bare],
        faces(slope, roof, lots.end, 2, shade=(shade + 300) // 2, rough=30)[lots.rise > 0],
        faces(front(lots, 0, eaves, lots.start, lots.end), lots.wall, lots.end, 3, shade=shade, rough=22),
        faces(front(lots, eaves - 7, eaves + 3, lots.start, lots.end), trim, lots.end, 4, shade=shade),
        faces(front(lots, 0, plinth, lots.start, lots.end), lots.wall // 2, lots.end, 4, shade=shade),
    ]


def _windows(lots: Lots, weather: Weather, chance: Chance, shade: Ints) -> list[Ints]:
    """Return frames and panes, floor by floor; some have light in them."""
    floor, column = np.arange(_FLOORS)[None, :, None], np.arange(_COLUMNS)[None, None, :]
    columns = np.where(lots.kind == TERRACE, 2, 2 + (lots.block[3] & 1))[:, None, None]
    there = (floor < lots.floors[:, None, None]) & (column < columns)
    there &= (floor > 0) | ((lots.kind != SHOP)[:, None, None] & (column != (lots.dice[5] % 3)[:, None, None]))
    lot, at_floor, at_column = np.nonzero(there)
    lots, shade = lots.at(lot), shade[lot]
    n = columns[lot, 0, 0]
    pitch = (lots.end - lots.start) // n
    middle = lots.start + pitch * (2 * at_column + 1) // 2
    half = pitch * np.where(lots.kind == MODERN, 108, 60 + (lots.block[4] >> 3)) >> 8
    low = at_floor * lots.floor + 12 + (lots.block[5] & 3)
    high = low + (lots.floor * (140 + (lots.block[7] >> 3)) >> 8)
    code = (lots.index * _FLOORS + at_floor) * _COLUMNS + at_column
    own = chance.dice(1200 + 10 * weather.number + lots.sign, code)
    always = chance.dice(1190 + lots.sign, code)
    lit = own[0] < weather.lit
    curtain = (always[0] < 60)[:, None]
    glass = np.where(curtain, _GLASS[always[1] & 3] + 70, _GLASS[always[1] & 3])
    glass = np.where(lit[:, None], _LIGHTS[own[1] & 3] * (150 + own[2] * 106 // 255)[:, None] >> 8, glass)
    frame = np.where((lots.block[1] & 3)[:, None] > 0, np.array((214, 210, 202)), lots.wall * 2 // 3)
    glint = 256 + (always[2] >> 1) * (weather.sunshine > 0)
    return [
        faces(front(lots, low - 3, high + 2, middle - half - 3, middle + half + 3), frame, lots.end, 5, shade=shade),
        faces(front(lots, low, high, middle - half, middle + half), glass, lots.end, 6, shade=glint, rough=0, glow=lit),
    ]


def _rows_of_windows(lots: Lots, weather: Weather, shade: Ints) -> list[Ints]:
    """Return the windows of distant houses, a strip for each floor."""
    lot, floor = np.nonzero(np.arange(_FLOORS)[None] < lots.floors[:, None])
    lots, shade = lots.at(lot), shade[lot]
    low = floor * lots.floor + 12
    colour = (lots.wall + _GLASS[lots.block[4] & 3]) // 2
    lit = weather.lit * (lots.dice[6] + lots.dice[4])[:, None] // 512
    colour = colour + ((_LIGHTS[lots.dice[4] & 3] - colour) * lit >> 8)
    strip = front(lots, low, low + lots.floor // 2, lots.start + 8, lots.end - 8)
    return [faces(strip, colour, lots.end, 5, shade=shade, rough=0)]


def _ground_floors(lots: Lots, weather: Weather, chance: Chance, shade: Ints) -> list[Ints]:
    """Return doors, shop windows, their signs and awnings."""
    homes, shops = lots.take((lots.kind == TERRACE) | (lots.kind == STONE)), lots.take(lots.kind == SHOP)
    pitch = (homes.end - homes.start) // 3
    hinge = homes.start + pitch * (homes.dice[5] % 3) + pitch // 3
    door = front(homes, 2, 36, hinge, hinge + 16)
    step = front(homes, 0, 41, hinge - 4, hinge + 20)
    own = chance.dice(1300 + 10 * weather.number + shops.sign, shops.index)
    lit = own[0] < weather.lit * 3 // 2
    pane = np.where(lit[:, None], _LIGHTS[own[1] & 3], _GLASS[shops.dice[4] >> 6])
    sign = _SIGNS[shops.dice[1] & 7]
    shop_shade = shade[lots.kind == SHOP]
    home_shade = shade[(lots.kind == TERRACE) | (lots.kind == STONE)]
    x, out = shops.sign * shops.front, shops.sign * (shops.front - 22)
    awning = [
        (x, 44, shops.start + 10),
        (out, 37, shops.start + 10),
        (out, 37, shops.end - 10),
        (x, 44, shops.end - 10),
    ]
    # A shop pulls its awning out when the sun shines or the rain falls, and not at dusk.
    out_now = (shops.dice[2] < 110) & (own[2] < 200 - weather.lit)
    return [
        faces(step, (198, 190, 176), homes.end, 6, shade=home_shade),
        faces(door, _DOORS[homes.dice[1] & 3], homes.end, 7, shade=home_shade, rough=4),
        faces(front(shops, 8, 38, shops.start + 10, shops.end - 10), pane, shops.end, 6, shade=300, rough=4, glow=lit),
        faces(front(shops, 40, 50, shops.start + 4, shops.end - 4), sign, shops.end, 7, shade=shop_shade, rough=4),
        faces(awning, sign, shops.end, 8, shade=240, rough=4)[out_now],
    ]
