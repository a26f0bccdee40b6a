"""Cells on a dask cluster: processes of this machine, a cluster that runs, or jobs of a batch system."""

from __future__ import annotations

import contextlib
import importlib.util
import itertools
import logging
import signal
import subprocess
import sys
import threading
import uuid
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import CancelledError
from functools import cached_property
from pathlib import Path
from types import TracebackType
from typing import Any, NoReturn, Self

import dask
from distributed import Client, Future, KilledWorker, LocalCluster, TimeoutError, wait

from vprbench import __version__
from vprbench.cluster.batch import started
from vprbench.cluster.cell import Done, Order, make, on_one_thread, stop
from vprbench.cluster.crew import Begins, Cell, Crew, Heard, results_of
from vprbench.cluster.gathered import unpack
from vprbench.cluster.options import ClusterOptions
from vprbench.errors import BadInput, ClusterLostError
from vprbench.plugins.entries import as_asked
from vprbench.progress import answer_stream, marked
from vprbench.run import run_lock
from vprbench.run.processes import Ending
from vprbench.run.store import Store
from vprbench.text import printable

logger = logging.getLogger(__name__)

_ATTEMPTS = 4  # at a cell whose worker dies: it is tried again three times
_PATIENCE = 20.0  # seconds that interrupted cells have to end
_SETTINGS = {
    "distributed.scheduler.allowed-failures": _ATTEMPTS - 1,
    "distributed.scheduler.default-task-durations": {"cell": "1h"},  # a job for each cell, if there may be so many
    "distributed.nanny.pre-spawn-environ": {},  # a cell pins its own threads
    "distributed.worker.profile.enabled": False,  # a worker only waits
}


