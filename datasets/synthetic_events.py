"""Dataset `event_journey`: what an event camera sees of a rendered journey, simulated when looked at."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import groupby, pairwise
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from vprbench.api import BadInput, Dataset, Events, Image, Recording, compiled

from .readers.recipes import function_of
from .rendering.film import HEIGHT, WIDTH
from .rendering.journey import Rendered, World
from .street import Street
from .synthetic import Synthetic

#: Raise it whenever a change in this file changes an event: it is part of the protocol.
VERSION = 1

_WORLDS: dict[str, World] = {"synthetic": Synthetic.world, "street": Street.world}
_PIXELS = HEIGHT * WIDTH
_UNITS = 16  # of a painter, in a metre
_LUMA = np.array([0.299, 0.587, 0.114])
_DARK = 0.02  # of white, added to all light: one grey level in darkness is then no event
_HOT_HZ = 200.0  # events a second of a hot pixel
_RANGES: dict[str, tuple[float, float]] = {
    **{"metres": (0, 1000), "window_ms": (1, 1e6), "steps": (1, 1000), "threshold": (0.01, 10)},
    **{"threshold_spread": (0, 10), "refractory_us": (0, 1e9), "noise_hz": (0, 1e4)},
    **{"hot_pixels": (0, _PIXELS), "grey_per_event": (1, 255)},
}


@dataclass(frozen=True)
class EventJourney(Rendered):
    """Traverses of a rendered journey as events counted at each place; the options besides are those of `Rendered`.

    At each place the camera goes `metres` ahead within `window_ms`, in rendered `steps`; the way to the next place is
    left out. Between two renderings the logarithm of the light changes linearly; a pixel sends an event whenever it has
    changed by the pixel's threshold since the last one (ESIM: Rebecq et al., CoRL 2018), unless that is less than
    `refractory_us` ago. Thresholds are normal around `threshold` with the standard deviation `threshold_spread` over
    pixels and polarities. Noise is `noise_hz` events a second from every pixel, and many from so many `hot_pixels`. A
    frame shows `grey_per_event` grey values an event, up to 255. Raises BadInput for what cannot be simulated.
    """

    name: str = "event_journey"
    places: int = 300
    references: Sequence[str] = ("spring", "fall")
    query: str = "summer"
    journey: Literal["synthetic", "street"] = "synthetic"
    metres: float = 8.0
    window_ms: float = 500.0
    steps: int = 4
    threshold: float = 0.2
    threshold_spread: float = 0.03
    refractory_us: int = 100
    noise_hz: float = 0.1
    hot_pixels: int = 0
    grey_per_event: int = 8

    def build(self) -> Dataset:
        """Return the dataset of these options, with the recordings that its frames are counted from."""
        dataset = super().build()
        names = (name.split("/place-") for name in (*dataset.references.names, *dataset.queries.names))
        shown = groupby(names, key=lambda name: name[0])
        recordings = [self.recording(traverse, [int(place) for _, place in places]) for traverse, places in shown]
        return replace(dataset, recordings=tuple(recordings))

    def recording(self, traverse: str, places: Sequence[int]) -> Recording:
        """Return the recording of some places of a traverse, one after the other, simulated whenever it is read."""
        camera = EventCamera(self)
        starts = np.arange(len(places)) * camera.window_us

        def events() -> Iterator[Events]:
            return (camera.events(traverse, place, at) for place, at in zip(places, starts.tolist(), strict=True))

        return Recording(traverse, events, HEIGHT, WIDTH, middle_us=starts + camera.window_us // 2)

    def _world(self) -> World:
        return replace(_WORLDS[self.journey], painter=lambda _: EventCamera(self))

    def _painted(self) -> dict[str, Any]:
        sensor = {option: getattr(self, option) for option in ("journey", *_RANGES)}
        return {**super()._painted(), **sensor, "simulator": VERSION}

    def _check(self) -> None:
        if self.journey not in _WORLDS:
            raise BadInput(f"dataset.journey={self.journey}: choose {' or '.join(_WORLDS)}")
        for option, (least, most) in _RANGES.items():
            if not least <= getattr(self, option) <= most:
                raise BadInput(f"dataset.{option}={getattr(self, option)}: give {least} to {most}")
        super()._check()


class EventCamera:
    """Sees places of a journey as events; keeps nothing between places, so threads may share it."""

    def __init__(self, options: EventJourney) -> None:
        """Draw the threshold of every pixel, and which pixels are hot, from the seed."""
        self._options = options
        self._world = _WORLDS[options.journey]
        self._painter = self._world.painter(options.seed)
        self.window_us = round(1000 * options.window_ms)
        chance = np.random.default_rng(options.seed)
        drawn = chance.normal(options.threshold, options.threshold_spread, (2, _PIXELS))
        self._thresholds = np.maximum(drawn, _RANGES["threshold"][0])  # of falling and of rising light
        self._hot = chance.choice(_PIXELS, options.hot_pixels, replace=False)

    def render(self, traverse: str, place: int, ahead: int = 0) -> Image:
        """Return the counts of a place as grey values, uint8 (HEIGHT, WIDTH, 3)."""
        seen = self.events(traverse, place, ahead=ahead)
        counts = np.bincount(seen.y.astype(np.int64) * WIDTH + seen.x, minlength=_PIXELS)
        grey = np.minimum(counts * self._options.grey_per_event, 255).astype(np.uint8)
        return np.repeat(grey.reshape(HEIGHT, WIDTH, 1), 3, axis=2)

    def events(self, traverse: str, place: int, start_us: int = 0, ahead: int = 0) -> Events:
        """Return the events of a place in the order of their times, which begin at `start_us`."""
        parts = [self._noise(traverse, place), *self._signal(traverse, place, ahead)]
        t, pixel, rising = (np.concatenate(column) for column in zip(*parts, strict=True))
        order = np.argsort(t, kind="stable")
        y, x = np.divmod(pixel[order].astype(np.uint16), np.uint16(WIDTH))
        return Events(t[order] + start_us, x, y, rising[order])

    def _noise(self, traverse: str, place: int) -> tuple[npt.NDArray[Any], ...]:
        seconds = self.window_us / 1e6
        chance = np.random.default_rng([self._options.seed, self._world.known.index(traverse), place])
        anywhere = chance.integers(_PIXELS, size=chance.poisson(self._options.noise_hz * _PIXELS * seconds))
        pixel = np.append(anywhere, np.repeat(self._hot, chance.poisson(_HOT_HZ * seconds, len(self._hot))))
        return chance.integers(self.window_us, size=len(pixel)), pixel, chance.random(len(pixel)) < 0.5

    def _signal(self, traverse: str, place: int, ahead: int) -> Iterator[tuple[npt.NDArray[Any], ...]]:
        """Yield times, pixels and polarities of the events between each two renderings."""
        times = np.linspace(0, self.window_us, self._options.steps + 1)
        along = ahead + np.rint(np.linspace(0, _UNITS * self._options.metres, len(times))).astype(np.int64)
        frames = [self._painter.render(traverse, place, distance) for distance in along.tolist()]
        light = [np.log(frame.reshape(_PIXELS, 3) @ _LUMA / 255 + _DARK) for frame in frames]
        level, last = light[0].copy(), np.full(_PIXELS, -np.inf)
        for span, (before, after) in zip(pairwise(times), pairwise(light), strict=True):
            most = int((np.abs(after - level) / self._thresholds.min(0)).sum()) + 1
            found = np.empty(most, np.int64), np.empty(most, np.int64), np.empty(most, np.bool_)
            number = _cross(before, after, self._thresholds, level, last, span, self._options.refractory_us, *found)
            yield tuple(column[:number] for column in found)


@compiled()
def _cross(before, after, thresholds, level, last, span, refractory, t, pixel, rising):  # type: ignore[no-untyped-def]
    """Write the events between two renderings and return their number; `level` is that of each pixel's last one."""
    found = 0
    for i in range(len(before)):
        up = after[i] > before[i]
        step = thresholds[1, i] if up else -thresholds[0, i]
        while (after[i] - level[i]) / step >= 1 and after[i] != before[i]:
            level[i] += step
            at = span[0] + (span[1] - span[0]) * (level[i] - before[i]) / (after[i] - before[i])
            if at - last[i] >= refractory:
                last[i] = at
                t[found], pixel[found], rising[found] = int(np.ceil(at)) - 1, i, up
                found += 1
    return found


def write_recording(path: Path, recording: Recording) -> None:
    """Write a recording as HDF5: `events/t` in microseconds, `events/x`, `events/y` and `events/p`."""
    import h5py

    with h5py.File(path, "w") as file:
        group = file.create_group("events")
        group.attrs.update(height=recording.height, width=recording.width)
        for name, kind in (("t", np.int64), ("x", np.uint16), ("y", np.uint16), ("p", np.uint8)):
            group.create_dataset(name, (0,), kind, maxshape=(None,), chunks=(1 << 16,))
        for events in recording.events():
            for name, column in group.items():
                column.resize(len(column) + len(events.t), axis=0)
                column[len(column) - len(events.t) :] = getattr(events, name)


event_journey = function_of(EventJourney)
