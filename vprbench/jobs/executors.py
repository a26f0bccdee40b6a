"""Who makes runs, each in a process of its own, and tells how they ended: this process, or a dask cluster."""

from __future__ import annotations

import functools
import socket
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from types import TracebackType
from typing import Protocol, Self

from vprbench.jobs.child import run_job
from vprbench.jobs.job import JobResult
from vprbench.jobs.options import ClusterOptions
from vprbench.runs import run_lock

_LOOK_EVERY = 1.0  # seconds between looks at whether the locks of others are free

Numbered = tuple[int, Sequence[str]]  # a run's number, and its options of the command line


@dataclass(frozen=True)
class Callbacks:
    """What is called while runs are made."""

    begins: Callable[[int, str], None] = lambda *_: None  # with the number of a run, and the host
    says: Callable[[int, str], None] | None = None  # with a number and a line of standard error; None: it is printed


class Executor(Protocol):
    """Makes runs; a context, which ends what was started."""

    is_distributed: bool  # whether other processes wait for the runs, several at a time

    def __enter__(self) -> Self:
        """Begin."""

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        """End what was started."""

    def room(self) -> int:
        """Return how many runs may be made at a time."""

    def submit(self, number: int, options: Sequence[str], callbacks: Callbacks) -> Future[JobResult]:
        """Begin to make a run; returns its future."""

    def wait(self) -> None:
        """Wait for a moment, and fulfil the futures of the runs that are made."""


class SerialExecutor:
    """Makes runs here, one after the other."""

    is_distributed = False

    def __enter__(self) -> Self:
        """Start nothing."""
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        """Nothing is left."""

    def room(self) -> int:
        """Return 1."""
        return 1

    def submit(self, number: int, options: Sequence[str], callbacks: Callbacks) -> Future[JobResult]:
        """Make a run; its future is done."""
        callbacks.begins(number, socket.gethostname())
        says = None if callbacks.says is None else functools.partial(callbacks.says, number)
        future: Future[JobResult] = Future()
        future.set_result(run_job(options, heard=says))
        return future

    def wait(self) -> None:
        """Return at once: every future is done."""


def run_all(
    executor: Executor, runs: Iterable[Numbered], callbacks: Callbacks | None = None
) -> Iterator[tuple[int, JobResult]]:
    """Make runs; yields the number of each and its result, in any order.

    A run is asked for when there is room for it, so that what is known by then may decide which. A run that another
    sweep makes is tried again at the end.
    """
    coming, callbacks = iter(runs), callbacks or Callbacks()
    held_by_others: dict[int, tuple[Sequence[str], str]] = {}  # options, and the lock
    running: dict[Future[JobResult], Numbered] = {}
    while True:
        while len(running) < (executor.room() if running or held_by_others else 1):
            found = next(coming, None) or _freed(held_by_others, wait=not running)
            if found is None:
                break
            running[executor.submit(*found, callbacks)] = found
        if not running:
            return
        executor.wait()
        for future in [each for each in running if each.done()]:
            (number, options), result = running.pop(future), future.result()
            if result.held:
                held_by_others[number] = options, result.held
            else:
                yield number, result


def _freed(held_by_others: dict[int, tuple[Sequence[str], str]], wait: bool) -> Numbered | None:
    """Return a run that nobody else makes any more; if there is none, wait for one or return None."""
    while held_by_others:
        for number, (options, lock) in held_by_others.items():
            if not run_lock.is_held(lock):
                del held_by_others[number]
                return number, options
        if not wait:
            return None
        time.sleep(_LOOK_EVERY)
    return None


def executor_for(options: ClusterOptions) -> Executor:
    """Return who makes runs under these options; nothing of dask is imported without one."""
    if not options.is_distributed:
        return SerialExecutor()
    from vprbench.jobs.dask_executor import DaskExecutor

    return DaskExecutor(options)
