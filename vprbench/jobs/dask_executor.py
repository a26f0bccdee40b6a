"""Runs made on a dask cluster: processes of this machine, a cluster that runs, or jobs of a batch system."""

from __future__ import annotations

import contextlib
import importlib.util
import logging
import signal
import sys
import threading
import time
import uuid
from collections import Counter
from collections.abc import Iterable, Sequence
from concurrent.futures import CancelledError, Executor, Future
from functools import cached_property
from pathlib import Path
from types import TracebackType
from typing import Any, NoReturn, Self

import dask
from distributed import Client, KilledWorker, LocalCluster, TimeoutError, wait
from distributed import Future as RemoteFuture
from distributed.deploy.cluster import Cluster

from vprbench import __version__
from vprbench.errors import BadInput, ClusterLostError
from vprbench.jobs.batch import started
from vprbench.jobs.child import results_of
from vprbench.jobs.executors import Callbacks
from vprbench.jobs.job import JobResult
from vprbench.jobs.options import ClusterOptions
from vprbench.jobs.worker import RemoteJob, RemoteResult, make, put_in, stop
from vprbench.plugins.entries import with_plugin_paths
from vprbench.progress import marked
from vprbench.runs.store import Store
from vprbench.storage.atomic import unfinished
from vprbench.text import printable

logger = logging.getLogger(__name__)

_ATTEMPTS = 4  # at a run whose worker dies: it is tried again three times
_PATIENCE = 20.0  # seconds that interrupted runs have to end
_LET_START = 1.0  # seconds until a worker that dask starts again is there
_SETTINGS = {
    "distributed.scheduler.allowed-failures": _ATTEMPTS - 1,
    "distributed.scheduler.default-task-durations": {"run": "1h"},  # a job for each run, if there may be so many
    "distributed.nanny.pre-spawn-environ": {},  # a run pins its own threads
    "distributed.worker.profile.enabled": False,  # a worker only waits
}


