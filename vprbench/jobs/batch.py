"""Jobs of a batch system, as dask-jobqueue submits them: each holds one worker, which waits for one cell at a time."""

from __future__ import annotations

import os
import shlex
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_type_hints

from vprbench.errors import BadInput
from vprbench.plugins.entries import entries, read
from vprbench.plugins.values import check_value
from vprbench.storage.folders import checkout_folder
from vprbench.text import near

if TYPE_CHECKING:
    from dask_jobqueue.core import JobQueueCluster

System = Literal["slurm", "pbs", "lsf", "sge"]


@dataclass(frozen=True)
class Job:
    """One job, which makes one cell after the other, and how many there are."""

    system: System
    queue: str | None = None  # or partition
    account: str | None = None  # or project
    cores: int = 1
    memory: str = "8GB"
    walltime: str = "24:00:00"
    gpus: int = 0
    minimum: int = 0
    maximum: int = 16
    adaptive: bool = True  # as many jobs as there are cells, between minimum and maximum; false: maximum at once
    directives: list[str] = field(default_factory=list)  # more lines of the script's head
    prologue: list[str] = field(default_factory=list)  # commands before the worker starts
    interface: str | None = None  # network by which workers find this process, as ib0
    logs: str = "vprbench-jobs"  # folder for what jobs print


def job(given: Mapping[str, Any], workers: int | None) -> Job:
    """Return the job that `name`, in conf/cluster or a yaml elsewhere, asks for, and what replaces its values.

    Raises BadInput for what is not known.
    """
    known = {name: entry.path for name, entry in entries("cluster").items()}
    name = str(given.get("name") or "")
    path = Path(name).expanduser() if name.endswith(".yaml") else known.get(name)
    if path is None or not path.is_file():
        raise BadInput(f"cluster={name}: {near(name, known)}, or a yaml of your own, as in cluster=./ours.yaml")
    hints = get_type_hints(Job)
    values = {**read(path.read_text(encoding="utf-8")), **given}
    del values["name"]
    for option in values:
        if option not in hints:
            raise BadInput(f"option cluster.{option} is unknown: {near(option, hints)}")
    found = Job(**{option: check_value(f"cluster.{option}", value, hints[option]) for option, value in values.items()})
    return found if workers is None else replace(found, maximum=workers, minimum=min(found.minimum, workers))


def started(job: Job) -> JobQueueCluster:
    """Return a cluster whose jobs are submitted as there are cells; raises BadInput if the first is not taken."""
    import dask_jobqueue
    from distributed.deploy.cluster import Cluster

    cluster: JobQueueCluster = getattr(dask_jobqueue, f"{job.system.upper()}Cluster")(**_arguments(job))

    async def submitted() -> None:
        for _ in range(max(1, job.minimum) if job.adaptive else job.maximum):
            cluster.worker_spec.update(cluster.new_worker_spec())
        await cluster

    try:
        cluster.sync(submitted)
    except (OSError, RuntimeError, ValueError) as error:  # what submits jobs is not there, or refuses
        try:
            cluster.close()
        except AssertionError:  # of the jobs that could not be begun, which leaves the rest open
            cluster.sync(Cluster._close, cluster)
        raise BadInput(f"cluster={job.system} takes no job: {str(error).strip().splitlines()[-1]}") from error
    if job.adaptive:
        cluster.adapt(minimum_jobs=job.minimum, maximum_jobs=job.maximum)
    return cluster


def _arguments(job: Job) -> dict[str, Any]:
    """Return what dask-jobqueue is told, whose words differ from one batch system to the next."""
    account = "project" if job.system in ("lsf", "sge") else "account"
    ours = {name: value for name, value in os.environ.items() if name.startswith("VPRBENCH_")}
    ours["PYTHONPATH"] = os.pathsep.join(filter(None, [str(checkout_folder()), os.environ.get("PYTHONPATH")]))
    prologue = [f"cd {shlex.quote(str(Path.cwd()))}"]
    prologue += [f"export {name}={shlex.quote(value)}" for name, value in ours.items()]
    logs = Path(job.logs).expanduser().absolute()
    try:
        logs.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadInput(f"cluster.logs={job.logs} cannot be made ({error.strerror})") from error
    return {
        "cores": job.cores,
        "processes": 1,
        "memory": f"{_mebibytes(job)}MiB",
        "queue": job.queue,
        account: job.account,
        "walltime": job.walltime.rpartition(":")[0] if job.system == "lsf" else job.walltime,
        "job_extra_directives": [*_more(job), *job.directives],
        "job_script_prologue": [*prologue, *job.prologue],
        "worker_extra_args": ["--nthreads", "1", "--memory-limit", "0"],  # the job's limit is that of its cell
        "interface": job.interface,
        "log_directory": str(logs),
        "scheduler_options": {"dashboard_address": ":0"},  # the usual port may be taken by another sweep
        **_resources(job),
    }


def _resources(job: Job) -> dict[str, Any]:
    """Return what PBS has to be asked for in one piece."""
    gpus = f":ngpus={job.gpus}" * (job.gpus > 0)
    spec = f"select=1:ncpus={job.cores}:mem={_mebibytes(job)}mb{gpus}"
    return {"resource_spec": spec} if job.system == "pbs" else {}


def _more(job: Job) -> list[str]:
    """Return the lines of a job's script that dask-jobqueue has no words for."""
    gpus = {"slurm": f"--gres=gpu:{job.gpus}", "lsf": f'-gpu "num={job.gpus}"', "sge": f"-l gpu={job.gpus}"}
    lines = [gpus[job.system]] if job.gpus and job.system in gpus else []
    if job.system == "sge":
        lines += [f"-pe smp {job.cores}"] * (job.cores > 1)
        lines += [f"-l mem_free={_mebibytes(job)}M"]
    return lines


def _mebibytes(job: Job) -> int:
    """Return the memory of a job as batch systems count it, whose MB is 1024 times 1024 bytes; raises BadInput."""
    from dask.utils import parse_bytes

    try:
        return -(-int(parse_bytes(job.memory)) // 2**20)
    except ValueError as error:
        raise BadInput(f"cluster.memory={job.memory}: give a number and a unit, as in 16GB") from error
