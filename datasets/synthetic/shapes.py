"""Outlines of the things beside the line, seen face on, each a polygon of ten corners.

A level line crosses each outline twice at most, which is what OpenCV's fast fillConvexPoly asks for.
"""

from __future__ import annotations

import numpy as np

from .chance import Ints

CORNERS = 10
#: Outlines are in 1/64 of a thing's half width (to the right) and of its height (upwards).
UNIT = 64


def _outline(*corners: tuple[int, int]) -> list[tuple[int, int]]:
    return [*corners, *[corners[-1]] * (CORNERS - len(corners))]


def _box(left: int, bottom: int, right: int, top: int) -> list[tuple[int, int]]:
    return _outline((left, bottom), (left, top), (right, top), (right, bottom))


_OUTLINES = {
    # Conifers step inwards tier by tier; crowns are lopsided ovals on a trunk.
    "conifer": _outline(
        (-64, 4), (-40, 24), (-46, 24), (-24, 46), (0, 64), (24, 46), (46, 24), (40, 24), (64, 4), (0, 0)
    ),
    "slim conifer": _outline(
        (-50, 2), (-30, 20), (-38, 20), (-14, 48), (0, 64), (18, 42), (28, 24), (22, 20), (56, 6), (0, 0)
    ),
    "crown": _outline(
        (-40, 20), (-64, 34), (-56, 50), (-30, 62), (4, 64), (36, 58), (60, 46), (58, 30), (30, 18), (0, 15)
    ),
    "wide crown": _outline(
        (-54, 18), (-60, 30), (-42, 44), (-36, 56), (-4, 64), (20, 54), (46, 56), (64, 38), (50, 20), (6, 14)
    ),
    "bush": _outline((-64, 0), (-56, 30), (-34, 50), (-10, 64), (14, 62), (38, 48), (58, 26), (64, 0)),
    "trunk": _box(-6, 0, 6, 50),
    "twigs": _outline((-3, 0), (-8, 26), (-38, 54), (-16, 64), (14, 62), (36, 52), (9, 28), (4, 0)),
    "wall": _box(-64, 0, 64, 64),
    "roof": _outline((-72, 62), (0, 104), (72, 62)),
    "flat roof": _outline((-70, 62), (-52, 92), (52, 92), (70, 62)),
    "window left": _box(-42, 22, -16, 46),
    "window right": _box(12, 22, 40, 46),
    "cabin": _outline((-40, 58), (-28, 104), (26, 104), (44, 58)),
    "head": _outline((-26, 66), (-34, 78), (-20, 90), (20, 90), (34, 78), (26, 66)),
    "arm": _box(-64, 58, 64, 61),
    "body": _outline((-64, 30), (-60, 62), (44, 64), (52, 88), (64, 84), (58, 30)),
    "legs": _box(-46, 0, 42, 30),
    "deck": _box(-64, 46, 64, 60),
}

OUTLINES: Ints = np.array(list(_OUTLINES.values()), np.int64)  # (shapes, CORNERS, 2)
SHAPE = {name: number for number, name in enumerate(_OUTLINES)}
