"""Many runs, each in a process of its own: here one after the other, or on dask side by side."""

from __future__ import annotations

import functools
import socket
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, wait
from types import TracebackType
from typing import Any, Self

from vprbench.jobs.child import run_in_child
from vprbench.jobs.job import JobResult
from vprbench.jobs.options import ClusterOptions
from vprbench.runs import run_lock
from vprbench.runs.request import RunRequest

_LOOK_EVERY = 1.0  # seconds between looks at the locks of others, and at the cluster

Numbered = tuple[int, RunRequest]
Hear = Callable[[int, str], None]  # takes a run's number and a line of its standard error


class Executor:
    """Makes runs here, one after the other; a context, which ends what it has started."""

    is_distributed = False  # whether several runs go on at a time
    name = socket.gethostname()  # where the runs are made, for people

    def __enter__(self) -> Self:
        """Start nothing."""
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        """End what was started."""

    def room(self) -> int:
        """Return how many runs may be made at a time."""
        return 1

    def submit(self, request: RunRequest, hear: Callable[[str], None] | None) -> Future[Any]:
        """Begin to make a run; `hear` takes the lines of its standard error, None prints them."""
        future: Future[JobResult] = Future()
        future.set_result(run_in_child(request.to_json(), hear))
        return future

    def collect(self, request: RunRequest, made: Future[Any], hear: Callable[[str], None] | None) -> JobResult:
        """Return the outcome of a run that has ended; raises BadInput for a cluster that can make none."""
        result: JobResult = made.result()
        return result

    def require_cluster(self) -> None:
        """Raise ClusterLostError if no run will ever end."""


def run_all(
    executor: Executor,
    runs: Iterable[Numbered],
    begin: Callable[[int], None] = lambda _: None,
    hear: Hear | None = None,
) -> Iterator[tuple[int, JobResult]]:
    """Make runs; yields the number of each and its outcome, in any order.

    A run is taken from `runs` when there is room for it, so that the outcomes until then may decide which. `begin` is
    called with its number. A run that another command makes meanwhile is tried again at the end.
    """
    coming = iter(runs)
    held: list[tuple[Numbered, str]] = []  # runs that other commands make, with their locks
    running: dict[Future[Any], Numbered] = {}

    def hear_of(number: int) -> Callable[[str], None] | None:
        return None if hear is None else functools.partial(hear, number)

    while True:
        while len(running) < (executor.room() if running or held else 1):
            found = next(coming, None) or _take_free_run(held, wait=not running)
            if found is None:
                break
            begin(found[0])
            running[executor.submit(found[1], hear_of(found[0]))] = found
        if not running:
            return
        executor.require_cluster()
        for future in wait(running, _LOOK_EVERY, FIRST_COMPLETED).done:
            number, request = running.pop(future)
            result = executor.collect(request, future, hear_of(number))
            if result.held:
                held.append(((number, request), result.held))
            else:
                yield number, result


def _take_free_run(held: list[tuple[Numbered, str]], wait: bool) -> Numbered | None:
    """Take and return a run that no other command makes any more; if there is none, wait for one or return None."""
    while held:
        for at, (run, lock) in enumerate(held):
            if not run_lock.is_held(lock):
                del held[at]
                return run
        if not wait:
            return None
        time.sleep(_LOOK_EVERY)
    return None


def executor_for(options: ClusterOptions) -> Executor:
    """Return the executor that options name; nothing of dask is imported without one."""
    if not options.is_distributed:
        return Executor()
    from vprbench.jobs.cluster import DaskExecutor

    return DaskExecutor(options)
