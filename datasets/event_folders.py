"""Your own recordings of event cameras: a file a traverse, frames by count, places by number or by position."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

from vprbench.api import BadInput, Dataset, Images, MissingData, Recording, event_frames

from .folders import by_index
from .readers.coordinates import Metres
from .readers.event_files import events_in
from .readers.file_dataset import GroundTruth, Unmatched, dataset_of_files, unknown
from .readers.positions import by_radius
from .readers.recipes import function_of
from .readers.tracks import Track, track_of


@dataclass(frozen=True)
class EventFolders:
    """Recordings of event cameras, one a traverse; frames count the events of a window, or equal numbers of events.

    With `index` the i-th frame of every recording shows place i, and right are places at most `tolerance` away. With
    `gps` a table beside each recording, of its name and .csv, or a GPS log, .nmea, says where the camera was; every
    reference frame is a place, right is what lies within `radius_metres`, and frames of other times are left out.
    With `none` every reference frame is a place, and no answer is judged.
    Pixels with more than `hot_factor` times the events of those around them count nothing. Raises
    MissingData, BadInput.
    """

    name: str = "event_folders"
    references: list[str] | None = None
    queries: str | None = None
    window_ms: float = 1000.0
    events_per_frame: int | None = None
    hot_factor: float | None = 10.0
    height: int = 260
    width: int = 346
    ground_truth: Literal["index", "gps", "none"] = "index"
    tolerance: int = 0
    radius_metres: float = 25.0
    unmatched: Unmatched = "error"

    def build(self) -> Dataset:
        """Return the dataset of these options, after every recording was counted."""
        if not self.references or self.queries is None:
            raise MissingData(
                "dataset.references and dataset.queries are not set: "
                "pass dataset.references=[/path/to/first.h5] dataset.queries=/path/to/queries.h5"
            )
        names = (*self.references, self.queries)
        files = [self._file(name) for name in names]
        recordings, shown, at = zip(*map(self._drive, names, files), strict=True)
        if self.ground_truth == "gps":
            truth, chosen = self._truth_by_position(np.concatenate(at[:-1]), at[-1])
        elif self.ground_truth == "none":
            truth, chosen = unknown(sum(map(len, shown[:-1])), len(shown[-1])), {}
        else:
            truth = _by_number(shown, self.references, self.tolerance)
            chosen = {"tolerance_places": self.tolerance}
        protocol = {
            "protocol": "event_folders",
            "references": [file.name for file in files[:-1]],
            "queries": files[-1].name,
            "hot_factor": self.hot_factor,
            "ground_truth": self.ground_truth,
            **self._counting(),
            **chosen,
        }
        dataset = dataset_of_files(self.name, _joined(shown[:-1]), shown[-1], truth, self.unmatched, protocol)
        return replace(dataset, recordings=recordings)

    def _counting(self) -> dict[str, int]:
        per_frame = self.events_per_frame
        return {"window_us": round(1000 * self.window_ms)} if per_frame is None else {"per_frame": per_frame}

    def _file(self, name: str) -> Path:
        """Return the file of a recording that the options name."""
        file = Path(name).expanduser()
        if not file.is_file():
            raise MissingData(f"{file} is no file: dataset.references and dataset.queries name a recording each")
        return file

    def _track(self, name: str, file: Path) -> Track:
        """Return where the camera of a recording was when; published recordings go by their names."""
        return track_of(file)

    def _truth_by_position(self, references: Metres, queries: Metres) -> tuple[GroundTruth, dict[str, Any]]:
        """Return which places are right, and what decided about it."""
        return by_radius(references, queries, self.radius_metres), {"radius_metres": self.radius_metres}

    def _drive(self, name: str, file: Path) -> tuple[Recording, Images, Metres]:
        """Return a recording, its frames, and where each was taken, (n, d); without a track (0, 3)."""
        recording, state = Recording(file.stem, partial(events_in, file), self.height, self.width), file.stat()
        what = {"file": str(file.resolve()), "bytes": state.st_size, "changed_ns": state.st_mtime_ns}
        track = self._track(name, file) if self.ground_truth == "gps" else None
        images, middle = event_frames(recording, what, self.hot_factor, **self._counting())
        if track is None:
            return replace(recording, middle_us=middle), images, np.empty((0, 3))
        at_us, metres = track
        known = np.flatnonzero((middle >= at_us[0]) & (middle <= at_us[-1]))
        if not len(known):
            spans = [f"{times[0] / 1e6:.1f} to {times[-1] / 1e6:.1f} s" for times in (at_us, middle)]
            told = f"the positions of {file.name} run from {spans[0]}, and its frames from {spans[1]}"
            raise BadInput(f"{told}: bring both to one clock")
        middle = middle[known]
        at = np.stack([np.interp(middle, at_us, axis) for axis in metres.T], axis=1)
        return replace(recording, positions_us=at_us, positions_metres=metres, middle_us=middle), images[known], at


event_folders = function_of(EventFolders)


def _by_number(shown: Sequence[Images], names: list[str], tolerance: int) -> GroundTruth:
    """Return the ground truth of frames that show the same place under the same number; a note where counts differ."""
    n_places, n_queries = len(shown[0]), len(shown[-1])
    truth = by_index(shown[:-1], names, n_queries, tolerance)
    if n_queries == n_places:
        return truth
    note = (
        f"the query recording has {n_queries} frames, each reference {n_places}: with ground_truth=index frame i of "
        "both shows place i, so the camera has to pass every place at the same time; else give ground_truth=gps"
    )
    return replace(truth, notes=(*truth.notes, note))


def _joined(parts: Sequence[Images]) -> Images:
    """Return the images of all parts, one part after the other."""
    views = [part[i : i + 1] for part in parts for i in range(len(part))]
    names = [view.names[0] for view in views]
    return Images(lambda i: views[i][0], names, stamp=lambda i: views[i].fingerprint().encode())
