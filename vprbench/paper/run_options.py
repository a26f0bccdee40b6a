"""The options of all that shows several runs: which of their numbers, from which stores, in which views."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from vprbench.errors import BadInput
from vprbench.jobs.options import ClusterOptions
from vprbench.runs.request import spell_out_metrics
from vprbench.runs.sequences import views
from vprbench.runs.viewpoints import viewpoints


@dataclass(frozen=True, kw_only=True)
class RunOptions(ClusterOptions):
    """Which numbers of which runs are shown, and where they are made; raises BadInput for what cannot be."""

    metrics: list[str] = field(default_factory=list)  # more quantities, by their names in METRICS
    seeds: int | None = None  # at most so many a row
    devices: list[str] | None = None  # None: cpu, and cuda where there is a GPU
    stored: bool = False  # from the store alone: nothing is run
    stores: list[str] = field(default_factory=list)  # results folders of other machines, read too
    name: str | None = None  # of the files that are written
    sequence: Any = None  # 4, [1,4,10] or {length:4,window:centred}: answers of so many neighbouring queries
    filter: Any = None  # true or {back:0,ahead:2,ratio:5}: answers of a Bayes filter over the places
    views: Any = None  # shifts in widths of the frame: the viewpoints of each query
    wide: bool = False  # all columns, however wide the terminal is
    results: str = "results"

    def __post_init__(self) -> None:
        """Check what can be checked before a plan is read, or a method or dataset built."""
        super().__post_init__()
        views(self.sequence, self.filter)
        viewpoints(self.views)
        if self.seeds is not None and self.seeds < 1:
            raise BadInput(f"seeds={self.seeds}: give at least 1")
        if self.name is not None and re.fullmatch(r"\w[\w.-]*", self.name) is None:
            raise BadInput(f"name={self.name}: give letters, digits, '.', '_' and '-', for it names files")
        object.__setattr__(self, "metrics", spell_out_metrics(self.metrics))
        for device in self.devices or ():
            if re.fullmatch(r"cpu|cuda(:\d+)?", device) is None:
                raise BadInput(f"devices={device} is unknown: give cpu, cuda or cuda:1")
        self._require_folders("stores", *self.stores)

    def _require_folders(self, option: str, *folders: str | None) -> None:
        for folder in folders:
            if folder is not None and not Path(folder).expanduser().is_dir():
                raise BadInput(f"{option}={folder} is no folder: give the one that holds the frames or the runs")
