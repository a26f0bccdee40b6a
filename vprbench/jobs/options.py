"""The options that say where runs are made, shared by all commands that make several."""

from __future__ import annotations

import importlib.util
import logging
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from vprbench.errors import BadInput
from vprbench.jobs.batch import read_arguments
from vprbench.plugins.options import option
from vprbench.storage.cores import core_count

logger = logging.getLogger(__name__)

_MOST_JOBS = 16


@dataclass(frozen=True, kw_only=True)
class ClusterOptions:
    """Where runs are made, without any of these here and one after the other; raises BadInput for what cannot be."""

    workers: int | None = option(None, "runs made side by side by processes of this machine; of cluster= the most jobs")
    scheduler: str | None = option(None, "address of a dask cluster, as tcp://host:8786: runs are made on it")
    cluster: dict[str, Any] = option({}, "slurm, pbs, lsf, sge or a yaml: runs are made in its jobs")

    def __post_init__(self) -> None:
        """Check that one place is asked for, and that what it needs is there."""
        if self.workers is not None and self.workers < 1:
            raise BadInput(f"workers={self.workers}: give at least 1")
        if self.scheduler is not None and (self.cluster or self.workers is not None):
            raise BadInput(f"scheduler={self.scheduler} has workers of its own: leave workers= and cluster= out")
        for library in ("distributed", *(["dask_jobqueue"] if self.cluster else [])):
            if self.is_distributed and importlib.util.find_spec(library) is None:
                raise BadInput(
                    f"{library} is not installed, which makes runs side by side: pip install vprbench[cluster]"
                )
        if self.cluster:
            self.job_arguments()

    @classmethod
    def has(cls, option: str) -> bool:
        """Tell whether `name=value` is an option of this class."""
        name = option.partition("=")[0]
        return name in cls.__dataclass_fields__ or name.startswith("cluster.")

    @property
    def is_distributed(self) -> bool:
        """Whether runs are made in other processes, side by side."""
        return self.workers is not None or self.scheduler is not None or bool(self.cluster)

    @property
    def most_jobs(self) -> int:
        """How many jobs of a batch system there may be at a time."""
        return self.workers or _MOST_JOBS

    def job_arguments(self) -> dict[str, Any]:
        """Return the class of dask-jobqueue that makes the jobs, as `_target_`, and its arguments."""
        return read_arguments(self.cluster)

    def threads(self, options: Sequence[str]) -> list[str]:
        """Return the option that gives each run its share of the cores, where runs are made side by side.

        None if the options of the runs say how many threads there are.
        """
        if not self.is_distributed or any(option.startswith("threads=") for option in options):
            return []
        share = (
            self.job_arguments()["cores"]
            if self.cluster
            else max(1, core_count() // self.workers)
            if self.workers
            else 1
        )
        logger.info("threads=%d: the threads of each cell, as none were asked for", share)
        return [f"threads={share}"]
