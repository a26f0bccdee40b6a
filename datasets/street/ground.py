"""The faces that lie on the ground: road, pavements, markings, lawns and shadows."""

from __future__ import annotations

import numpy as np

from ..rendering.chance import Chance, Ints
from .faces import METRE, NEAR, Corner, Numbers, faces
from .town import PARK, ROAD, SIDE_STREET, Lie, Lots
from .weather import Weather

_WIDE = 60 * METRE
_BEFORE_ALL = 10**9
_ASPHALT, _PAVING, _KERB = (82, 82, 84), (138, 134, 126), (170, 166, 158)
_PAINT, _YELLOW, _LAWN = (214, 214, 208), (206, 176, 60), (84, 110, 56)
# Between these depths everything that runs along the street is straight in the picture.
_STEPS = METRE * np.array([3, 5, 7, 10, 14, 20, 28, 40, 58, 80, 112])


def ground(lots: Lots, lie: Lie, position: int, weather: Weather, chance: Chance) -> list[Ints]:
    """Return everything on the ground; each entry is painted over the one before, and all before what stands."""
    asphalt = np.array(_ASPHALT) - weather.wet // 8
    paving = np.array(_PAVING) - weather.wet // 6
    parks, sides = lots.take(lots.kind == PARK), lots.take(lots.kind == SIDE_STREET)
    layers = [
        _along(-_WIDE, _WIDE, paving, 60),
        _along(-ROAD - 5, ROAD + 5, _KERB, 10),
        _along(-ROAD, ROAD, asphalt, 50),
        _across(parks, ROAD + 2 * METRE, _WIDE, _LAWN, 110),
        _across(sides, ROAD - 2, _WIDE, asphalt, 50),
        *_shadows(lots, lie, weather),
        *_markings(position, chance),
    ]
    for layer, rows in enumerate(layers):
        rows[:, -1] = _BEFORE_ALL - layer
    return layers


def _strip(left: Numbers, right: Numbers, near: Ints, far: Ints) -> list[Corner]:
    return [(left, 0, near), (left, 0, far), (right, 0, far), (right, 0, near)]


def _along(left: int, right: int, colour: Numbers | tuple[int, int, int], rough: int) -> Ints:
    """Return a strip that runs along the whole street, piece by piece."""
    near, far = _STEPS[:-1], _STEPS[1:]
    return faces(_strip(left, right, near, far), colour, near, 0, rough=rough)


def _across(lots: Lots, inner: int, outer: int, colour: Numbers | tuple[int, int, int], rough: int) -> Ints:
    """Return the ground of lots that are not built on."""
    start, end = np.maximum(lots.start, NEAR), np.maximum(lots.end, NEAR)
    return faces(_strip(lots.sign * inner, lots.sign * outer, start, end), colour, start, 0, rough=rough)


def _markings(position: int, chance: Chance) -> list[Ints]:
    """Return the middle line's dashes, lines along the kerb, and zebra crossings."""
    index = position // (6 * METRE) + np.arange(12)
    dash = index * 6 * METRE - position
    dashes = faces(_strip(-1, 2, dash, dash + 3 * METRE), _PAINT, dash, 0, rough=0)
    near = _STEPS[:-1]
    block = (position + near) // (45 * METRE)
    luck = chance.dice(1600, block)
    lines = []
    for side, dice in ((-1, luck[0]), (1, luck[1])):
        edge = _strip(side * (ROAD - 4), side * (ROAD - 2), near, _STEPS[1:])
        lines.append(faces(edge, _YELLOW, near, 0, rough=0)[dice < 120])
    crossing = position // (110 * METRE) + np.arange(2)
    start = (crossing * 110 + 10 + chance.dice(1610, crossing)[0] // 3) * METRE - position
    bars = np.arange(-ROAD + 6, ROAD - 6, 20)
    x, depth = np.tile(bars, 2), np.repeat(start, len(bars))
    zebra = faces(_strip(x, x + 10, depth, depth + 3 * METRE), _PAINT, depth, 0, rough=0)
    return [dashes, *lines, zebra]


def _shadows(lots: Lots, lie: Lie, weather: Weather) -> list[Ints]:
    """Return the shadows that the houses on the sun's side throw across the street."""
    if not weather.sunshine:
        return []
    sunny_side = 1 if lie.sun_side > 0 else -1
    lots = lots.take((lots.sign == sunny_side) & (lots.kind < PARK) & (lots.end > NEAR))
    long = lots.eaves * (abs(lie.sun_side) + 120) // 420
    inner = lots.sign * (lots.front - long)
    shade = 150 - weather.sunshine // 2
    return [
        faces(_strip(inner, lots.sign * lots.front, lots.start, lots.end), np.array(_ASPHALT) * shade >> 8,
              lots.start, 0, rough=40),
    ]  # fmt: skip
