"""Processes that try settings side by side; one that dies costs what it was trying, and no more."""

from __future__ import annotations

import contextlib
import multiprocessing
import signal
import traceback
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from types import TracebackType
from typing import Any, Generic, Self, TypeVar

Asked = TypeVar("Asked")
Given = TypeVar("Given")
Attempt = Callable[[Asked], Given]

_GONE = (EOFError, BrokenPipeError, ConnectionResetError)


@dataclass(frozen=True)
class Answer(Generic[Given]):
    """What came of one task: a result, or why there is none."""

    task: int
    given: Given | None
    error: str = ""


@dataclass
class _Worker:
    link: Connection
    process: BaseProcess
    ready: bool = False
    task: int | None = None


class Workers(Generic[Asked, Given]):
    """A number of processes, each of which calls `prepare` once and then what that returned, task by task.

    `prepare`, the tasks and what is given for them have to be picklable. A process whose parent is gone ends with
    its current task.
    """

    def __init__(self, prepare: Callable[[], Attempt[Asked, Given]], count: int) -> None:
        """Start nothing yet; there will be at most `count` processes, and never more than there were tasks."""
        self._prepare = prepare
        self._count = count
        self._workers: list[_Worker] = []

    def __enter__(self) -> Self:
        """Start nothing yet: `answers` knows how many processes have something to do."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End the processes: they hold nothing that could be lost."""
        for worker in self._workers:
            worker.link.close()
            worker.process.terminate()
        for worker in self._workers:
            worker.process.join()

    @property
    def started(self) -> int:
        """How many processes there are."""
        return len(self._workers)

    def answers(self, tasks: Sequence[Asked], begins: Callable[[int], None]) -> Iterator[Answer[Given]]:
        """Yield what comes of each task, in the order in which they end; `begins` is told of each that is handed out.

        Raises RuntimeError where a process cannot even prepare.
        """
        while len(self._workers) < min(self._count, len(tasks)):
            self._workers.append(self._started())
        waiting = deque(enumerate(tasks))
        while waiting or any(worker.task is not None for worker in self._workers):
            for worker in self._workers:
                if waiting and worker.ready and worker.task is None:
                    worker.task, asked = waiting.popleft()
                    begins(worker.task)
                    with contextlib.suppress(*_GONE):  # what is gone is noticed below
                        worker.link.send(asked)
            links = {worker.link: number for number, worker in enumerate(self._workers)}
            for link in wait(list(links)):
                assert isinstance(link, Connection)
                yield from self._heard(links[link])

    def _heard(self, number: int) -> Iterator[Answer[Given]]:
        """Take a process's message, or put a new one in the place of one that is gone."""
        worker = self._workers[number]
        try:
            what, content = worker.link.recv()
        except _GONE:
            worker.process.join()
            ended = f"a worker process ended with exit code {worker.process.exitcode}"
            if not worker.ready:
                raise RuntimeError(f"{ended} while it prepared") from None
            self._workers[number] = self._started()
            if worker.task is not None:
                yield Answer(worker.task, None, ended)
            return
        if what == "unprepared":
            raise RuntimeError(f"a worker process could not prepare: {content}")
        task, worker.task, worker.ready = worker.task, None, True
        if task is not None:
            yield Answer(task, content) if what == "given" else Answer(task, None, content)

    def _started(self) -> _Worker:
        context = multiprocessing.get_context("spawn")  # forking a process that has threads is not safe
        link, far_end = context.Pipe()
        process = context.Process(target=_work, args=(self._prepare, far_end), daemon=True)
        process.start()
        far_end.close()
        return _Worker(link, process)


def _work(prepare: Callable[[], Attempt[Any, Any]], link: Connection) -> None:
    """Do in a process of its own what comes over the link, until that is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal interrupts all of them; the parent decides
    with contextlib.suppress(*_GONE):
        try:
            attempt = prepare()
        except Exception as error:  # told to the parent, which ends the search by it
            traceback.print_exc()
            link.send(("unprepared", _told(error)))
            return
        link.send(("ready", None))
        while True:
            asked = link.recv()
            try:
                message = ("given", attempt(asked))
            except Exception as error:  # whatever one setting leads to ends its trial, not the search
                traceback.print_exc()
                message = ("failed", _told(error))
            link.send(message)


def _told(error: Exception) -> str:
    return f"{type(error).__name__}: {error}"
