"""Jobs of a batch system by dask-jobqueue: a yaml names its class and the keyword arguments of that class."""

from __future__ import annotations

import pkgutil
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vprbench.errors import BadInput
from vprbench.plugins.entries import entries, read
from vprbench.text import near

if TYPE_CHECKING:
    from distributed.deploy.cluster import Cluster


def read_arguments(given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the `_target_` and arguments of the yaml that `name` names, with the values that replace its own.

    The yaml stands in conf/cluster, or anywhere by its path. Raises BadInput if there is none.
    """
    known = {name: entry.path for name, entry in entries("cluster").items()}
    name = str(given.get("name") or "")
    path = Path(name).expanduser() if name.endswith(".yaml") else known.get(name)
    if path is None or not path.is_file():
        raise BadInput(f"cluster={name}: {near(name, known)}, or a yaml of your own, as in cluster=./ours.yaml")
    lists = {option: read(text) for option, text in given.items() if isinstance(text, str) and text.startswith("[")}
    values = {**read(path.read_text(encoding="utf-8")), **given, **lists}
    del values["name"]
    if type(values.get("cores")) is not int or not isinstance(values.get("_target_"), str):
        raise BadInput(f"cluster={name}: give a whole number of cores, and _target_, as dask_jobqueue.SLURMCluster")
    return values


def start_jobs(arguments: Mapping[str, Any], most: int) -> Cluster:
    """Return a cluster with one job submitted, and at most so many once more runs wait.

    Raises BadInput for an argument that the class does not know, and if the batch system takes no job.
    """
    from distributed.deploy.cluster import Cluster

    target = arguments["_target_"]
    try:
        kind = pkgutil.resolve_name(target)
        cluster = kind(**{name: value for name, value in arguments.items() if name != "_target_"})
    except (ImportError, AttributeError, TypeError, ValueError) as error:
        raise BadInput(f"cluster._target_={target}: {error}") from error

    async def submit() -> None:
        cluster.worker_spec.update(cluster.new_worker_spec())
        await cluster

    try:
        cluster.sync(submit)
    except (OSError, RuntimeError, ValueError) as error:  # the command that submits is not there, or refuses
        try:
            cluster.close()
        except AssertionError:  # of the job that did not begin, which leaves the rest open
            cluster.sync(Cluster._close, cluster)
        raise BadInput(f"cluster={target} takes no job: {str(error).strip().splitlines()[-1]}") from error
    cluster.adapt(minimum_jobs=0, maximum_jobs=most)
    started: Cluster = cluster
    return started
