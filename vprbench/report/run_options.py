"""The options of all that shows several runs: which of their numbers, from which stores, in which views."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from vprbench.errors import BadInput
from vprbench.jobs.options import ClusterOptions
from vprbench.plugins.options import option


@dataclass(frozen=True, kw_only=True)
class ShowOptions:
    """The stored runs that are shown, and their numbers; raises BadInput for impossible options."""

    metrics: list[str] = option([], "more quantities, as r100p, auc_roc, ap_c or energy")
    stores: list[str] = option([], "results folders of other machines, read too")
    name: str | None = option(None, "of the files that are written")
    sequence: Any = option(None)
    filter: Any = option(None)
    results: str = option("results")

    def __post_init__(self) -> None:
        """Check the options that need no plan, method or dataset."""
        from vprbench.runs.request import spell_out_metrics
        from vprbench.runs.sequences import parse_views

        parse_views(self.sequence, self.filter)
        if self.name is not None and re.fullmatch(r"\w[\w.-]*", self.name) is None:
            raise BadInput(f"name={self.name}: give letters, digits, '.', '_' and '-', for it names files")
        object.__setattr__(self, "metrics", spell_out_metrics(self.metrics))
        self._require_folders("stores", *self.stores)

    def _require_folders(self, name: str, *folders: str | None) -> None:
        for folder in folders:
            if folder is not None and not Path(folder).expanduser().is_dir():
                raise BadInput(f"{name}={folder} is no folder: give the one that holds the frames or the runs")


@dataclass(frozen=True, kw_only=True)
class FolderRequest(ShowOptions):
    """The runs of a results folder that figures and a page show."""

    dataset: list[str] = option([], "names of datasets; all without any")
    methods: list[str] = option([], "names of methods; all without any")


@dataclass(frozen=True, kw_only=True)
class RunOptions(ShowOptions, ClusterOptions):
    """The runs that are shown, and where those that are missing are made; raises BadInput for impossible options."""

    seeds: int | None = option(None, "at most so many a row")
    devices: list[str] | None = option(None, "null: cpu, and cuda where there is a GPU")
    stored: bool = option(False, "from the store alone: nothing is run")
    views: Any = option(None)
    wide: bool = option(False)

    def __post_init__(self) -> None:
        """Check the options that need no plan, method or dataset."""
        from vprbench.runs.viewpoints import parse_viewpoints

        super().__post_init__()
        ClusterOptions.__post_init__(self)
        parse_viewpoints(self.views)
        if self.seeds is not None and self.seeds < 1:
            raise BadInput(f"seeds={self.seeds}: give at least 1")
        for device in self.devices or ():
            if re.fullmatch(r"cpu|cuda(:\d+)?", device) is None:
                raise BadInput(f"devices={device} is unknown: give cpu, cuda or cuda:1")


@dataclass(frozen=True, kw_only=True)
class TableRequest(RunOptions):
    """Rows, columns and stores of a table; raises BadInput for impossible options."""

    #: Options of a run that a table does not take: rows, methods, columns, seeds and devices take their place.
    refused: ClassVar[tuple[str, ...]] = (
        *("method", "dataset", "corruption", "seed", "device", "output", "save", "load", "predictions"),
    )

    rows: list[str] | None = option(None, "of conf/paper/table2.yaml; null: all of its rows")
    methods: list[str] = option([], "more rows: names of methods, or of more_rows in conf/paper/table2.yaml")
    columns: list[str] | None = option(None, "null: the published datasets, or those that stand in for them")
    full: bool = option(False, "true: slow rows at full size too")
    figures: bool = option(False, "true: draw the figures too, and make the runs of Figure 2c, about 6 minutes")
    page: bool = option(False, "true: write the page too, with the figures in it")
    nordland: str | None = option(None, "folder of the real frames")
    robotcar: str | None = option(None, "folder of the real frames")

    def __post_init__(self) -> None:
        """Check the options that need no plan."""
        super().__post_init__()
        self._require_folders("nordland", self.nordland)
        self._require_folders("robotcar", self.robotcar)


@dataclass(frozen=True, kw_only=True)
class CompareRequest(RunOptions):
    """The methods of a comparison and its options; raises BadInput for impossible ones."""

    #: Options of a run that a comparison does not take.
    refused: ClassVar[tuple[str, ...]] = (*("method", "corruption", "seed", "output", "save", "load", "stream"),)

    methods: list[str] = option(meaning="names; NAME.option=value sets an option of one of them")
    seeds: int = option(1, "of each method that learns from a seed")
    corruptions: list[str] = option([], "of query frames: all, kinds, or as in shift-1")
    devices: list[str] = option(["cpu"], "or device=cuda, for one")
    predictions: int | None = option(None, "best places of each query in NAME-predictions.csv; null: 10, 0: no file")
    name: str | None = option(None, "of the files that are written, and the title; null: the dataset's")

    def __post_init__(self) -> None:
        """Check the options that need no method or dataset."""
        from vprbench.runs.corruption import parse_corruptions

        super().__post_init__()
        if not self.methods:
            raise BadInput("methods= is empty: name what is compared, as in methods=sad,hog")
        parse_corruptions(self.corruptions)
