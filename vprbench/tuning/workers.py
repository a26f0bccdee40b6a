"""Processes that try settings side by side; one that dies costs what it was trying, and no more."""

from __future__ import annotations

import itertools
import os
import signal
import traceback
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Future, ProcessPoolExecutor, wait
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing import get_context, parent_process
from threading import Thread
from typing import TYPE_CHECKING, Any, Generic, Self, TypeVar

from vprbench.runs import machine

if TYPE_CHECKING:
    from vprbench.jobs.dask_executor import DaskExecutor

Asked = TypeVar("Asked")
Given = TypeVar("Given")


@dataclass(frozen=True)
class Answer(Generic[Given]):
    """What came of one task: a result, or why there is none."""

    task: int
    given: Given | None
    error: str = ""


class Workers(Generic[Asked, Given]):
    """At most `count` processes of one thread, each a pool of its own: one that dies takes no other with it.

    `attempt`, the tasks and what is given for them have to be picklable. A process whose parent is gone ends.
    """

    def __init__(self, attempt: Callable[[Asked], Given], count: int) -> None:
        """Start nothing yet; there will never be more processes than there were tasks."""
        self._attempt, self._count = attempt, count
        self._pools: list[ProcessPoolExecutor] = []
        self._numbers: list[Future[int]] = []  # of the processes, as the system knows them

    def __enter__(self) -> Self:
        """Start nothing yet: `answers` knows how many processes have something to do."""
        return self

    def __exit__(self, *_: object) -> None:
        """End the processes: they hold nothing that could be lost."""
        for number in self._numbers:
            if number.done() and number.exception() is None:
                with suppress(ProcessLookupError):
                    os.kill(number.result(), signal.SIGTERM)
        for pool in self._pools:
            pool.shutdown(cancel_futures=True)

    @property
    def started(self) -> int:
        """How many processes there are."""
        return len(self._pools)

    def answers(self, tasks: Sequence[Asked], begins: Callable[[int], None]) -> Iterator[Answer[Given]]:
        """Yield the answer to each task as tasks end; `begins` is given the number of each task that is handed out."""
        while len(self._pools) < min(self._count, len(tasks)):
            self._start(len(self._pools))
        waiting, idle = deque(enumerate(tasks)), list(range(len(self._pools)))
        busy: dict[Future[Given], tuple[int, int]] = {}
        while waiting or busy:
            while waiting and idle:
                task, asked = waiting.popleft()
                number = idle.pop()
                begins(task)
                busy[self._submitted(number, asked)] = task, number
            for future in wait(busy, return_when=FIRST_COMPLETED).done:
                task, number = busy.pop(future)
                idle.append(number)
                error = future.exception()
                if error is None:
                    yield Answer(task, future.result())
                elif isinstance(error, BrokenExecutor):
                    self._start(number)
                    yield Answer(task, None, "the process that tried it ended")
                else:
                    traceback.print_exception(error)
                    yield Answer(task, None, f"{type(error).__name__}: {error}")

    def _submitted(self, number: int, asked: Asked) -> Future[Given]:
        try:
            return self._pools[number].submit(self._attempt, asked)
        except BrokenExecutor:  # it died while it had nothing to do
            self._start(number)
            return self._pools[number].submit(self._attempt, asked)

    def _start(self, number: int) -> None:
        """Start a process, in the place of a dead one if there was one."""
        context = get_context("spawn")  # forking a process that has threads is not safe
        pool = ProcessPoolExecutor(1, context, initializer=_begin)
        self._pools[number:] = [pool, *self._pools[number + 1 :]]
        self._numbers[number:] = [pool.submit(os.getpid), *self._numbers[number + 1 :]]


class Spread(Workers[Asked, Given]):
    """The workers of a dask cluster in the place of processes of this machine."""

    def __init__(self, attempt: Callable[[Asked], Given], executor: DaskExecutor) -> None:
        """Start nothing yet."""
        super().__init__(attempt, 0)
        self._executor = executor

    def __enter__(self) -> Self:
        """Start nothing yet."""
        self._executor.__enter__()
        return self

    def __exit__(self, *error: Any) -> None:
        """End what was started."""
        self._executor.__exit__(*error)

    @property
    def started(self) -> int:
        """How many tasks may run at a time."""
        return self._executor.room()

    def answers(self, tasks: Sequence[Asked], begins: Callable[[int], None]) -> Iterator[Answer[Given]]:
        """Yield the answer to each task as tasks end; a worker that dies is made up for by another."""
        return itertools.starmap(Answer, self._executor.answers(self._attempt, tasks, begins))


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
