"""What a worker of a dask cluster does: makes one cell in a process of its own, and tells the client how it goes."""

from __future__ import annotations

import socket
import subprocess
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from threading import Event
from typing import Any

from distributed import Worker, get_worker

import vprbench
from vprbench.cluster.gathered import Parcel, packed
from vprbench.errors import BadInput
from vprbench.run import machine
from vprbench.run.processes import Ending, run_apart

_stopped: dict[str, Event] = {}  # by sweep


@dataclass(frozen=True)
class Order:
    """One cell, as a client asks for it."""

    sweep: str  # the topic under which the client hears of it
    number: int
    options: tuple[str, ...]
    folder: str  # in which the client works
    shows: bool  # whether what it prints is wanted
    since: float  # when the sweep began, by the clock of the disk that holds its results
    gather: bool  # whether what it stores is wanted, for the client does not see it
    version: str = vprbench.__version__


@dataclass(frozen=True)
class Done:
    """What came of a cell."""

    ending: Ending
    said: str = ""  # on standard output
    parcel: Parcel | None = None  # what it stored, where the client does not see it


def make(order: Order) -> Done:
    """Make a cell; raises BadInput if this vprbench is not the client's."""
    if order.version != vprbench.__version__:
        raise BadInput(
            f"the worker on {socket.gethostname()} has vprbench {vprbench.__version__}, this is {order.version}: "
            "install the same on both"
        )
    worker, stopped = get_worker(), _stopped.setdefault(order.sweep, Event())
    host = socket.gethostname()

    def tell(line: str | None) -> None:
        worker.log_event(order.sweep, {"cell": order.number, "host": host, "line": line})

    tell(None)
    own = Path(worker.local_directory) / "results"  # removed with the worker
    options = [*order.options, *([f"results={own}"] if order.gather else [])]
    with tempfile.TemporaryFile() as said:
        ending = run_apart(
            options,
            stdout=said.fileno() if order.shows else subprocess.DEVNULL,
            heard=tell,
            stopped=stopped.is_set,
            since=None if order.gather else order.since,
            folder=order.folder if Path(order.folder).is_dir() else None,
        )
        said.seek(0)
        text = said.read().decode(errors="replace")
    return Done(ending, text, packed(own) if order.gather else None)


def on_one_thread(attempt: Callable[[Any], Any], task: Any) -> Any:
    """Return what an attempt at a task in this process gives."""
    machine.pin_threads(1)
    return attempt(task)


def stop(sweep: str) -> None:
    """Let the cells of a sweep that this worker makes end, as an interruption ends them."""
    _stopped.setdefault(sweep, Event()).set()


def dask_setup(_: Worker) -> None:
    """Let a worker of this machine outlive an interruption from the terminal: the client stops its cells, then it."""
    import signal

    signal.signal(signal.SIGINT, signal.SIG_IGN)
