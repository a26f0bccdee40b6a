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

_WANTED = "time (seconds on the clock of the events, ascending), lat and lon (degrees)"


@dataclass(frozen=True)
class EventFolders:
    """Recordings of event cameras, one a traverse; frames count the events of a window, or equal numbers of events.

    With `index` the i-th frame of every recording shows place i, and right are places at most `tolerance` away. With
    `gps` a table beside each recording, of its name and .csv, says where the camera was; every reference frame is a
    place, right is what lies within `radius_metres`, and frames outside the times of the table are left out. Pixels
    with more than `hot_factor` times the events of those around them count nothing. Raises NotThere, BadInput.
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
        drives = [self._drive(file) for file in files]
        shown, at = [images for _, images, _ in drives], [metres for _, _, metres in drives]
        reach: dict[str, float] = {"tolerance_places": self.tolerance}
        if self.ground_truth == "gps":
            truth, reach = (
                by_radius(np.concatenate(at[:-1]), at[-1], self.radius_metres),
                {"radius_metres": self.radius_metres},
            )
        else:
            truth = by_index(shown[:-1], self.references, len(shown[-1]), self.tolerance)
        protocol = {
            "protocol": "event_folders",
            "references": [file.name for file in files[:-1]],
            "queries": files[-1].name,
            "hot_factor": self.hot_factor,
            "ground_truth": self.ground_truth,
            **self._counting(),
            **reach,
        }
        dataset = dataset_of_files(self.name, _joined(shown[:-1]), shown[-1], truth, self.unmatched, protocol)
        return replace(dataset, recordings=tuple(recording for recording, _, _ in drives))

    def _counting(self) -> dict[str, int]:
        per_frame = self.events_per_frame
        return {"window_us": round(1000 * self.window_ms)} if per_frame is None else {"per_frame": per_frame}

    def _drive(self, file: Path) -> tuple[Recording, Images, Metres]:
        """Return a recording, its frames, and where each was taken, (n, 3); without a table (0, 3)."""
        if not file.is_file():
            raise NotThere(f"{file} is no file: dataset.references and dataset.queries name a recording each")
        recording, state = Recording(file.stem, partial(events_in, file), self.height, self.width), file.stat()
        what = {"file": str(file.resolve()), "bytes": state.st_size, "changed_ns": state.st_mtime_ns}
        if self.ground_truth == "gps":
            track = _track(file.with_suffix(".csv"))
        images, middle = event_frames(recording, what, self.hot_factor, **self._counting())
        if self.ground_truth != "gps":
            return replace(recording, middle_us=middle), images, np.empty((0, 3))
        at_us, metres = track
        known = np.flatnonzero((middle >= at_us[0]) & (middle <= at_us[-1]))
        if not len(known):
            spans = [f"{times[0] / 1e6:g} to {times[-1] / 1e6:g} s" for times in (at_us, middle)]
            raise BadInput(f"{file.stem}.csv runs from {spans[0]}, and the frames from {spans[1]}: {_WANTED}")
        middle = middle[known]
        at = np.stack([np.interp(middle, at_us, axis) for axis in metres.T], axis=1)
        return replace(recording, positions_us=at_us, positions_metres=metres, middle_us=middle), images[known], at


event_folders = function_of(EventFolders)


def _track(file: Path) -> tuple[npt.NDArray[np.int64], Metres]:
    """Return the times of a table, (n,), microseconds, and the positions, (n, 3)."""
    table = read_csv(file, _WANTED)
    try:
        time, lat, lon = (np.array(table.column(name), np.float64) for name in ("time", "lat", "lon"))
    except ValueError as error:
        raise BadInput(f"{file}: {error}; wanted are {_WANTED}") from error
    if not len(time) or not (np.diff(time) > 0).all() or not np.isfinite([time, lat, lon]).all():
        raise BadInput(f"{file} holds times that do not ascend, or no numbers; wanted are {_WANTED}")
    return np.round(time * 1e6).astype(np.int64), earth_centred(lat, lon)


def _joined(parts: Sequence[Images]) -> Images:
    """Return the images of all parts, one part after the other."""
    views = [part[i : i + 1] for part in parts for i in range(len(part))]
    names = [view.names[0] for view in views]
    return Images(lambda i: views[i][0], names, stamp=lambda i: views[i].fingerprint().encode())