class DaskCrew(Crew):
    """Makes cells side by side, each in a process of its own that a worker waits for."""

    elsewhere = True

    def __init__(self, options: ClusterOptions, stdout: int | None = subprocess.DEVNULL) -> None:
        """Start nothing yet: everything may be stored."""
        super().__init__(stdout)
        self._options = options
        self._opened = contextlib.ExitStack()
        self._sweep = f"vprbench-{uuid.uuid4().hex}"
        self._numbers = itertools.count()
        self._running: dict[Future[Done], Cell] = {}
        self._hosts: dict[int, list[str]] = {}  # on which a cell was begun
        self._put_back: Counter[int] = Counter()  # how often, for workers that died while it waited
        self._begins: Begins = lambda *_: None
        self._heard: Heard = _say

    def __enter__(self) -> Self:
        """Let a request to end interrupt, as Ctrl-C does."""
        if threading.current_thread() is threading.main_thread():
            self._opened.callback(signal.signal, signal.SIGTERM, signal.signal(signal.SIGTERM, _interrupt))
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        """End what was begun: cells are interrupted first, so that they leave nothing behind."""
        with self._opened:
            if self._running and self._client.status == "running":
                with contextlib.suppress(Exception):  # of workers that are gone, or of cells that take too long
                    self._client.run(stop, self._sweep, on_error="ignore")
                    wait([*self._running], timeout=_PATIENCE)
        for root in {results_of(options) for _, options in self._running.values()}:
            run_lock.remove_leftovers(root)  # of cells that had to be killed

    @cached_property
    def _client(self) -> Client:
        for name in ("distributed", "distributed.client", "tornado.application"):
            logging.getLogger(name).setLevel(logging.CRITICAL)  # what becomes of cells is told here
        self._opened.enter_context(dask.config.set(_SETTINGS))
        client = _connected(self._options, self._opened)
        client.subscribe_topic(self._sweep, self._told)
        bokeh = "" if importlib.util.find_spec("bokeh") else " (pip install bokeh, and it shows something)"
        logger.info("dask's dashboard: %s%s", client.dashboard_link, bokeh)
        return client

    def room(self) -> int:
        """Return how many cells or tasks may run at a time."""
        if self._options.cluster:
            return self._options.job().maximum
        threads: dict[str, int] = self._client.nthreads()
        return max(1, sum(threads.values()))

    def _start(self, cell: Cell, begins: Begins, heard: Heard | None) -> None:
        self._begins, self._heard = begins, heard or _say
        self._submit(cell)

    def _submit(self, cell: Cell) -> None:
        number, options = cell
        order = Order(
            sweep=self._sweep,
            number=number,
            options=tuple(map(as_asked, options)),  # a loose file has its name in this process alone
            folder=str(Path.cwd()),
            shows=self._stdout != subprocess.DEVNULL,
            since=self._since,
            gather=self._options.gather,
        )
        key = f"cell-{self._sweep}-{next(self._numbers)}"
        self._running[self._client.submit(make, order, key=key, pure=False)] = cell

    def _ended(self) -> list[tuple[int, Ending]]:
        ended = []
        for future in self._done(self._running):
            cell = self._running.pop(future)
            if self._only_waited(cell[0], future):
                self._submit(cell)
            else:
                ended.append((cell[0], self._ending(cell, future)))
        return ended

    def _only_waited(self, number: int, future: Future[Done]) -> bool:
        """Tell whether dask has given up a cell for workers that died while it waited for them, and not of it."""
        if not isinstance(future.exception(), KilledWorker) or len(self._hosts.get(number, ())) >= _ATTEMPTS:
            return False
        self._put_back[number] += 1
        return self._put_back[number] < _ATTEMPTS

    def answers(
        self, attempt: Callable[[Any], Any], tasks: Sequence[Any], begins: Callable[[int], None]
    ) -> Iterator[tuple[int, Any, str]]:
        """Yield of each task, as they end, its number and what `attempt` returns, or None and why there is nothing."""
        waiting, running = deque(enumerate(tasks)), dict[Future[Any], int]()
        while waiting or running:
            while waiting and len(running) < self.room():
                number, task = waiting.popleft()
                begins(number)
                running[self._client.submit(on_one_thread, attempt, task, pure=False)] = number
            for future in self._done(running):
                number, error = running.pop(future), future.exception()
                given = (future.result(), "") if error is None else (None, f"{type(error).__name__}: {error}")
                future.release()
                yield number, *given

    def _done(self, running: Iterable[Future[Any]]) -> set[Future[Any]]:
        """Wait for a moment and return which have ended; raises ClusterLostError if none ever will."""
        try:
            done: set[Future[Any]] = wait([*running], timeout=1, return_when="FIRST_COMPLETED").done
        except TimeoutError:
            done = set()
        except CancelledError as error:
            raise self._lost() from error
        if self._client.status != "running":
            raise self._lost()
        return done

    def _ending(self, cell: Cell, future: Future[Done]) -> Ending:
        """Return how a cell ended; raises BadInput for workers that can make none."""
        (number, options), error = cell, future.exception()
        begun = self._hosts.pop(number, ["a worker"])
        host = begun[-1]
        if isinstance(error, KilledWorker):
            return Ending(1, error=f"its worker died each of the {len(begun)} times it was tried, at last on {host}")
        if isinstance(error, ImportError) or isinstance(error and error.__cause__, ImportError):
            raise BadInput(f"{host} cannot make cells ({error}): install vprbench {__version__} there") from error
        if isinstance(error, BadInput):
            raise error
        if error is not None:
            return Ending(1, error=f"{type(error).__name__} on {host}: {error}")
        done = future.result()
        future.release()  # or it would be made again when its worker dies
        if done.parcel is not None:
            unpack(done.parcel, Store(results_of(options)))
        if done.said:
            print(done.said, end="", file=answer_stream(), flush=True)
        return done.ending

    def _told(self, event: tuple[float, dict[str, Any]]) -> None:
        """Pass on what a worker tells of a cell."""
        number, host, line = (event[1][name] for name in ("cell", "host", "line"))
        if line is not None:
            self._heard(number, line)
            return
        before = self._hosts.setdefault(number, [])
        if before:
            logger.warning("cell %d begins again on %s: its worker on %s is gone", number + 1, host, before[-1])
        before.append(host)
        self._begins(number, host)

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
        client = Client(opened.enter_context(cluster))
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
    """Return so many processes of this machine, each of which waits for one cell at a time."""
    return LocalCluster(
        n_workers=workers,
        threads_per_worker=1,
        memory_limit=0,  # what a cell takes is not the worker's
        dashboard_address="127.0.0.1:0",
        silence_logs=logging.CRITICAL,
        preload="vprbench.cluster.cell",
    )


def _say(_: int, line: str) -> None:
    """Print what a cell says; how far it is stands in the live view alone."""
    told = marked(line)
    if not isinstance(told, tuple):
        print(printable(line if told is None else told), file=sys.stderr, flush=True)


def _interrupt(number: int, _: object) -> NoReturn:
    raise KeyboardInterrupt(number)
