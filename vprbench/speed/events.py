"""The benchmark of event cameras: an hour of events read from HDF5 and counted into frames."""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import psutil

from vprbench import progress
from vprbench.plugins import registry
from vprbench.runs import machine
from vprbench.speed.frames import in_own_process
from vprbench.speed.report import Planned, figures, megabytes
from vprbench.speed.settings import Bench, Settings

_HEIGHT, _WIDTH = 260, 346  # of a DAVIS346
_SECONDS = 3600
_CHUNK = 1_000_000  # events, drawn once and written again and again, later each time


@dataclass(frozen=True)
class EventsCell:
    """A recording read as `dataset=event_folders` reads it, in a process of its own."""

    events: int
    frames: int
    file_bytes: int
    seconds: float
    memory_before_bytes: int  # resident, with all libraries
    peak_memory_bytes: int  # what was resident before included

    def row(self) -> dict[str, str]:
        """Return the size of the recording, the time and the memory."""
        return {
            "events": f"{self.events:,}",
            "frames": f"{self.frames:,}",
            "file MB": megabytes(self.file_bytes),
            "s": figures(self.seconds),
            "million events/s": figures(self.events / self.seconds / 1e6),
            "resident before MB": megabytes(self.memory_before_bytes),
            "peak MB": megabytes(self.peak_memory_bytes),
        }


def counting(bench: Bench) -> Iterator[Planned]:
    """Count recordings of growing numbers of events, an hour each."""
    for n_events in bench.settings.events:
        yield {"events": f"{n_events:,}"}, partial(_cells, bench.settings, n_events)


def _cells(settings: Settings, n_events: int) -> list[Any]:
    with tempfile.TemporaryDirectory(prefix="vprbench-") as folder:
        write(Path(folder) / "hour.h5", n_events, settings.seed)
        return [in_own_process(events_cell, Path(folder), n_events)]


def write(file: Path, n_events: int, seed: int) -> None:
    """Write events at random pixels, evenly over an hour, as HDF5: `events/t` in microseconds, x, y and p."""
    import h5py  # type: ignore[import-untyped, unused-ignore]

    drawn, n = np.random.default_rng(seed), min(_CHUNK, n_events)
    columns: dict[str, npt.NDArray[Any]] = {
        "t": np.sort(drawn.integers(_SECONDS * 1_000_000 * n // n_events, size=n)),
        "x": drawn.integers(_WIDTH, size=n, dtype=np.uint16),
        "y": drawn.integers(_HEIGHT, size=n, dtype=np.uint16),
        "p": drawn.integers(2, size=n, dtype=np.uint8),
    }
    with h5py.File(file, "w") as stored:
        kept = {key: stored.create_dataset(f"events/{key}", (n_events,), each.dtype) for key, each in columns.items()}
        for start in range(0, n_events, n):
            progress.report("writing events", start / n_events)
            later = {**columns, "t": columns["t"] + _SECONDS * 1_000_000 * start // n_events}
            for key, each in later.items():
                kept[key][start : start + n] = each[: n_events - start]


def events_cell(top: Path, n_events: int) -> EventsCell:
    """Read the recording in `top` into frames of a second, which are kept in `top`."""
    os.environ["VPRBENCH_EVENTS"] = str(top / "frames")
    file = top / "hour.h5"
    dataset = {
        "_target_": "vprbench.datasets.event_folders.event_folders",
        "references": [str(file)],
        "queries": str(file),  # counted once
        "height": _HEIGHT,
        "width": _WIDTH,
    }
    registry.located("dataset", dataset, "event_folders")  # with all that it imports
    machine.reset_peak_memory()
    before, started = psutil.Process().memory_info().rss, time.perf_counter()
    made = registry.make_dataset(dataset)
    seconds = time.perf_counter() - started
    peak = machine.peak_memory_bytes()
    return EventsCell(n_events, made.n_places, file.stat().st_size, seconds, before, peak)
