"""Your own recordings of event cameras: a file a traverse, frames by count, places by number or by position."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt

from vprbench.api import BadInput, Dataset, Images, NotThere, Recording, event_frames

from .folders import by_index
from .readers.csv_tables import read_csv
from .readers.event_files import events_in
from .readers.file_dataset import Unmatched, dataset_of_files
from .readers.positions import Metres, by_radius, earth_centred
from .readers.recipes import function_of

Micros = npt.NDArray[np.int64]  # (n,)

_WANTED = "time (seconds on the clock of the events), lat and lon"


@dataclass(frozen=True)
class EventFolders:
    """Recordings of event cameras, one a traverse, as frames that count events: windows of time, or equal numbers.

    With `index` the i-th frame of every recording shows place i, and right are places at most `tolerance` away. With
    `gps` a table beside each recording, of its name and .csv, says when the camera was where; every reference frame is
    a place, right is what lies within `radius_metres`, and frames before the first or after the last position are left
    out. Pixels that send more than `hot_factor` times as much as those around them count nothing (null: all count).
    Raises NotThere for missing files, BadInput for others than these.
    """

    name: str = "event_folders"
    references: list[str] | None = None
    queries: str | None = None
    window_ms: float = 1000.0
    events_per_frame: int | None = None
    hot_factor: float | None = 10.0
    height: int = 260
    width: int = 346
    ground_truth: Literal["index", "gps"] = "index"
    tolerance: int = 0
    radius_metres: float = 25.0
    unmatched: Unmatched = "error"

    def build(self) -> Dataset:
        """Return the dataset of these options, after every recording was counted."""
        if not self.references or self.queries is None:
            raise NotThere(
                "dataset.references and dataset.queries are not set: "
                "pass dataset.references=[/path/to/first.h5] dataset.queries=/path/to/queries.h5"
            )
        files = [Path(file).expanduser() for file in (*self.references, self.queries)]
        by_position = self.ground_truth == "gps"
        tracks = [_Track.beside(file) if by_position else None for file in files]
        recordings = [
            Recording(file.stem, partial(events_in, file), self.height, self.width, track and track.micros)
            for file, track in zip(files, tracks, strict=True)
        ]
        frames = [self._frames(file, recording) for file, recording in zip(files, recordings, strict=True)]
        shown = [images for images, _ in frames]
        reach: dict[str, float] = {"tolerance_places": self.tolerance}
        if by_position:
            placed = [track.place(*part) for track, part in zip(tracks, frames, strict=True) if track]
            shown, reach = [images for images, _ in placed], {"radius_metres": self.radius_metres}
            truth = by_radius(np.concatenate([at for _, at in placed[:-1]]), placed[-1][1], self.radius_metres)
        else:
            truth = by_index(shown[:-1], self.references, len(shown[-1]), self.tolerance)
        protocol = {
            "protocol": "event_folders",
            "references": [file.name for file in files[:-1]],
            "queries": files[-1].name,
            **self._counting(),
            "hot_factor": self.hot_factor,
            "ground_truth": self.ground_truth,
            **reach,
        }
        dataset = dataset_of_files(self.name, _joined(shown[:-1]), shown[-1], truth, self.unmatched, protocol)
        return replace(dataset, recordings=tuple(recordings))

    def _counting(self) -> dict[str, int]:
        per_frame = self.events_per_frame
        return {"window_us": round(1000 * self.window_ms)} if per_frame is None else {"per_frame": per_frame}

    def _frames(self, file: Path, recording: Recording) -> tuple[Images, Micros]:
        if not file.is_file():
            raise NotThere(f"{file} is no file: dataset.references and dataset.queries name a recording each")
        state = file.stat()
        what = {"file": str(file.resolve()), "bytes": state.st_size, "changed_ns": state.st_mtime_ns}
        return event_frames(recording, what, self.hot_factor, **self._counting())


event_folders = function_of(EventFolders)


@dataclass(frozen=True)
class _Track:
    """Where a camera was, and when."""

    file: Path
    micros: Micros  # ascending
    metres: Metres  # (n, 3)

    @classmethod
    def beside(cls, recording: Path) -> _Track:
        """Read the table beside a recording; raises BadInput for another table, or without one."""
        file = recording.with_suffix(".csv")
        table = read_csv(file, _WANTED)
        try:
            time, lat, lon = (np.array(table.column(name), np.float64) for name in ("time", "lat", "lon"))
        except ValueError as error:
            raise BadInput(f"{file}: {error}; wanted are numbers: {_WANTED}") from error
        if not len(time) or not (np.diff(time) > 0).all() or not np.isfinite([time, lat, lon]).all():
            raise BadInput(f"{file}: wanted are times that ascend, and numbers alone: {_WANTED}")
        return cls(file, np.round(time * 1e6).astype(np.int64), earth_centred(lat, lon))

    def place(self, images: Images, middle_us: Micros) -> tuple[Images, Metres]:
        """Return the frames between the first and the last position, and where each was taken, (n, 3)."""
        known = np.flatnonzero((middle_us >= self.micros[0]) & (middle_us <= self.micros[-1]))
        if not len(known):
            raise BadInput(
                f"{self.file} holds positions from {self.micros[0] / 1e6:g} to {self.micros[-1] / 1e6:g} s, and the "
                f"frames run from {middle_us[0] / 1e6:g} to {middle_us[-1] / 1e6:g} s: give times on their clock"
            )
        at = [np.interp(middle_us[known], self.micros, axis) for axis in self.metres.T]
        return images[known], np.stack(at, axis=1)


def _joined(parts: Sequence[Images]) -> Images:
    """Return the images of all parts, one part after the other."""
    views = [part[i : i + 1] for part in parts for i in range(len(part))]
    names = [view.names[0] for view in views]
    return Images(lambda i: views[i][0], names, stamp=lambda i: views[i].fingerprint().encode())
