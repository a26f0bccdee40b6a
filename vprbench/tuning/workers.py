"""Processes that try settings side by side; one that dies costs what it was trying, and no more."""

from __future__ import annotations

import os
import signal
import traceback
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
    wait,
)
from dataclasses import dataclass
from multiprocessing import get_context, parent_process
from threading import Thread
from typing import Generic, Self, TypeVar

from vprbench.errors import ClusterLostError
from vprbench.runs import machine

TaskT = TypeVar("TaskT")
Result = TypeVar("Result")


@dataclass(frozen=True)
class Answer(Generic[Result]):
    """What came of one task: a result, or why there is none."""

    task: int
    given: Result | None
    error: str = ""


def one_process() -> Executor:
    """Return an executor of one process of one thread, which ends with this process."""
    return ProcessPoolExecutor(1, get_context("spawn"), initializer=_begin)  # to fork threads is not safe


class Workers(Generic[TaskT, Result]):
    """At most `count` executors, each of which tries one task at a time: one that dies takes no other with it.

    `attempt`, the tasks and what is given for them have to be picklable.
    """

    def __init__(
        self, attempt: Callable[[TaskT], Result], count: int, start: Callable[[], Executor] = one_process
    ) -> None:
        """Start nothing yet; there will never be more executors than there were tasks."""
        self._attempt, self._count, self._start = attempt, count, start
        self._executors: list[Executor] = []

    def __enter__(self) -> Self:
        """Start nothing yet: `answers` knows how many executors have something to do."""
        return self

    def __exit__(self, *_: object) -> None:
        """End the processes: they hold nothing that could be lost."""
        for executor in self._executors:  # which cannot end a process that is at work before Python 3.14
            for process in [*(getattr(executor, "_processes", None) or {}).values()]:
                process.terminate()
            executor.shutdown(wait=False)

    @property
    def started(self) -> int:
        """How many tasks may run at a time."""
        return len(self._executors)

    def answers(self, tasks: Sequence[TaskT], begins: Callable[[int], None]) -> Iterator[Answer[Result]]:
        """Yield the answer to each task as tasks end; `begins` is given the number of each task that is handed out.

        Raises ClusterLostError if the executors' own cluster ends.
        """
        while len(self._executors) < min(self._count, len(tasks)):
            self._executors.append(self._start())
        waiting, idle = deque(enumerate(tasks)), list(range(len(self._executors)))
        busy: dict[Future[Result], tuple[int, int]] = {}
        while waiting or busy:
            while waiting and idle:
                number, (task, what) = idle.pop(), waiting.popleft()
                begins(task)
                busy[self._submitted(number, what)] = task, number
            for future in wait(busy, return_when=FIRST_COMPLETED).done:
                task, number = busy.pop(future)
                idle.append(number)
                try:
                    yield Answer(task, future.result())
                except BrokenExecutor:
                    self._executors[number] = self._start()
                    yield Answer(task, None, "the process that tried it ended")
                except CancelledError as error:
                    raise ClusterLostError("the cluster is gone; what was finished is kept: search again") from error
                except Exception as error:  # whatever a method raises costs its own trial
                    traceback.print_exception(error)
                    yield Answer(task, None, f"{type(error).__name__}: {error}")

    def _submitted(self, number: int, task: TaskT) -> Future[Result]:
        try:
            return self._executors[number].submit(self._attempt, task)
        except BrokenExecutor:  # it died while it had nothing to do
            self._executors[number] = self._start()
            return self._executors[number].submit(self._attempt, task)


def _begin() -> None:
    """Prepare a process: a terminal interrupts all of them, and the parent decides; without it nobody asks."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    machine.pin_threads(1)
    Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)
