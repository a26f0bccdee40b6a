"""Runs on a dask cluster: processes of this machine, a cluster that runs already, or jobs of a batch system."""

from __future__ import annotations

import asyncio
import concurrent.futures
import contextlib
import importlib.util
import logging
import multiprocessing
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import CancelledError, Future
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from types import TracebackType

import dask
from distributed import Client, KilledWorker, LocalCluster, Worker, get_worker
from distributed.deploy.cluster import Cluster

from vprbench import __version__
from vprbench.errors import BadInput, ClusterLostError
from vprbench.jobs.batch import start_jobs
from vprbench.jobs.child import run_in_child
from vprbench.jobs.executors import Executor
from vprbench.jobs.job import JobResult
from vprbench.jobs.options import ClusterOptions
from vprbench.runs.request import RunRequest
from vprbench.runs.run_files import load
from vprbench.runs.store import Store
from vprbench.storage.atomic import PARTIAL, replace_bytes, scratch
from vprbench.text import printable

logger = logging.getLogger(__name__)

_ATTEMPTS = 4  # at a run whose worker dies
_PATIENCE = 20.0  # seconds that interrupted runs have to end
_SETTINGS = {
    "distributed.scheduler.allowed-failures": _ATTEMPTS - 1,
    "distributed.scheduler.default-task-durations": {"run_on_worker": "1h"},  # a job for each run, if there may be
    "distributed.nanny.pre-spawn-environ": {},  # a run pins its own threads
    "distributed.worker.profile.enabled": False,  # a worker only waits
}

Outcome = tuple[JobResult, list[str], bytes]  # with the lines of standard error, and the stored runs if disks differ


class DaskExecutor(Executor):
    """Makes runs side by side, each in a process of its own that a worker waits for."""

    is_distributed = True

    def __init__(self, options: ClusterOptions) -> None:
        """Start nothing yet: everything may be stored."""
        self._options = options
        self.name = options.scheduler or f"the cluster of {socket.gethostname()}"
        self._opened = contextlib.ExitStack()
        self._submitted: list[Future[Outcome]] = []
        self._probes: dict[Path, str] = {}  # by results folder: a file that workers see if they share it

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        """End what was begun: runs are interrupted first, so that they leave nothing behind."""
        with self._opened:
            running = [future for future in self._submitted if not future.done()]
            if running and self._client.status == "running":
                for future in running:
                    future.cancel()
                with contextlib.suppress(Exception):  # of workers that are gone
                    self._client.run(wait_until_idle, on_error="ignore")
        for root in self._probes:
            Store(root).remove_leftovers()  # of runs that had to be killed

    @cached_property
    def _client(self) -> Client:
        for name in ("distributed", "distributed.client", "tornado.application"):
            logging.getLogger(name).setLevel(logging.CRITICAL)  # the outcome of each run is told here
        self._opened.enter_context(dask.config.set(_SETTINGS))
        client = _connect(self._options, self._opened)
        if importlib.util.find_spec("bokeh"):  # without it the dashboard shows nothing
            logger.info("dask's dashboard: %s", client.dashboard_link)
        return client

    def room(self) -> int:
        """Return how many runs or tasks may run at a time."""
        if self._options.cluster:
            return self._options.most_jobs
        threads: dict[str, int] = self._client.nthreads()
        return max(1, sum(threads.values()))

    def of_functions(self) -> concurrent.futures.Executor:
        """Return an executor of functions on the same workers."""
        executor: concurrent.futures.Executor = self._client.get_executor(pure=False)
        return executor

    def submit(self, request: RunRequest, hear: Callable[[str], None] | None) -> Future[Outcome]:
        """Let a worker make a run; the lines of its standard error come with its outcome."""
        probe = self._probe(Path(request.results).expanduser().absolute())
        arguments = request.to_json(), str(Path.cwd()), probe, __version__
        future = self.of_functions().submit(run_on_worker, *arguments)
        self._submitted.append(future)
        return future

    def _probe(self, root: Path) -> str:
        """Return a file of a results folder, which is there until this executor ends."""
        if root not in self._probes:
            Store(root).prepare()
            probe = tempfile.NamedTemporaryFile(prefix=PARTIAL, suffix="-shared", dir=root)  # noqa: SIM115 - below
            self._probes[root] = self._opened.enter_context(probe).name
        return self._probes[root]

    def collect(self, request: RunRequest, made: Future[Outcome], hear: Callable[[str], None] | None) -> JobResult:
        """Return the outcome of a run, after the lines that it wrote; its runs are stored here if disks differ.

        Raises BadInput for workers that can make no run, ClusterLostError if the cluster is gone.
        """
        try:
            result, lines, runs = made.result()
        except CancelledError as error:
            raise self._lost() from error
        except KilledWorker:
            return JobResult(1, f"its worker died each of the {_ATTEMPTS} times it was tried")
        except BadInput:
            raise
        except Exception as error:  # of the worker, which may run another version or lack a library
            if isinstance(error, ImportError) or isinstance(error.__cause__, ImportError):
                raise BadInput(f"a worker cannot make runs ({error}): install vprbench {__version__} there") from error
            return JobResult(1, f"{type(error).__name__}: {error}")
        for line in lines:
            (hear or _echo)(line)
        if runs:
            unpack_results(runs, Store(Path(request.results).expanduser().absolute()))
        return result

    def require_cluster(self) -> None:
        """Raise ClusterLostError if the scheduler is gone."""
        if self._client.status != "running":
            raise self._lost()

    def _lost(self) -> ClusterLostError:
        self._submitted.clear()
        return ClusterLostError(
            f"the dask scheduler of {self.name} is gone; finished runs are kept: give the same command again"
        )


