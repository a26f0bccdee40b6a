"""Positions in file names `@UTM_east@UTM_north@...`, as VPR-datasets-downloader writes them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from vprbench.api import BadInput, Paths

from .file_dataset import GroundTruth
from .positions import MOST_METRES, Positions, WithoutPosition, by_positions


def by_names(
    references: Sequence[Path], queries: Sequence[Path], radius_metres: float, without: WithoutPosition = "error"
) -> GroundTruth:
    """Return the ground truth `by_positions` of file names; raises BadInput for a name without a position.

    Names without one are left out under `drop`. Metres of different UTM zones are compared as if they were of one.
    """
    map_positions, query_positions = (_read_names(Paths.of(files), without) for files in (references, queries))
    return by_positions([map_positions], query_positions, radius_metres, without)


def _read_names(files: Paths, without: WithoutPosition) -> Positions:
    """Return east and north of the names of files, NaN of a name that has none."""
    given = np.full((len(files), 2), np.nan)
    for number, name in enumerate(files.names):
        try:
            position = [float(part) for part in name.split("@", 3)[1:3]]
        except ValueError:
            position = []
        if len(position) == 2 and all(abs(metres) <= MOST_METRES for metres in position):
            given[number] = position
        elif without != "drop":
            raise BadInput(
                f"{files[number]} names no position: a name has to begin with @UTM_east@UTM_north@, metres from -1e8 "
                "to 1e8; or pass dataset.without_position=drop"
            )
    return Positions(files, given)