class DaskExecutor:
    """Makes runs side by side, each in a process of its own that a worker waits for."""

    is_distributed = True

    def __init__(self, options: ClusterOptions) -> None:
        """Start nothing yet: everything may be stored."""
        self._options = options
        self._opened = contextlib.ExitStack()
        self._sweep = f"vprbench-{uuid.uuid4().hex}"
        self._running: dict[RemoteFuture[RemoteResult], tuple[RemoteJob, Future[JobResult]]] = {}
        self._hosts: dict[int, list[str]] = {}  # on which a run was begun
        self._put_back: Counter[int] = Counter()  # how often, for workers that died while it waited
        self._shared: dict[Path, Path] = {}  # the file by which workers see that they share a results folder
        self._callbacks = Callbacks()

    def __enter__(self) -> Self:
        """Let a request to end interrupt, as Ctrl-C does."""
        if threading.current_thread() is threading.main_thread():
            self._opened.callback(signal.signal, signal.SIGTERM, signal.signal(signal.SIGTERM, _interrupt))
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        """End what was begun: runs are interrupted first, so that they leave nothing behind."""
        with self._opened:
            if self._running and self._client.status == "running":
                with contextlib.suppress(Exception):  # of workers that are gone, or of runs that take too long
                    self._client.run(stop, self._sweep, on_error="ignore")
                    wait([*self._running], timeout=_PATIENCE)
        for shared in self._shared.values():
            shared.unlink(missing_ok=True)

    @cached_property
    def _client(self) -> Client:
        for name in ("distributed", "distributed.client", "tornado.application"):
            logging.getLogger(name).setLevel(logging.CRITICAL)  # what becomes of runs is told here
        self._opened.enter_context(dask.config.set(_SETTINGS))
        client = _connected(self._options, self._opened)
        client.subscribe_topic(self._sweep, self._on_event)
        if importlib.util.find_spec("bokeh"):  # without it the dashboard shows nothing
            logger.info("dask's dashboard: %s", client.dashboard_link)
        return client

    def room(self) -> int:
        """Return how many runs or tasks may run at a time."""
        if self._options.cluster:
            return self._options.job().maximum
        threads: dict[str, int] = self._client.nthreads()
        return max(1, sum(threads.values()))

    def submit(self, number: int, options: Sequence[str], callbacks: Callbacks) -> Future[JobResult]:
        """Let a worker make a run; returns its future, which `wait` fulfils."""
        self._callbacks = callbacks
        root = results_of(options)
        if root not in self._shared:
            Store(root).prepare()
            self._shared[root] = unfinished(root, "-shared")
            self._shared[root].touch()
        order = RemoteJob(
            sweep=self._sweep,
            number=number,
            options=tuple(map(with_plugin_paths, options)),  # a loose file has its name in this process alone
            folder=str(Path.cwd()),
            shared=str(self._shared[root]),
        )
        future: Future[JobResult] = Future()
        self._send(order, future)
        return future

    def _send(self, order: RemoteJob, future: Future[JobResult]) -> None:
        asked = self._client.submit(make, order, key=f"run-{uuid.uuid4().hex}", pure=False)
        self._running[asked] = order, future

    def wait(self) -> None:
        """Wait for a moment, and fulfil the futures of the runs that are made."""
        for asked in self._done(self._running):
            order, future = self._running.pop(asked)
            if self._only_waited(order.number, asked):
                self._send(order, future)
            else:
                future.set_result(self._result(order, asked))

    def _only_waited(self, number: int, future: RemoteFuture[RemoteResult]) -> bool:
        """Tell whether dask has given up a run for workers that died while it waited for them, and not of it."""
        if not isinstance(future.exception(), KilledWorker) or len(self._hosts.get(number, ())) >= _ATTEMPTS:
            return False
        self._put_back[number] += 1
        return self._put_back[number] < _ATTEMPTS

    def of_functions(self) -> Executor:
        """Return an executor of functions on the same workers."""
        executor: Executor = self._client.get_executor(pure=False)
        return executor

    def _done(self, running: Iterable[RemoteFuture[Any]]) -> set[RemoteFuture[Any]]:
        """Wait for a moment and return which have ended; raises ClusterLostError if none ever will."""
        try:
            done: set[RemoteFuture[Any]] = wait([*running], timeout=1, return_when="FIRST_COMPLETED").done
        except TimeoutError:
            done = set()
        except CancelledError as error:
            raise self._lost() from error
        if self._client.status != "running":
            raise self._lost()
        return done

    def _result(self, order: RemoteJob, future: RemoteFuture[RemoteResult]) -> JobResult:
        """Return what came of a run; raises BadInput for workers that can make none."""
        error = future.exception()
        begun = self._hosts.pop(order.number, ["a worker"])
        host = begun[-1]
        if isinstance(error, KilledWorker):
            return JobResult(1, error=f"its worker died each of the {len(begun)} times it was tried, at last on {host}")
        if isinstance(error, ImportError) or isinstance(error and error.__cause__, ImportError):
            raise BadInput(f"{host} cannot make runs ({error}): install vprbench {__version__} there") from error
        if isinstance(error, BadInput):
            raise error
        if error is not None:
            return JobResult(1, error=f"{type(error).__name__} on {host}: {error}")
        done = future.result()
        future.release()  # or it would be made again when its worker dies
        if done.files:
            put_in(done.files, Store(results_of(order.options)))
        return done.result

    def _on_event(self, event: tuple[float, dict[str, Any]]) -> None:
        """Pass on what a worker tells of a run."""
        number, host, line = (event[1][name] for name in ("run", "host", "line"))
        if line is not None:
            (self._callbacks.says or _say)(number, line)
            return
        before = self._hosts.setdefault(number, [])
        if before:
            logger.warning("run %d begins again on %s: its worker on %s is gone", number + 1, host, before[-1])
        before.append(host)
        self._callbacks.begins(number, host)

    def _lost(self) -> ClusterLostError:
        self._running.clear()
        return ClusterLostError(
            f"the dask scheduler {self._options.scheduler or 'of this sweep'} is gone; what was finished before is "
            "kept: give the same command again"
        )


def _connected(options: ClusterOptions, opened: contextlib.ExitStack) -> Client:
    """Return a client of the cluster that is asked for, started if need be; `opened` ends what was started.

    Raises BadInput where nobody answers.
    """
    if options.scheduler is None:
        cluster = started(options.job()) if options.cluster else _local(options.workers or 1)
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


def _local(workers: int) -> LocalCluster:
    """Return so many processes of this machine, each of which waits for one run at a time."""
    return LocalCluster(
        n_workers=workers,
        threads_per_worker=1,
        memory_limit=0,  # what a run takes is not the worker's
        dashboard_address="127.0.0.1:0",
        silence_logs=logging.CRITICAL,
        preload="vprbench.jobs.worker",
    )


def _close(cluster: Cluster) -> None:
    """End a cluster, once more if dask was just about to start a worker again that had died."""
    for _ in range(_ATTEMPTS):
        try:
            cluster.close()
            return
        except AssertionError:  # of distributed: it joins a process that has not started yet
            time.sleep(_LET_START)


def _say(_: int, line: str) -> None:
    """Print what a run says; how far it is stands in the live view alone."""
    told = marked(line)
    if not isinstance(told, tuple):
        print(printable(line if told is None else told), file=sys.stderr, flush=True)


def _interrupt(number: int, _: object) -> NoReturn:
    raise KeyboardInterrupt(number)