def run_on_worker(request_json: str, folder: str, probe: str, version: str) -> Outcome:
    """Make a run in a child of this worker; raises BadInput if this vprbench is not the client's.

    Args:
        request_json: the run.
        folder: the working folder of the client.
        probe: a file of the client's results folder; a worker that sees it stores the run there.
        version: the client's version of vprbench.
    """
    if version != __version__:
        host = socket.gethostname()
        raise BadInput(f"the worker on {host} has vprbench {__version__}, this is {version}: install the same on both")
    multiprocessing.current_process().daemon = False  # as dask starts it, and a daemon may have no children
    worker, shared = get_worker(), Path(probe).exists()
    key = worker.get_current_task()
    own = Path(worker.local_directory) / "results"  # removed with the worker
    request = RunRequest.from_json(request_json)
    request = request if shared else replace(request, results=str(own))
    lines: list[str] = []
    result = run_in_child(
        request.to_json(),
        hear=lines.append,
        stopped=lambda: key not in worker.state.tasks or worker.state.tasks[key].state == "cancelled",
        folder=folder if Path(folder).is_dir() else None,
        environment=_gpu_of(worker) if request.device == "cuda" else {},
    )
    return result, lines, b"" if shared else pack_results(own)


async def wait_until_idle(dask_worker: Worker) -> None:
    """Wait on a worker until its interrupted runs have ended."""
    end = time.monotonic() + _PATIENCE
    while dask_worker.active_threads and time.monotonic() < end:
        await asyncio.sleep(0.1)


def pack_results(results: Path) -> bytes:
    """Return a results folder without its descriptors as a ZIP file, and remove all but the descriptors."""
    with scratch() as folder:
        (folder / "results").mkdir()
        for part in results.iterdir():
            if part.name != "descriptors" and not part.name.startswith("."):
                shutil.move(part, folder / "results")
        return Path(shutil.make_archive(str(folder / "packed"), "zip", folder / "results")).read_bytes()


def unpack_results(content: bytes, store: Store) -> None:
    """Store the runs and small pictures of a results folder that a worker has packed."""
    store.prepare()
    with scratch() as folder:
        (folder / "packed").write_bytes(content)
        shutil.unpack_archive(folder / "packed", folder, "zip")
        for frames in folder.glob("frames/*"):
            kept = store.root / frames.relative_to(folder)
            if not kept.exists():
                kept.parent.mkdir(exist_ok=True)
                replace_bytes(kept, frames.read_bytes())
        for summary in folder.glob("*/*/run.json"):
            store.save(load(summary.parent))


def dask_setup(_: Worker) -> None:
    """Let a worker of this machine outlive an interruption from the terminal: the client stops its runs, then it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _gpu_of(worker: Worker) -> dict[str, str]:
    """Return the environment that shows a run one GPU: workers of this machine take them in turn."""
    visible = os.environ.get("CUDA_VISIBLE_DEVICES")
    if visible is None:
        asked = ["nvidia-smi", "--query-gpu=uuid", "--format=csv,noheader"]
        with contextlib.suppress(OSError, subprocess.TimeoutExpired):
            visible = ",".join(
                subprocess.run(asked, capture_output=True, text=True, timeout=30, check=False).stdout.split()
            )
    names = [name for name in (visible or "").split(",") if name.strip()]
    return {"CUDA_VISIBLE_DEVICES": names[worker.name % len(names)]} if names and isinstance(worker.name, int) else {}


def _connect(options: ClusterOptions, opened: contextlib.ExitStack) -> Client:
    """Return a client of the cluster that options name, started if need be; `opened` ends what was started.

    Raises BadInput where no scheduler answers.
    """
    if options.scheduler is not None:
        try:
            client = Client(options.scheduler, timeout="20s")
        except (OSError, ValueError) as error:
            remedy = "start one with dask scheduler"
            raise BadInput(f"scheduler={options.scheduler}: no dask scheduler answers ({error}); {remedy}") from error
    else:
        cluster = start_jobs(options.job_arguments(), options.most_jobs) if options.cluster else _start_workers(options)
        opened.callback(_close, cluster)
        client = Client(cluster)
    opened.push(client)
    return client


def _start_workers(options: ClusterOptions) -> LocalCluster:
    """Return processes of this machine, each of which waits for one run at a time."""
    return LocalCluster(
        n_workers=options.workers,
        threads_per_worker=1,
        memory_limit=0,  # the memory of a run is not the worker's
        dashboard_address="127.0.0.1:0",
        silence_logs=logging.CRITICAL,
        preload="vprbench.jobs.cluster",
    )


def _close(cluster: Cluster) -> None:
    with contextlib.suppress(AssertionError):  # of distributed: it joins a worker that has not started again yet
        cluster.close()


def _echo(line: str) -> None:
    print(printable(line), file=sys.stderr, flush=True)
