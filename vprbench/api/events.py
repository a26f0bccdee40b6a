"""Event streams: chunks of events, counted into frames in bounded memory, and the frames of a recording as images."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from vprbench import progress
from vprbench.api.compiling import compiled
from vprbench.api.decoding import as_rgb
from vprbench.api.images import Images
from vprbench.errors import BadInput
from vprbench.storage.atomic import name_unfinished, remove_leftovers
from vprbench.storage.folders import cache_folder

_FORMAT = 1  # of the files that keep frames
_FOLDER = "VPRBENCH_EVENTS"  # environment variable
_LATE_US = 10_000  # sensors send packets whose events are not all in order
_LONGEST_GAP_US = 600_000_000  # a longer one is another clock
_NEVER = np.iinfo(np.int64).max
_AROUND = 5  # pixels to a side

Micros = npt.NDArray[np.int64]  # (n,), microseconds


@dataclass(frozen=True)
class Events:
    """Consecutive events of an event camera."""

    t: Micros  # (n,), ascending
    x: npt.NDArray[np.uint16]  # (n,), columns
    y: npt.NDArray[np.uint16]  # (n,), rows
    p: npt.NDArray[np.bool_]  # (n,), true: it became brighter


@dataclass(frozen=True)
class Recording:
    """One traverse of an event camera; `events` reads it from its first event on, as often as wanted."""

    name: str
    events: Callable[[], Iterator[Events]]
    height: int
    width: int
    positions_us: Micros | None = None  # when positions were measured, on the clock that the events should have
    positions_metres: npt.NDArray[np.float64] | None = None  # (n, 2) or (n, 3), where the camera was then
    middle_us: Micros | None = None  # of the frames that the dataset takes from it, in their order


class Counted(NamedTuple):
    """A frame of counts."""

    counts: npt.NDArray[np.uint32]  # (height, width)
    first_us: int
    last_us: int  # of a window its end, else the last event


def count_events(
    chunks: Iterable[Events], height: int, width: int, *, window_us: int | None = None, per_frame: int | None = None
) -> Iterator[Counted]:
    """Yield one frame for each `window_us` microseconds from the first event on, or for each `per_frame` events.

    Events of both polarities count alike; what is left for the last frame is dropped. A thread reads the next chunk
    while one is counted, and no more are held. An event may come 10 ms late. Raises BadInput for a time that runs back
    further, for ten minutes without events, and for events outside the sensor.
    """
    if (window_us is None) == (per_frame is None) or (window_us or per_frame or 0) < 1:
        raise BadInput(f"window_us={window_us}, per_frame={per_frame}: give one of them, 1 or more")
    counts, held = np.zeros((height, width), np.uint32), 0
    first: int | None = None
    for chunk in _read_ahead(chunks):
        at, n = 0, len(chunk.t)
        while at < n:
            first = int(chunk.t[at]) if first is None else first
            stop = first + window_us if window_us else _NEVER
            most = per_frame - held if per_frame else n
            end = int(_count(chunk.t, chunk.x, chunk.y, at, first - _LATE_US, stop, most, counts))
            if end < 0 or (end < n and window_us and chunk.t[end] - stop > _LONGEST_GAP_US):
                t, x, y = (int(column[end if end >= 0 else -1 - end]) for column in (chunk.t, chunk.x, chunk.y))
                raise BadInput(
                    f"an event at {t} us, column {x}, row {y} fits neither a sensor of {width} x {height} nor the "
                    f"events before it, from {first} us on: give the sensor's size, or cut the recording there"
                )
            held, at = held + end - at, end
            if held == per_frame or (window_us and at < n):
                yield Counted(counts, first, stop if window_us else int(chunk.t[at - 1]))
                counts, held, first = np.zeros_like(counts), 0, stop if window_us else None


def _read_ahead(chunks: Iterable[Events]) -> Iterator[Events]:
    source = iter(chunks)
    with ThreadPoolExecutor(1) as reader:
        waiting = reader.submit(next, source, None)
        while (chunk := waiting.result()) is not None:
            waiting = reader.submit(next, source, None)
            yield chunk


@compiled()
def _count(t, x, y, at, earliest, stop, most, counts):  # type: ignore[no-untyped-def]
    """Count events from `at` on, at most `most`, before `stop`; return the next one, or -1 minus one that is wrong."""
    height, width = counts.shape
    end = min(len(t), at + most)
    for event in range(at, end):
        if t[event] >= stop:
            return event
        if t[event] < earliest or x[event] >= width or y[event] >= height:
            return -1 - event
        counts[y[event], x[event]] += 1
    return end


def hot_pixels(totals: npt.NDArray[Any], factor: float) -> npt.NDArray[np.bool_]:
    """Return which pixels sent more than `factor` times the median of the 5 x 5 around them, and than the mean.

    `totals` (height, width) are the events of each pixel in a whole recording.
    """
    from scipy.ndimage import median_filter

    around = median_filter(totals.astype(np.float64), _AROUND)
    return np.asarray(totals > factor * np.maximum(around, totals.mean()))


def event_frames(
    recording: Recording,
    what: Mapping[str, Any],
    hot_factor: float | None = None,
    *,
    window_us: int | None = None,
    per_frame: int | None = None,
) -> tuple[Images, Micros]:
    """Return the frames of a recording, `count_events`, and the middle of each in microseconds, (n,).

    Levels are counts, 255 stands for more; those of `hot_pixels` are 0. Frames are kept in VPRBENCH_EVENTS, or a folder
    in the user's cache, and counted again where `what` (plain JSON, all that decides about the events) differs. Raises
    what `count_events` does, and BadInput for a recording without a whole frame.
    """
    shape = (recording.height, recording.width)
    text = json.dumps([_FORMAT, dict(what), shape, window_us, per_frame], sort_keys=True)
    path = cache_folder(_FOLDER, "events") / f"{hashlib.sha256(text.encode()).hexdigest()}.frames"
    row = np.dtype([("middle_us", "<i8"), ("levels", "u1", shape)])
    if not path.is_file():
        progress.report(f"events of {recording.name} are counted", 0.0)
        _keep(path, count_events(recording.events(), *shape, window_us=window_us, per_frame=per_frame), row)
    n = (path.stat().st_size - 8 * recording.height * recording.width) // row.itemsize
    if not n:
        raise BadInput(f"{recording.name} holds no whole frame: ask for a shorter window or for fewer events a frame")
    middle = np.array(np.memmap(path, row, "r", shape=(n,))["middle_us"])
    totals = np.fromfile(path, "<i8", offset=n * row.itemsize).reshape(shape)
    hot = np.zeros(shape, np.bool_) if hot_factor is None else hot_pixels(totals, hot_factor)

    def grey(i: int) -> npt.NDArray[np.uint8]:
        levels = np.fromfile(path, row, 1, offset=i * row.itemsize)["levels"][0]
        levels[hot] = 0
        return np.asarray(levels)

    names = [f"{recording.name}/{i:06d}" for i in range(n)]
    return Images(lambda i: as_rgb(grey(i)), names, stamp=lambda i: hashlib.sha256(grey(i).tobytes()).digest()), middle


def _keep(path: Path, frames: Iterable[Counted], row: np.dtype[Any]) -> None:
    """Write a row for each frame, then the events of each pixel, int64 (height, width)."""
    path.parent.mkdir(parents=True, exist_ok=True)
    remove_leftovers(path.parent)
    partial, totals = name_unfinished(path.parent), np.zeros(row["levels"].shape, np.int64)
    try:
        with partial.open("wb") as file:
            for frame in frames:
                levels = np.minimum(frame.counts, 255)
                file.write(np.array(((frame.first_us + frame.last_us) // 2, levels), row).tobytes())
                totals += frame.counts
            file.write(totals.astype("<i8").tobytes())
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)
