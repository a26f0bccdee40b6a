"""Runs on a dask cluster: one that runs already, or jobs of a batch system by dask-jobqueue."""

from __future__ import annotations

import concurrent.futures
import contextlib
import logging
import multiprocessing
import pkgutil
import signal
import socket
import tempfile
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

import dask
from distributed import Client, KilledWorker, get_worker

from vprbench import __version__
from vprbench.errors import BadInput, ClusterLostError
from vprbench.jobs.child import run_in_child
from vprbench.jobs.executors import Executor
from vprbench.jobs.job import JobResult, describe_failure
from vprbench.jobs.options import ClusterOptions
from vprbench.runs.request import RunRequest
from vprbench.runs.store import Store
from vprbench.storage.atomic import PARTIAL

_MOST_JOBS = 16  # of a batch system, if workers= says nothing
_DURATIONS = {"distributed.scheduler.default-task-durations": {"run_on_worker": "1h"}}  # a job for each run
_LOST = "the dask scheduler is gone; finished runs are kept: give the same command again"


class DaskExecutor(Executor):
    """Makes runs side by side, each in a process of its own that a dask worker waits for."""

    def __init__(self, options: ClusterOptions) -> None:
        """Start nothing yet: everything may be stored."""
        self.is_distributed = True
        self._options = options
        self._opened = contextlib.ExitStack()
        self._probes: dict[Path, Path] = {}  # by results folder: a file there, which a worker has to see

    def __exit__(self, *_: object) -> None:
        """End the connection and the jobs; workers interrupt the runs that go on."""
        self._opened.close()

    @cached_property
    def _client(self) -> Client:
        for name in ("distributed", "distributed.client", "tornado.application"):
            logging.getLogger(name).setLevel(logging.CRITICAL)  # collect() tells of each run
        self._opened.enter_context(dask.config.set(_DURATIONS))
        address = self._options.scheduler
        if address is None:
            address = self._opened.enter_context(start_jobs(self._options.job_arguments(), self.count_slots()))
        try:
            client = Client(address, timeout="20s")
        except (OSError, ValueError) as error:
            remedy = "start one with dask scheduler"
            raise BadInput(f"scheduler={address}: no dask scheduler answers ({error}); {remedy}") from error
        self._opened.push(client)
        return client

    def count_slots(self) -> int:
        """Return how many runs or functions may be called at a time; raises ClusterLostError."""
        if self._options.cluster:
            return self._options.workers or _MOST_JOBS
        try:
            threads: dict[str, int] = self._client.nthreads()
        except (OSError, AttributeError) as error:  # AttributeError: dask has given up the connection
            raise ClusterLostError(_LOST) from error
        return max(1, sum(threads.values()))

    def open_pool(self) -> concurrent.futures.Executor:
        """Return an executor of functions on the same workers."""
        executor: concurrent.futures.Executor = self._client.get_executor(pure=False)
        return executor

    def submit(self, request: RunRequest, is_shown: bool) -> concurrent.futures.Future[JobResult]:
        """Let a worker make a run; the lines of its standard error come with its outcome."""
        root = Path(request.results).expanduser().absolute()
        if root not in self._probes:
            Store(root).prepare()
            probe = tempfile.NamedTemporaryFile(prefix=PARTIAL, suffix="-shared", dir=root)  # noqa: SIM115 - below
            self._probes[root] = Path(self._opened.enter_context(probe).name)
        return self.open_pool().submit(run_on_worker, request.to_json(), Path.cwd(), self._probes[root], __version__)

    def collect(self, request: RunRequest, future: concurrent.futures.Future[JobResult]) -> JobResult:
        """Return the outcome of a run.

        Raises BadInput for workers that can make no run, ClusterLostError if the scheduler is gone.
        """
        try:
            return future.result()
        except concurrent.futures.CancelledError as error:
            raise ClusterLostError(_LOST) from error
        except BadInput:
            raise
        except KilledWorker as error:
            return JobResult(1, describe_failure(request, f"its worker died {error.allowed_failures + 1} times"))
        except Exception as error:  # of the worker, which may lack a library
            if isinstance(error.__cause__, ImportError):
                raise BadInput(f"a worker cannot make runs ({error}): install vprbench {__version__} there") from error
            return JobResult(1, describe_failure(request, f"{type(error).__name__}: {error}"))


def start_jobs(arguments: Mapping[str, Any], most: int) -> Any:
    """Return a cluster of dask-jobqueue with one job submitted, and at most `most` jobs once more runs wait.

    Raises BadInput for an argument that the class does not know, and if the batch system takes no job.
    """
    target = arguments["_target_"]
    handler = signal.getsignal(signal.SIGINT)
    try:
        kind = pkgutil.resolve_name(target)
        signal.signal(signal.SIGINT, handler)  # dask_jobqueue brings one of its own
        cluster = kind(**{name: value for name, value in arguments.items() if name != "_target_"})
    except (ImportError, AttributeError, TypeError, ValueError) as error:
        raise BadInput(f"cluster._target_={target}: {error}") from error

    async def submit() -> None:
        cluster.scale(jobs=1)
        await cluster

    try:
        cluster.sync(submit)
    except (OSError, RuntimeError, ValueError) as error:  # the command that submits is not there, or refuses
        cluster._created.clear()  # the job did not begin: dask would refuse to close it
        cluster.close()
        raise BadInput(f"cluster={target} takes no job: {str(error).strip().splitlines()[-1]}") from error
    cluster.adapt(minimum_jobs=0, maximum_jobs=most)
    return cluster


def run_on_worker(request_json: str, folder: Path, probe: Path, version: str) -> JobResult:
    """Make a run in a child of this worker.

    Args:
        request_json: the run.
        folder: the working folder of the client.
        probe: a file in the client's results folder; a worker that sees it shares the folder.
        version: the client's version of vprbench.

    Raises:
        BadInput: this vprbench is not the client's, or the results folder is on another disk.
    """
    host = socket.gethostname()
    if version != __version__:
        raise BadInput(f"the worker on {host} has vprbench {__version__}, this is {version}: install the same on both")
    if not probe.exists():
        raise BadInput(f"the worker on {host} does not share {probe.parent}: give results= on a disk of all machines")
    multiprocessing.current_process().daemon = False  # as dask starts it, and a daemon may have no children
    tasks, key = get_worker().state.tasks, get_worker().get_current_task()
    with contextlib.chdir(folder if folder.is_dir() else "."):
        try:
            return run_in_child(request_json, False, lambda: key not in tasks or tasks[key].state == "cancelled")
        except KeyboardInterrupt:
            return JobResult(1)  # nobody waits for it any more
