"""Runs on a dask cluster: processes of this machine, a cluster that runs already, or jobs of a batch system."""

from __future__ import annotations

import asyncio
import contextlib
import importlib.util
import io
import logging
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
import zipfile
from collections.abc import Callable
from concurrent.futures import CancelledError, Executor, Future
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from types import TracebackType
from typing import Self

import dask
from distributed import Client, KilledWorker, LocalCluster, Worker, get_worker
from distributed.deploy.cluster import Cluster

from vprbench import __version__
from vprbench.errors import BadInput, ClusterLostError
from vprbench.jobs.batch import started
from vprbench.jobs.child import run_in_child
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
_LET_START = 1.0  # seconds until a worker that dask starts again is there
_SETTINGS = {
    "distributed.scheduler.allowed-failures": _ATTEMPTS - 1,
    "distributed.scheduler.default-task-durations": {"run_on_worker": "1h"},  # a job for each run, if there may be
    "distributed.nanny.pre-spawn-environ": {},  # a run pins its own threads
    "distributed.worker.profile.enabled": False,  # a worker only waits
}
_FRAMES, _DESCRIPTORS = "frames", "descriptors"  # folders of a results folder that hold no runs

Outcome = tuple[JobResult, list[str], bytes]  # with the lines of standard error, and the stored runs if disks differ


class DaskExecutor:
    """Makes runs side by side, each in a process of its own that a worker waits for."""

    is_distributed = True

    def __init__(self, options: ClusterOptions) -> None:
        """Start nothing yet: everything may be stored."""
        self._options = options
        self.name = options.scheduler or f"the cluster of {socket.gethostname()}"
        self._opened = contextlib.ExitStack()
        self._submitted: list[Future[Outcome]] = []
        self._probes: dict[Path, str] = {}  # by results folder: a file that workers see if they share it

    def __enter__(self) -> Self:
        """Start nothing yet."""
        return self

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
            return self._options.job().maximum
        threads: dict[str, int] = self._client.nthreads()
        return max(1, sum(threads.values()))

    def of_functions(self) -> Executor:
        """Return an executor of functions on the same workers."""
        executor: Executor = self._client.get_executor(pure=False)
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
        except Exception as error:
            if isinstance(error, ImportError) or isinstance(error.__cause__, ImportError):
                raise BadInput(f"a worker cannot make runs ({error}): install vprbench {__version__} there") from error
            return JobResult(1, f"{type(error).__name__}: {error}")
        for line in lines:
            (hear or _echo)(line)
        if runs:
            unpack_runs(runs, Store(Path(request.results).expanduser().absolute()))
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
    return result, lines, b"" if shared else pack_runs(own)


async def wait_until_idle(dask_worker: Worker) -> None:
    """Wait on a worker until its interrupted runs have ended."""
    end = time.monotonic() + _PATIENCE
    while dask_worker.active_threads and time.monotonic() < end:
        await asyncio.sleep(0.1)


def pack_runs(results: Path) -> bytes:
    """Return the runs and frames of a worker's own results folder as a ZIP file, and remove the runs."""
    folders = [each for each in results.glob("[!.]*/[!.]*") if each.is_dir()]
    folders = [each for each in folders if each.parent.name not in (_FRAMES, _DESCRIPTORS)]
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as packed:
        for path in [*(each for folder in folders for each in folder.rglob("*")), *results.glob(f"{_FRAMES}/[!.]*")]:
            packed.write(path, path.relative_to(results))
    for folder in folders:
        shutil.rmtree(folder)
    return content.getvalue()


def unpack_runs(content: bytes, store: Store) -> None:
    """Store the runs and frames that a worker has packed."""
    store.prepare()
    with scratch() as folder, zipfile.ZipFile(io.BytesIO(content)) as packed:
        packed.extractall(folder)
        for frames in folder.glob(f"{_FRAMES}/*"):
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
    """Return a client of the cluster that is asked for, started if need be; `opened` ends what was started.

    Raises BadInput where nobody answers.
    """
    if options.scheduler is None:
        cluster = started(options.job()) if options.cluster else _start_workers(options.workers or 1)
        opened.callback(_close, cluster)
        client = Client(cluster)
        opened.push(client)
        return client
    try:
        client = Client(options.scheduler, timeout="20s")
        opened.push(client)
        return client
    except (OSError, ValueError) as error:
        raise BadInput(
            f"scheduler={options.scheduler}: no dask scheduler answers there ({error}); start one with dask scheduler"
        ) from error


def _start_workers(workers: int) -> LocalCluster:
    """Return so many processes of this machine, each of which waits for one run at a time."""
    return LocalCluster(
        n_workers=workers,
        threads_per_worker=1,
        memory_limit=0,  # the memory of a run is not the worker's
        dashboard_address="127.0.0.1:0",
        silence_logs=logging.CRITICAL,
        preload="vprbench.jobs.cluster",
    )


def _close(cluster: Cluster) -> None:
    """End a cluster, once more if dask was just about to start a worker again that had died."""
    for _ in range(_ATTEMPTS):
        try:
            cluster.close()
            return
        except AssertionError:  # of distributed: it joins a process that has not started yet
            time.sleep(_LET_START)


def _echo(line: str) -> None:
    print(printable(line), file=sys.stderr, flush=True)
