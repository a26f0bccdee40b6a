"""Brisbane-Event-VPR and QCR-Event-VPR as they are published: drives by name, and where the camera was."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import KDTree

from vprbench.api import BadInput, Dataset, MissingData

from .event_folders import Counting
from .readers.event_files import READERS, read_events
from .readers.file_dataset import Unmatched, make_ground_truth
from .readers.frame_folders import find_root
from .readers.positions import match_metres
from .readers.tracks import Track, read_nmea_track

#: Of each drive of Brisbane its date in the names of its files, and when the GPS log begins on the clock of the events,
#: seconds since 1970: `video_beginning` of github.com/Tobias-Fischer/ensemble-event-vpr.
_BRISBANE = {
    "sunset1": ("2020-04-21-17-03-03", 1587452582.35),
    "sunset2": ("2020-04-22-17-24-21", 1587540271.65),
    "daytime": ("2020-04-24-15-12-03", 1587705130.80),
    "night": ("2020-04-27-18-13-29", 1587975221.10),
    "morning": ("2020-04-28-09-14-11", 1588029265.73),
    "sunrise": ("2020-04-29-06-20-23", 1588105232.91),
}
#: Of each drive of QCR its date, the seconds after the first event at which the way begins, and the seconds from there
#: to each of 11 points: `qcr_traverses_first_times` and `gt_times` of github.com/Tobias-Fischer/sparse-event-vpr.
_QCR = {
    "normal1": ("2021-08-19-08-25-42", 2.0, (0, 6, 13, 31, 58, 77, 101.5, 124, 148, 157.7, 163)),
    "normal2": ("2021-08-19-08-28-43", 0.0, (0, 6, 13, 31.5, 58, 76, 100.5, 123, 148.5, 156.5, 162)),
    "normal3": ("2021-08-19-09-45-28", 2.0, (0, 6.5, 13.5, 31.5, 58.5, 77.5, 102.5, 126, 150, 158.5, 165)),
    "normal4": ("2022-03-28-11-51-26", 8.0, (0, 6.7, 13.2, 31, 57, 74, 97, 119, 141, 148, 154)),
    "fast1": ("2022-03-28-12-01-42", 7.7, (0, 2.9, 5.8, 12.9, 23.5, 32, 41.5, 50, 59.3, 62, 64.5)),
    "fast2": ("2021-08-20-10-19-45", 0.0, (0, 2.5, 5, 12.7, 23.7, 33.6, 43, 52.4, 62.3, 65.4, 68)),
    "slow1": ("2022-03-28-12-03-44", 12.0, (0, 15.5, 30, 63.5, 110, 141, 185, 217, 246.5, 256, 263)),
}


def brisbane_event_vpr(
    name: str = "brisbane_event_vpr",
    root: str | None = None,
    references: Sequence[str] = ("sunset2",),
    queries: str = "sunset1",
    window_ms: float = 1000.0,
    events_per_frame: int | None = None,
    hot_factor: float | None = 10.0,
    height: int = 260,
    width: int = 346,
    radius_metres: float = 70.0,
    unmatched: Unmatched = "drop",
) -> Dataset:
    """Return drives of Brisbane-Event-VPR (Fischer and Milford, RA-L 2020), right within 70 m by the GPS log of each.

    Below `root` lie `*<date>*` (HDF5 or parquet) and `*<name>*.nmea`. Frames are made as in `event_folders`. Raises
    MissingData for files that are missing, BadInput for unknown drives.
    """
    counting = Counting(window_ms, events_per_frame, hot_factor, height, width)
    drives = []
    for drive, file in _find_recordings(name, root, _BRISBANE, [*references, queries]):
        stamp, begin_s = _BRISBANE[drive]
        log = _find_file(name, root, drive, [f"*{drive}*.nmea", f"*{stamp}*.nmea"])
        drives.append(counting.read_drive(file, read_nmea_track(log, begin_s)))
    truth = match_metres(np.concatenate([drive.at for drive in drives[:-1]]), drives[-1].at, radius_metres)
    chosen = {"ground_truth": "gps", "radius_metres": radius_metres}
    return counting.make_dataset(name, drives, truth, unmatched, chosen)


def qcr_event_vpr(
    name: str = "qcr_event_vpr",
    root: str | None = None,
    references: Sequence[str] = ("normal1",),
    queries: str = "normal2",
    window_ms: float = 1000.0,
    events_per_frame: int | None = None,
    hot_factor: float | None = 10.0,
    height: int = 260,
    width: int = 346,
    radius_percent: float = 2.0,
    unmatched: Unmatched = "drop",
) -> Dataset:
    """Return drives of a robot in QCR-Event-VPR (Fischer and Milford, RA-L 2022), right within 2 % of the way.

    Below `root` lie `*<date>*` (HDF5 or parquet). A drive passes the same 11 points at times that are known; between
    them its speed is even. The way is measured in per cent of the time that the first reference takes. Frames are made
    as in `event_folders`. Raises MissingData for files that are missing, BadInput for unknown drives.
    """
    counting = Counting(window_ms, events_per_frame, hot_factor, height, width)
    found = _find_recordings(name, root, _QCR, [*references, queries])
    *_, way = _QCR[found[0][0]]
    percent = 100 * np.array(way)[:, None] / way[-1]

    def track_of(drive: str, file: Path) -> Track:
        _, begin_s, passed = _QCR[drive]
        first_us = next(int(chunk.t[0]) for chunk in read_events(file) if len(chunk.t))
        return first_us + np.round((begin_s + np.array(passed)) * 1e6).astype(np.int64), percent

    drives = [counting.read_drive(file, track_of(drive, file)) for drive, file in found]
    mapped = np.concatenate([drive.at for drive in drives[:-1]])
    near = KDTree(mapped).query_ball_point(drives[-1].at, radius_percent + 1e-9, return_sorted=True)
    truth = make_ground_truth(len(mapped), near, f"no reference within {radius_percent:g} % of the way")
    chosen = {"ground_truth": "gps", "radius_percent": radius_percent}
    return counting.make_dataset(name, drives, truth, unmatched, chosen)


def _find_recordings(
    name: str, root: str | None, known: Mapping[str, tuple[Any, ...]], drives: Sequence[str]
) -> list[tuple[str, Path]]:
    """Return each drive with its recording; raises BadInput for an unknown one."""
    for drive in drives:
        if drive not in known:
            raise BadInput(f"{name} has no drive {drive}: there are {', '.join(known)}")
    return [
        (drive, _find_file(name, root, drive, [f"*{known[drive][0]}*{suffix}" for suffix in READERS]))
        for drive in drives
    ]


def _find_file(name: str, root: str | None, drive: str, patterns: Sequence[str]) -> Path:
    """Return the first file by name, anywhere below the root, that fits a pattern; raises MissingData without any."""
    layout = f"run python -m vprbench fetch {name}, or set dataset.root"
    top = find_root(name, root, "its recordings", layout)
    files = sorted(chain.from_iterable(top.rglob(pattern) for pattern in patterns))
    if not files:
        raise MissingData(f"{top} holds no file of {drive} ({' or '.join(patterns)}): {layout}")
    return files[0]
