"""What the doctor finds in recordings of event cameras: codes and numbers."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from doctored import PLACES, coded, dataset_of, healthy

from vprbench.api.events import Events, Recording
from vprbench.data.doctor import examine

HEIGHT, WIDTH = 24, 32
SECOND = 1_000_000


def speed():
    """Metres in each of 60 seconds of a drive that stops again and again."""
    return 2 + 8 * (np.random.default_rng(5).random(PLACES) > 0.4)


def drive(seed):
    """Events as many as the camera is fast; light rises where the place says, whatever the season."""
    chance = np.random.default_rng(seed)
    second = np.repeat(np.arange(PLACES), 40 * speed().astype(int))
    t = np.sort(second * SECOND + chance.integers(SECOND, size=len(second)))
    x, y = chance.integers(WIDTH, size=len(t)), chance.integers(HEIGHT, size=len(t))
    rises = np.random.default_rng(9).random((PLACES, 3, 4)) > 0.5
    p = rises[t // SECOND, y // 8, x // 8] ^ (chance.random(len(t)) < 0.3)
    return Events(t, x.astype(np.uint16), y.astype(np.uint16), p)


def recorded(events, name, late_us=0, unit=1):
    """Return a recording that comes in chunks, with a position each second."""
    metres = np.stack([np.cumsum(speed()), np.zeros(PLACES)], axis=1)
    middle = SECOND * np.arange(PLACES) + SECOND // 2

    def chunks():
        for part in np.array_split(np.arange(len(events.t)), 7):
            yield Events(events.t[part], events.x[part], events.y[part], events.p[part])

    return Recording(name, chunks, HEIGHT, WIDTH, (middle + SECOND // 2 + late_us) // unit, metres, middle)


def swapped(events, back_us):
    t = events.t.copy()
    t[1000] = t[999] - back_us
    return replace(events, t=t)


def hole(events):
    kept = (events.t < 20 * SECOND) | (events.t > 22 * SECOND)
    return Events(events.t[kept], events.x[kept], events.y[kept], events.p[kept])


def hot(events):
    often = np.arange(len(events.t)) % 10 == 0
    x, y = (np.where(often, at, column).astype(np.uint16) for at, column in ((7, events.x), (5, events.y)))
    return replace(events, x=x, y=y)


Damage = Callable[[Events], Recording]
FOUND = {
    "nothing": (lambda events: recorded(events, "winter"), []),
    "time that runs backwards": (lambda events: recorded(swapped(events, 70_000), "winter"), ["error time: 1 70,000"]),
    "a late packet": (lambda events: recorded(swapped(events, 7_000), "winter"), ["note time: 1 7,000"]),
    "a gap": (lambda events: recorded(hole(events), "winter"), ["warning gaps: 1 2.0"]),
    "a hot pixel": (lambda events: recorded(hot(events), "winter"), ["warning hot pixels: 1 10."]),
    "polarity that is always the same": (
        lambda events: recorded(replace(events, p=np.ones_like(events.p)), "winter"),
        ["warning polarity: 100.0 1"],
    ),
    "inverted polarity": (lambda events: recorded(replace(events, p=~events.p), "winter"), ["warning polarity: 0."]),
    "positions of another unit": (
        lambda events: recorded(events, "winter", unit=1000),
        ["error clocks: 0.0 0.1 0.0 60.0 0"],
    ),
    "positions of another second": (
        lambda events: recorded(events, "winter", late_us=4 * SECOND),
        ["warning clocks: 4.0"],
    ),
    "positions that are not in order": (
        lambda events: replace(recorded(events, "winter"), positions_us=np.zeros(PLACES, np.int64)),
        ["error clocks:"],
    ),
}


@pytest.mark.parametrize("damage", FOUND)
def test_the_doctor_finds_in_a_recording(damage, tmp_path):
    winter, summer = healthy(tmp_path)
    spoil, expected = FOUND[damage]
    recordings = spoil(drive(1)), recorded(drive(2), "summer")
    found = coded(examine(replace(dataset_of([winter], summer), recordings=recordings)), tmp_path)
    told = [code for code in found if not code.startswith("note alignment")]
    assert [code[: len(start)] for code, start in zip(told, expected, strict=True)] == expected
