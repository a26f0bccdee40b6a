"""Event streams: chunks of events, counted into frames in bounded memory, and the frames of a recording as images."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from vprbench import progress
from vprbench.api.arrays import Image
from vprbench.api.compiling import compiled
from vprbench.api.frame_cache import are_kept
from vprbench.api.images import Images
from vprbench.errors import BadInput
from vprbench.storage.atomic import remove_leftovers, replace_bytes, unfinished
from vprbench.storage.folders import cache_folder

FORMAT = 1  # of the files that keep counted frames
_FOLDER = "VPRBENCH_EVENTS"  # environment variable
_LATE_US = 10_000  # sensors send packets whose events are not all in order
_LONGEST_GAP_US = 600_000_000  # longer ones are another clock
_NEVER = np.iinfo(np.int64).max
_NEIGHBOURS = 5  # pixels to a side

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
    """One traverse of an event camera, and how to read it: as often as wanted, from the first event on."""

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


def counted(
    chunks: Iterable[Events],
    height: int,
    width: int,
    *,
    window_us: int | None = None,
    per_frame: int | None = None,
) -> Iterator[Counted]:
    """Yield one frame for each `window_us` microseconds from the first event on, or for each `per_frame` events.

    Events of both polarities count alike. What is left of the last frame is dropped. The next chunk is read by a thread
    while one is counted; no more than two are held. An event may come 10 ms late. Raises BadInput for a time that runs
    back further, for ten minutes without events, and for events outside the sensor.
    """
    if (window_us is None) == (per_frame is None) or (window_us or per_frame or 0) < 1:
        raise BadInput(f"window_us={window_us}, per_frame={per_frame}: give one of them, 1 or more")
    counts, held, first = np.zeros((height, width), np.uint32), 0, 0
    begun = False
    for chunk in _read_ahead(chunks):
        at = 0
        while at < len(chunk.t):
            if not begun:
                first, begun = int(chunk.t[at]), True
            stop = first + window_us if window_us else _NEVER
            most = per_frame - held if per_frame else len(chunk.t)
            end = int(_count(chunk.t, chunk.x, chunk.y, at, first - _LATE_US, stop, most, counts))
            if end < 0:
                raise _wrong(chunk, -1 - end, first, counts.shape)
            held, at = held + end - at, end
            if held == per_frame or (window_us and at < len(chunk.t)):
                if window_us and chunk.t[at] - stop > _LONGEST_GAP_US:
                    raise BadInput(f"after {stop} us no event came until {chunk.t[at]} us: cut the recording there")
                yield Counted(counts, first, stop if window_us else int(chunk.t[at - 1]))
                counts, held = np.zeros_like(counts), 0
                first, begun = stop, window_us is not None


def _wrong(chunk: Events, event: int, first: int, shape: tuple[int, ...]) -> BadInput:
    t, x, y = int(chunk.t[event]), int(chunk.x[event]), int(chunk.y[event])
    if t < first:
        return BadInput(f"time runs back from {first} to {t} us: sort or cut the recording there")
    return BadInput(f"an event at column {x}, row {y} lies outside the sensor, {shape[1]} x {shape[0]}: give its size")


def _read_ahead(chunks: Iterable[Events]) -> Iterator[Events]:
    source = iter(chunks)
    with ThreadPoolExecutor(1) as reader:
        waiting = reader.submit(next, source, None)
        while (chunk := waiting.result()) is not None:
            waiting = reader.submit(next, source, None)
            yield chunk


@compiled()
def _count(t, x, y, at, earliest, stop, most, counts):  # type: ignore[no-untyped-def]
    """Add events from `at` on, at most `most`, before `stop`; return the next one, or -1 minus one that is wrong."""
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

    around = median_filter(totals.astype(np.float64), _NEIGHBOURS)
    return np.asarray(totals > factor * np.maximum(around, totals.mean()))


class EventFrames(NamedTuple):
    """The frames of a recording."""

    images: Images  # grey, levels are counts, 255 stands for more
    middle_us: Micros  # (n,), when each was taken


def event_frames(
    recording: Recording,
    what: Mapping[str, Any],
    *,
    window_us: int | None = None,
    per_frame: int | None = None,
    hot_factor: float | None = None,
) -> EventFrames:
    """Return the frames of a recording, counted by `counted`; pixels that `hot_pixels` finds count nothing.

    Frames are kept in VPRBENCH_EVENTS, or a folder in the user's cache, and counted again if `what` (plain JSON, all
    that decides about the events) differs. Raises what `counted` does, and BadInput for a recording without a frame.
    """
    shape = (recording.height, recording.width)
    asked = {"format": FORMAT, "what": what, "shape": shape, "window_us": window_us, "per_frame": per_frame}
    scratch = None if are_kept() else TemporaryDirectory()  # goes with the images
    folder = Path(scratch.name) if scratch else cache_folder(_FOLDER, "events")
    path = folder / f"{hashlib.sha256(json.dumps(asked, sort_keys=True).encode()).hexdigest()}.frames"
    if not path.with_suffix(".npz").is_file():
        folder.mkdir(parents=True, exist_ok=True)
        remove_leftovers(folder)
        progress.report(f"events of {recording.name} are counted", 0.0)
        _write(path, counted(recording.events(), *shape, window_us=window_us, per_frame=per_frame), shape)
    with np.load(path.with_suffix(".npz")) as kept:
        middle, totals = kept["middle_us"], kept["totals"]
    if not len(middle):
        raise BadInput(f"{recording.name} holds no whole frame: ask for a shorter window or for fewer events a frame")
    hot = np.zeros(shape, np.bool_) if hot_factor is None else hot_pixels(totals, hot_factor)

    def grey(i: int) -> npt.NDArray[np.uint8]:
        assert scratch is None or scratch.name
        frame = np.fromfile(path, np.uint8, hot.size, offset=i * hot.size).reshape(shape)
        frame[hot] = 0
        return frame

    def read(i: int) -> Image:
        return np.repeat(grey(i)[:, :, None], 3, axis=2)

    names = [f"{recording.name}/{i:06d}" for i in range(len(middle))]
    return EventFrames(Images(read, names, stamp=lambda i: hashlib.sha256(grey(i)).digest()), middle)


def _write(path: Path, frames: Iterable[Counted], shape: tuple[int, int]) -> None:
    """Write the frames, then when they were taken, (n,), and the events of each pixel, (height, width)."""
    partial, middle, totals = unfinished(path.parent), [], np.zeros(shape, np.int64)
    try:
        with partial.open("wb") as file:
            for frame in frames:
                file.write(np.minimum(frame.counts, 255).astype(np.uint8).data)
                middle.append((frame.first_us + frame.last_us) // 2)
                totals += frame.counts
        partial.replace(path)
    finally:
        with suppress(OSError):
            partial.unlink()
    content = BytesIO()
    np.savez(content, middle_us=np.array(middle, np.int64), totals=totals)
    replace_bytes(path.with_suffix(".npz"), content.getvalue())
