"""Many runs, each in a process of its own: here one after the other or side by side, or on dask."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from pathlib import Path
from typing import Self

from vprbench.jobs.child import print_child_line, run_in_child
from vprbench.jobs.job import JobResult
from vprbench.jobs.options import ClusterOptions
from vprbench.runs import run_lock
from vprbench.runs.request import RunRequest

_LOOK_EVERY = 1.0  # seconds between looks at the locks of other commands

Numbered = tuple[int, RunRequest]


class Executor:
    """Makes runs on this machine: one after the other, or `workers` at a time. A context, which ends them."""

    def __init__(self, workers: int | None = None) -> None:
        """Start nothing yet: everything may be stored."""
        self.is_distributed = workers is not None  # whether several runs go on at a time
        self._pool = ThreadPoolExecutor(workers, "worker") if workers else None
        self._n_workers = workers or 1
        self._stopped = threading.Event()

    def __enter__(self) -> Self:
        """Start nothing."""
        return self

    def __exit__(self, *_: object) -> None:
        """Interrupt the runs that go on, and wait until they have ended."""
        self._stopped.set()
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)

    def count_slots(self) -> int:
        """Return how many runs may be made at a time."""
        return self._n_workers

    def submit(self, request: RunRequest, is_shown: bool) -> Future[JobResult]:
        """Begin to make a run; a run that is made alone may print its standard error as it comes."""
        if self._pool is not None:
            return self._pool.submit(self._run_beside_others, request)
        future: Future[JobResult] = Future()
        future.set_result(run_in_child(request.to_json(), is_shown))
        return future

    def collect(self, request: RunRequest, future: Future[JobResult]) -> JobResult:
        """Return the outcome of a run that has ended; raises BadInput for a cluster that can make none."""
        return future.result()

    def _run_beside_others(self, request: RunRequest) -> JobResult:
        """Make a run whose lines come with its outcome; with device=cuda it sees one GPU."""
        worker = int(threading.current_thread().name.rpartition("_")[2])
        seen = choose_gpu(worker) if request.device == "cuda" else {}
        return run_in_child(request.to_json(), False, self._stopped.is_set, seen)


def choose_executor(options: ClusterOptions) -> Executor:
    """Return the executor that options name; dask is imported only for a cluster."""
    if not options.needs_dask:
        return Executor(options.workers)
    from vprbench.jobs.cluster import DaskExecutor

    return DaskExecutor(options)


def run_all(
    executor: Executor,
    runs: Iterable[Numbered],
    begin: Callable[[int], None] = lambda _: None,
    hear: Callable[[str], None] | None = None,
) -> Iterator[tuple[int, JobResult]]:
    """Make runs; yields the number of each and its outcome, in any order.

    A run is taken from `runs` when there is room for it, so that earlier outcomes may decide on later runs. `begin` is
    called with its number, `hear` with the lines of standard error, which are printed without it. A run that another
    command makes meanwhile is tried again at the end.
    """
    coming = iter(runs)
    waiting: list[tuple[Numbered, str]] = []  # runs that other commands make, with their locks
    running: dict[Future[JobResult], Numbered] = {}
    while True:
        while not running or len(running) < executor.count_slots():
            run = next(coming, None) or _take_free_run(waiting)
            if run is None:
                break
            begin(run[0])
            running[executor.submit(run[1], hear is None)] = run
        if not running and not waiting:
            return
        if not running:
            time.sleep(_LOOK_EVERY)
        for future in wait(running, _LOOK_EVERY, FIRST_COMPLETED).done:
            number, request = running.pop(future)
            result = executor.collect(request, future)
            for line in result.lines:
                (hear or print_child_line)(line)
            if result.lock:
                waiting.append(((number, request), result.lock))
            else:
                yield number, result


def _take_free_run(waiting: list[tuple[Numbered, str]]) -> Numbered | None:
    """Take and return a run that no other command makes any more; None if there is none."""
    for at, (run, lock) in enumerate(waiting):
        if not run_lock.is_held(lock):
            del waiting[at]
            return run
    return None


def choose_gpu(worker: int) -> dict[str, str]:
    """Return the environment that shows a run one GPU: workers take the GPUs of this machine in turn."""
    n_gpus = len([*Path("/dev").glob("nvidia[0-9]*")])
    visible = os.environ.get("CUDA_VISIBLE_DEVICES") or ",".join(str(number) for number in range(n_gpus))
    gpus = visible.split(",")
    return {"CUDA_VISIBLE_DEVICES": gpus[worker % len(gpus)]} if visible else {}
