"""The options that say where runs are made, shared by all commands that make several."""

from __future__ import annotations

import importlib.util
import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from vprbench.errors import BadInput
from vprbench.plugins.entries import find_entries, read
from vprbench.plugins.options import option
from vprbench.storage.cores import count_cores
from vprbench.text import suggest_names

logger = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class ClusterOptions:
    """Where runs are made: without any of these here, one after the other; raises BadInput for impossible values."""

    workers: int | None = option(None, "runs made side by side by processes of this machine; of cluster= the most jobs")
    scheduler: str | None = option(None, "address of a dask cluster, as tcp://host:8786: runs are made on it")
    cluster: dict[str, Any] = option({}, "slurm, pbs, lsf, sge or a yaml: runs are made in its jobs")

    def __post_init__(self) -> None:
        """Check that the options name one place, and that its libraries are there."""
        if self.workers is not None and self.workers < 1:
            raise BadInput(f"workers={self.workers}: give at least 1")
        if self.scheduler is not None and (self.cluster or self.workers is not None):
            raise BadInput(f"scheduler={self.scheduler} has workers of its own: leave workers= and cluster= out")
        for library in ["distributed"] * self.needs_dask + ["dask_jobqueue"] * bool(self.cluster):
            if importlib.util.find_spec(library) is None:
                raise BadInput(f"scheduler= and cluster= need {library}: pip install vprbench[cluster]")
        if self.cluster:
            self.job_arguments()

    @classmethod
    def has(cls, option: str) -> bool:
        """Tell whether `name=value` is an option of this class."""
        name = option.partition("=")[0]
        return name in cls.__dataclass_fields__ or name.startswith("cluster.")

    @property
    def is_distributed(self) -> bool:
        """Whether runs are made side by side."""
        return self.workers is not None or self.needs_dask

    @property
    def needs_dask(self) -> bool:
        """Whether runs are made on a dask cluster."""
        return self.scheduler is not None or bool(self.cluster)

    def job_arguments(self) -> dict[str, Any]:
        """Return the yaml of `cluster=`, with the values that replace its own.

        The yaml stands in conf/cluster, or anywhere by its path: the class of dask-jobqueue as `_target_`, and the
        arguments of that class. Raises BadInput if there is none.
        """
        given = dict(self.cluster)
        name = str(given.pop("name", ""))
        known = {known: entry.path for known, entry in find_entries("cluster").items()}
        path = Path(name).expanduser() if name.endswith(".yaml") else known.get(name)
        if path is None or not path.is_file():
            raise BadInput(
                f"cluster={name}: {suggest_names(name, known)}, or a yaml of your own, as in cluster=./ours.yaml"
            )
        values = {**read(path.read_text(encoding="utf-8")), **given}
        if type(values.get("cores")) is not int or not isinstance(values.get("_target_"), str):
            raise BadInput(f"cluster={name}: give a whole number of cores, and _target_, as dask_jobqueue.SLURMCluster")
        return values

    def threads(self, options: Sequence[str]) -> list[str]:
        """Return the option that gives each run its share of the cores, where runs are made side by side.

        None if the options of the runs say how many threads there are.
        """
        if not self.is_distributed or any(option.startswith("threads=") for option in options):
            return []
        here = max(1, count_cores() // self.workers) if self.workers else 1
        share = self.job_arguments()["cores"] if self.cluster else here
        logger.info("threads=%d: the threads of each cell, as none were asked for", share)
        return [f"threads={share}"]
