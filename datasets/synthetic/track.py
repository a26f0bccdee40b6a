"""What runs along the line: track, platform, road, overhead wire, and a train that waits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .camera import Camera
from .chance import Ints
from .film import Outlines, Paint
from .route import DEPTHS, METRE, WATER_LEVEL, View
from .scenery import SNOW

_TRACK_DEPTHS = np.append(DEPTHS, 5 * METRE)  # the last lies below the picture's edge


@dataclass(frozen=True)
class _Ribbon:
    """What runs along the line with a constant cross-section: a strip between two points of it, in units."""

    left: tuple[int, int]  # x to the right, z above the rails
    right: tuple[int, int]
    where: str
    colour: tuple[int, int, int]
    snow: int  # how much of the snow stays on it, 0 to 256
    rough: int


_RIBBONS = (
    _Ribbon((-34, 0), (34, 0), "everywhere", (92, 86, 80), 240, 60),  # ballast
    _Ribbon((-20, 1), (20, 1), "everywhere", (96, 88, 82), 215, 50),  # sleepers
    _Ribbon((-13, 2), (-11, 2), "near", (74, 66, 62), 0, 0),  # rails
    _Ribbon((11, 2), (13, 2), "near", (74, 66, 62), 0, 0),
    _Ribbon((42, 0), (104, 0), "station", (124, 116, 108), 200, 60),  # a second track
    _Ribbon((60, 2), (62, 2), "near station", (150, 142, 138), 0, 0),
    _Ribbon((84, 2), (86, 2), "near station", (150, 142, 138), 0, 0),
    _Ribbon((-40, 0), (-40, 16), "station", (112, 110, 106), 0, 10),  # a platform
    _Ribbon((-92, 16), (-40, 16), "station", (150, 146, 140), 200, 20),
    _Ribbon((48, 8), (48, 64), "train", (150, 40, 40), 0, 10),  # a train on the second track
    _Ribbon((48, 36), (48, 50), "train", (38, 10, 10), 0, 0),
    _Ribbon((-1, 92), (1, 92), "electrified", (96, 98, 104), 0, 0),  # the overhead line
    _Ribbon((192, 0), (272, 0), "left road", (92, 92, 96), 100, 10),  # lies on the ground instead
    _Ribbon((192, 0), (272, 0), "right road", (92, 92, 96), 100, 10),
)
_RIBBON_X = np.array([(ribbon.left[0], ribbon.right[0]) for ribbon in _RIBBONS])[..., None]  # (ribbons, 2, 1)
_RIBBON_X[-2] *= -1
_RIBBON_Z = np.array([(ribbon.left[1], ribbon.right[1]) for ribbon in _RIBBONS])[..., None]
_RIBBON_COLOURS = np.array([ribbon.colour for ribbon in _RIBBONS])[:, None]  # (ribbons, 1, 3)
_RIBBON_SNOW = np.array([ribbon.snow for ribbon in _RIBBONS])[:, None]
_ROAD_COLUMN = 3  # its ground
_TRAIN_FRONT = (  # left, bottom, right, top, colour
    (48, 8, 98, 66, (178, 52, 46)),
    (53, 38, 93, 56, (36, 40, 50)),
    (70, 24, 76, 28, (250, 246, 220)),
)


def ribbons(view: View, camera: Camera, snow: Ints, luck: list[int]) -> list[list[tuple[Outlines, Paint]]]:
    """Return per cross-section what runs along the line from there to the next."""
    everywhere = np.ones(len(DEPTHS), bool)
    near, station = DEPTHS < 130 * METRE, view.station > 0
    road_z = view.heights[:, view.road_side, _ROAD_COLUMN]
    road = (view.road > 0) & (road_z > WATER_LEVEL)
    train = station & (luck[5] < 70) & (np.arange(len(DEPTHS)) < 8 + luck[4] % 10)
    masks = {
        "everywhere": everywhere,
        "near": near,
        "station": station,
        "near station": near & station,
        "train": train,
        "electrified": everywhere & view.electrified,
        "left road": road & (view.road_side == 0),
        "right road": road & (view.road_side == 1),
    }
    where = [masks[ribbon.where] for ribbon in _RIBBONS]
    used = [number for number, mask in enumerate(where) if mask.any()]
    z = _RIBBON_Z[used] + 0 * _TRACK_DEPTHS  # (used, 2, n + 1)
    if used[-1] >= len(_RIBBONS) - 2:
        z[-1] = np.maximum(np.append(road_z, road_z[-1]), WATER_LEVEL)
    x, y = camera.across(_RIBBON_X[used], _TRACK_DEPTHS), camera.down(z, _TRACK_DEPTHS)
    outlines = np.empty((len(used), len(DEPTHS), 4, 2), np.int32)
    for axis, points in enumerate((x, y)):
        outlines[:, :, :2, axis] = points[:, :, :-1].transpose(0, 2, 1)
        outlines[:, :, 2:, axis] = points[:, ::-1, 1:].transpose(0, 2, 1)
    plain, covered = _RIBBON_COLOURS[used], (_RIBBON_SNOW[used] * snow)[..., None]
    colour = plain + ((SNOW - plain) * covered >> 16)
    lit = camera.lit(colour, DEPTHS, 0 * DEPTHS).tolist()
    per_section: list[list[tuple[Outlines, Paint]]] = [[] for _ in DEPTHS]
    for row, number in enumerate(used):
        rough = _RIBBONS[number].rough
        for section in np.flatnonzero(where[number]).tolist():
            per_section[section].append((outlines[row, section], [*lit[row][section], rough]))
    if train.any():
        last = int(np.flatnonzero(train)[-1])
        per_section[last] += _train_front(camera, int(_TRACK_DEPTHS[last + 1]))
    return per_section


def _train_front(camera: Camera, nearest: int) -> list[tuple[Outlines, Paint]]:
    """Return the end of the train that faces the camera: paint, windscreen, headlight."""
    depth, painted = np.array([nearest]), []
    for left, bottom, right, top, colour in _TRAIN_FRONT:
        x = camera.across(np.array([left, left, right, right]), depth)
        y = camera.down(np.array([bottom, top, top, bottom]), depth)
        painted.append((np.stack([x, y], axis=-1).astype(np.int32), [*colour, 4]))
    return painted
