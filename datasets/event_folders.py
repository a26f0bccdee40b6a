"""Your own recordings of event cameras: a file a traverse, frames by count, places by number or by position."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

from vprbench.api import BadInput, Dataset, Images, MissingData, Recording, event_frames

from .folders import match_indices
from .readers.drives import check_by_order
from .readers.event_files import read_events
from .readers.file_dataset import GroundTruth, Unmatched, dataset_of_files, unknown
from .readers.positions import Metres, match_metres
from .readers.tracks import Track, read_track


def event_folders(
    name: str = "event_folders",
    references: list[str] | None = None,
    queries: str | None = None,
    window_ms: float = 1000.0,
    events_per_frame: int | None = None,
    hot_factor: float | None = 10.0,
    height: int = 260,
    width: int = 346,
    ground_truth: Literal["index", "gps", "none"] = "index",
    tolerance: int = 0,
    radius_metres: float = 25.0,
    unmatched: Unmatched = "error",
) -> Dataset:
    """Return recordings of event cameras, one a traverse; frames count the events of a window, or equal numbers.

    With `index` the i-th frame of every recording shows place i, and right are places at most `tolerance` away. With
    `gps` a table beside each recording, of its name and .csv, or a GPS log, .nmea, says where the camera was; every
    reference frame is a place, right is what lies within `radius_metres`, and frames of other times are left out.
    With `none` every reference frame is a place, and no answer is judged.
    Pixels with more than `hot_factor` times the events of those around them count nothing. Raises
    MissingData, BadInput.
    """
    if not references or queries is None:
        raise MissingData(
            "dataset.references and dataset.queries are not set: "
            "pass dataset.references=[/path/to/first.h5] dataset.queries=/path/to/queries.h5"
        )
    files = [Path(file).expanduser() for file in (*references, queries)]
    for file in files:
        if not file.is_file():
            raise MissingData(f"{file} is no file: dataset.references and dataset.queries name a recording each")
    counting = Counting(window_ms, events_per_frame, hot_factor, height, width)
    drives = [counting.read_drive(file, read_track(file) if ground_truth == "gps" else None) for file in files]
    *mapped, queried = drives
    chosen: dict[str, Any] = {"ground_truth": ground_truth}
    if ground_truth == "gps":
        truth = match_metres(np.concatenate([drive.at for drive in mapped]), queried.at, radius_metres)
        chosen["radius_metres"] = radius_metres
    elif ground_truth == "none":
        truth = unknown(sum(len(drive.images) for drive in mapped), len(queried.images))
    else:
        truth = _match_frames([drive.images for drive in drives], references, tolerance)
        chosen["tolerance_places"] = tolerance
    return counting.make_dataset(name, drives, truth, unmatched, chosen)


@dataclass(frozen=True)
class Drive:
    """A recording, its frames and where each was taken."""

    file: Path
    recording: Recording
    images: Images
    at: Metres  # (n, d); without a track (0, 3)


@dataclass(frozen=True)
class Counting:
    """How frames are made of events, by a camera of so many pixels."""

    window_ms: float
    events_per_frame: int | None
    hot_factor: float | None
    height: int
    width: int

    def describe(self) -> dict[str, int]:
        """Return the window in microseconds, or the number of events of a frame."""
        if self.events_per_frame is None:
            return {"window_us": round(1000 * self.window_ms)}
        return {"per_frame": self.events_per_frame}

    def read_drive(self, file: Path, track: Track | None) -> Drive:
        """Count the frames of a recording; with a track, those of the times that it covers."""
        recording, state = Recording(file.stem, partial(read_events, file), self.height, self.width), file.stat()
        what = {"file": str(file.resolve()), "bytes": state.st_size, "changed_ns": state.st_mtime_ns}
        images, middle = event_frames(recording, what, self.hot_factor, **self.describe())
        if track is None:
            return Drive(file, replace(recording, middle_us=middle), images, np.empty((0, 3)))
        at_us, metres = track
        known = np.flatnonzero((middle >= at_us[0]) & (middle <= at_us[-1]))
        if not len(known):
            spans = [f"{times[0] / 1e6:.1f} to {times[-1] / 1e6:.1f} s" for times in (at_us, middle)]
            raise BadInput(
                f"the positions of {file.name} run from {spans[0]}, and its frames from {spans[1]}: bring both to one "
                "clock"
            )
        middle = middle[known]
        at = np.stack([np.interp(middle, at_us, axis) for axis in metres.T], axis=1)
        whole = replace(recording, positions_us=at_us, positions_metres=metres, middle_us=middle)
        return Drive(file, whole, images[known], at)

    def make_dataset(
        self, name: str, drives: Sequence[Drive], truth: GroundTruth, unmatched: Unmatched, chosen: Mapping[str, Any]
    ) -> Dataset:
        """Return the dataset of these drives, the last of which is queried; `chosen` belongs to the protocol."""
        *references, queries = drives
        protocol = {
            "protocol": "event_folders",
            "references": [drive.file.name for drive in references],
            "queries": queries.file.name,
            "hot_factor": self.hot_factor,
            **self.describe(),
            **chosen,
        }
        mapped = _join_images([drive.images for drive in references])
        dataset = dataset_of_files(name, mapped, queries.images, truth, protocol, unmatched=unmatched)
        return replace(dataset, recordings=tuple(drive.recording for drive in drives))


def _match_frames(shown: Sequence[Images], names: list[str], tolerance: int) -> GroundTruth:
    """Return the ground truth of frames that show the same place under the same number; a note where counts differ."""
    check_by_order(shown[:-1], names, "none", "dataset.", "leave one out, or give ground_truth=gps")
    n_places, n_queries = len(shown[0]), len(shown[-1])
    truth = match_indices(len(names), n_places, n_queries, tolerance)
    if n_queries == n_places:
        return truth
    note = (
        f"the query recording has {n_queries} frames, each reference {n_places}: with ground_truth=index frame i of "
        "both shows place i, so the camera has to pass every place at the same time; else give ground_truth=gps"
    )
    return replace(truth, notes=(*truth.notes, note))


def _join_images(parts: Sequence[Images]) -> Images:
    """Return the images of all parts, one part after the other."""
    views = [part[i : i + 1] for part in parts for i in range(len(part))]
    names = [view.names[0] for view in views]
    return Images(lambda i: views[i][0], names, stamp=lambda i: views[i].fingerprint().encode())
