"""Who makes cells, a run of the command line each, and tells how they end: this process, or a dask cluster."""

from __future__ import annotations

import functools
import socket
import subprocess
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

from vprbench.cluster.options import ClusterOptions
from vprbench.run import run_lock
from vprbench.run.processes import Ending, run_apart
from vprbench.run.store import Store

Cell = tuple[int, Sequence[str]]  # its number, and its options of the command line
Begins = Callable[[int, str], None]  # told which cell begins, and on which host
Heard = Callable[[int, str], None]  # told which cell says a line on its standard error

_LOOK_EVERY = 1.0  # seconds between looks at whether the locks of others are free


class Crew:
    """Makes cells here, one after the other, each in a process of its own."""

    elsewhere = False  # whether other processes wait for the cells, several at a time

    def __init__(self, stdout: int | None = subprocess.DEVNULL) -> None:
        """Let what cells print go to `stdout`, as for a process."""
        self._stdout = stdout
        self._made: list[tuple[int, Ending]] = []
        self._since = 0.0  # when the first cell began, by the clock of the disk

    def __enter__(self) -> Self:
        """Start nothing yet."""
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        """Nothing is left."""

    def endings(
        self, cells: Iterable[Cell], begins: Begins, heard: Heard | None = None
    ) -> Iterator[tuple[int, Ending]]:
        """Yield the number of each cell and how it ended, in any order.

        A cell is asked for when there is room for it, so that what is known by then may decide which. One that another
        sweep makes is tried again at the end. Without `heard` cells share this process's standard error.
        """
        coming = iter(cells)
        elsewhere: dict[int, tuple[Sequence[str], str]] = {}  # options, and the lock
        running: dict[int, Sequence[str]] = {}
        while True:
            while len(running) < (self.room() if running or elsewhere else 1):
                cell = next(coming, None) or _freed(elsewhere, wait=not running)
                if cell is None:
                    break
                if not self._since:
                    self._since = Store(results_of(cell[1])).now()
                running[cell[0]] = cell[1]
                self._start(cell, begins, heard)
            if not running:
                return
            for number, ending in self._ended():
                options = running.pop(number)
                if ending.held:
                    elsewhere[number] = options, ending.held
                else:
                    yield number, ending

    def room(self) -> int:
        """Return how many cells may run at a time."""
        return 1

    def _start(self, cell: Cell, begins: Begins, heard: Heard | None) -> None:
        """Begin to make a cell."""
        number, options = cell
        begins(number, socket.gethostname())
        told = None if heard is None else functools.partial(heard, number)
        self._made.append((number, run_apart(options, stdout=self._stdout, heard=told, since=self._since)))

    def _ended(self) -> list[tuple[int, Ending]]:
        """Wait for cells that end and return how; none if there may be room for more."""
        made, self._made = self._made, []
        return made


def _freed(elsewhere: dict[int, tuple[Sequence[str], str]], wait: bool) -> Cell | None:
    """Return a cell that nobody else makes any more; if there is none, wait for one or return None."""
    while elsewhere:
        for number, (options, lock) in elsewhere.items():
            if not run_lock.is_held(lock):
                del elsewhere[number]
                return number, options
        if not wait:
            return None
        time.sleep(_LOOK_EVERY)
    return None


def results_of(options: Sequence[str]) -> Path:
    """Return the results folder of a cell."""
    given = [option.partition("=")[2] for option in options if option.startswith("results=")]
    return Path(given[-1] if given else "results").expanduser().absolute()


def crew(options: ClusterOptions, stdout: int | None = subprocess.DEVNULL) -> Crew:
    """Return who makes cells under these options; nothing of dask is imported without one."""
    if not options.elsewhere:
        return Crew(stdout)
    from vprbench.cluster.dask_crew import DaskCrew

    return DaskCrew(options, stdout)
