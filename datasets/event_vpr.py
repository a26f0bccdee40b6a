"""Brisbane-Event-VPR and QCR-Event-VPR as they are published: drives by name, and where the camera was."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
from scipy.spatial import KDTree

from vprbench.api import BadInput, MissingData

from .event_folders import EventFolders
from .readers.coordinates import Metres
from .readers.event_files import READERS, events_in
from .readers.file_dataset import GroundTruth, Unmatched, each_a_place
from .readers.frame_folders import root_folder
from .readers.recipes import function_of
from .readers.tracks import Track, nmea_track


@dataclass(frozen=True)
class _Published(EventFolders):
    """Drives that are called by name, whose files lie anywhere below `root` under their published names."""

    root: str | None = None
    ground_truth: Literal["index", "gps"] = "gps"

    drives: ClassVar[Mapping[str, tuple[Any, ...]]]  # first of what its date is in the names of its files

    def _file(self, name: str) -> Path:
        if name not in self.drives:
            raise BadInput(f"{self.name} has no drive {name}: there are {', '.join(self.drives)}")
        return self._found(name, *(f"*{self.drives[name][0]}*{suffix}" for suffix in READERS))

    def _found(self, name: str, *patterns: str) -> Path:
        """Return the first file by name that fits a pattern; raises MissingData without any."""
        layout = f"run python -m vprbench fetch {self.name}, or set dataset.root"
        root = root_folder(self.name, self.root, "its recordings", layout)
        files = sorted(chain.from_iterable(root.rglob(pattern) for pattern in patterns))
        if not files:
            raise MissingData(f"{root} holds no file of {name} ({' or '.join(patterns)}): {layout}")
        return files[0]


@dataclass(frozen=True)
class BrisbaneEventVPR(_Published):
    """Drives of Brisbane-Event-VPR (Fischer and Milford, RA-L 2020), right within 70 m by the GPS log of each.

    Below `root` lie `*<date>*` (HDF5 or parquet) and `*<name>*.nmea`. Options besides are those of `EventFolders`.
    Raises MissingData for files that are missing, BadInput for unknown drives.
    """

    name: str = "brisbane_event_vpr"
    references: list[str] | None = field(default_factory=lambda: ["sunset2"])
    queries: str | None = "sunset1"
    radius_metres: float = 70.0
    unmatched: Unmatched = "drop"

    # When the GPS log begins on the clock of the events, seconds since 1970: `video_beginning` of
    # github.com/Tobias-Fischer/ensemble-event-vpr.
    drives: ClassVar[Mapping[str, tuple[Any, ...]]] = {
        "sunset1": ("2020-04-21-17-03-03", 1587452582.35),
        "sunset2": ("2020-04-22-17-24-21", 1587540271.65),
        "daytime": ("2020-04-24-15-12-03", 1587705130.80),
        "night": ("2020-04-27-18-13-29", 1587975221.10),
        "morning": ("2020-04-28-09-14-11", 1588029265.73),
        "sunrise": ("2020-04-29-06-20-23", 1588105232.91),
    }

    def _track(self, name: str, file: Path) -> Track:
        stamp, begin_s = self.drives[name]
        return nmea_track(self._found(name, f"*{name}*.nmea", f"*{stamp}*.nmea"), begin_s)


@dataclass(frozen=True)
class QCREventVPR(_Published):
    """Drives of a robot in QCR-Event-VPR (Fischer and Milford, RA-L 2022), right within 2 % of the way.

    Below `root` lie `*<date>*` (HDF5 or parquet). A drive passes the same 11 points at times that are known; between
    them its speed is even. The way is measured in per cent of the time that the first reference takes. Options besides
    are those of `EventFolders`. Raises MissingData for files that are missing, BadInput for unknown drives.
    """

    name: str = "qcr_event_vpr"
    references: list[str] | None = field(default_factory=lambda: ["normal1"])
    queries: str | None = "normal2"
    radius_percent: float = 2.0
    unmatched: Unmatched = "drop"

    # Seconds after the first event at which the way begins, and seconds from there to each point of it:
    # `qcr_traverses_first_times` and `gt_times` of github.com/Tobias-Fischer/sparse-event-vpr.
    drives: ClassVar[Mapping[str, tuple[Any, ...]]] = {
        "normal1": ("2021-08-19-08-25-42", 2.0, (0, 6, 13, 31, 58, 77, 101.5, 124, 148, 157.7, 163)),
        "normal2": ("2021-08-19-08-28-43", 0.0, (0, 6, 13, 31.5, 58, 76, 100.5, 123, 148.5, 156.5, 162)),
        "normal3": ("2021-08-19-09-45-28", 2.0, (0, 6.5, 13.5, 31.5, 58.5, 77.5, 102.5, 126, 150, 158.5, 165)),
        "normal4": ("2022-03-28-11-51-26", 8.0, (0, 6.7, 13.2, 31, 57, 74, 97, 119, 141, 148, 154)),
        "fast1": ("2022-03-28-12-01-42", 7.7, (0, 2.9, 5.8, 12.9, 23.5, 32, 41.5, 50, 59.3, 62, 64.5)),
        "fast2": ("2021-08-20-10-19-45", 0.0, (0, 2.5, 5, 12.7, 23.7, 33.6, 43, 52.4, 62.3, 65.4, 68)),
        "slow1": ("2022-03-28-12-03-44", 12.0, (0, 15.5, 30, 63.5, 110, 141, 185, 217, 246.5, 256, 263)),
    }

    def _track(self, name: str, file: Path) -> Track:
        _, begin_s, passed = self.drives[name]
        *_, way = self.drives[(self.references or [name])[0]]
        first_us = next(int(chunk.t[0]) for chunk in events_in(file) if len(chunk.t))
        percent = 100 * np.array(way)[:, None] / way[-1]
        return first_us + np.round((begin_s + np.array(passed)) * 1e6).astype(np.int64), percent

    def _truth_by_position(self, references: Metres, queries: Metres) -> tuple[GroundTruth, dict[str, Any]]:
        near_ones = KDTree(references).query_ball_point(queries, self.radius_percent + 1e-9, return_sorted=True)
        told = f"no reference within {self.radius_percent:g} % of the way"
        return each_a_place(len(references), near_ones, told), {"radius_percent": self.radius_percent}


brisbane_event_vpr = function_of(BrisbaneEventVPR)
qcr_event_vpr = function_of(QCREventVPR)
