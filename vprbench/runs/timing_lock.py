"""One lock a host: many runs hold it together while they compute, one holds it alone while it is timed."""

from __future__ import annotations

import contextlib
import fcntl
import os
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO

FOLDER = "VPRBENCH_SLOT"  # the environment variable that names the folder of the locks, which has to be of this host
LOOK_EVERY = 0.1  # seconds between two tries to lock a file
PATIENCE_SECONDS = 600.0  # after which a run goes on without the lock, and says that it was not alone

_computing: list[IO[bytes]] = []  # the open file by which this process computes


@contextlib.contextmanager
def computing() -> Iterator[None]:
    """Compute inside the block, beside other runs of this host; waits while a run is timed, or waits to be.

    A block inside a block changes nothing.
    """
    if _computing:
        yield
        return
    with _opened("computing") as file:
        _begin_to_compute(file)
        _computing.append(file)
        try:
            yield
        finally:
            _computing.remove(file)
            fcntl.flock(file, fcntl.LOCK_UN)  # a fork of this process may hold the file open
            _ended().touch()


@contextlib.contextmanager
def alone() -> Iterator[bool]:
    """Be the only run of this host inside the block, as soon as the runs that compute now have computed.

    No other run begins to compute meanwhile. Yields False, without the lock, if others took longer than
    `PATIENCE_SECONDS`. A run that computes goes on computing afterwards.
    """
    for own in _computing:
        fcntl.flock(own, fcntl.LOCK_UN)
    end = time.monotonic() + PATIENCE_SECONDS
    with _opened("waiting") as waiting, _opened("computing") as file:
        try:
            yield _locked(waiting, fcntl.LOCK_EX, end) and _locked(file, fcntl.LOCK_EX, end)
        finally:
            for held in (file, waiting):
                fcntl.flock(held, fcntl.LOCK_UN)
    for own in _computing:
        _begin_to_compute(own)


def undisturbed() -> Callable[[], bool]:
    """Return a function that tells whether no other run has computed on this host from now on."""
    moment = time.time()
    return lambda: _is_only_one() and not (_ended().exists() and _ended().stat().st_mtime > moment)


def folder() -> Path:
    """Return the folder of the locks of this host and user, made if need be."""
    path = Path(os.environ.get(FOLDER) or Path(tempfile.gettempdir()) / f"vprbench-slot-{os.getuid()}")
    path.mkdir(mode=0o700, parents=True, exist_ok=True)
    return path


def _begin_to_compute(file: IO[bytes]) -> None:
    """Lock the file together with others, after all runs that wait to be timed."""
    end = time.monotonic() + PATIENCE_SECONDS
    with _opened("waiting") as waiting:
        _locked(waiting, fcntl.LOCK_SH, end)
        _locked(file, fcntl.LOCK_SH, end)


def _is_only_one() -> bool:
    """Tell whether no other process holds the lock."""
    with contextlib.ExitStack() as opened:
        file = _computing[0] if _computing else opened.enter_context(_opened("computing"))
        only = _locked(file, fcntl.LOCK_EX, 0.0)
        if _computing:
            _locked(file, fcntl.LOCK_SH, time.monotonic() + PATIENCE_SECONDS)
        return only


def _locked(file: IO[bytes], kind: int, end: float) -> bool:
    """Lock a file for as long as it is open; returns False if others hold it until the moment `end`."""
    while True:
        with contextlib.suppress(BlockingIOError):
            fcntl.flock(file, kind | fcntl.LOCK_NB)
            return True
        if time.monotonic() > end:
            return False
        time.sleep(LOOK_EVERY)


def _opened(name: str) -> IO[bytes]:
    return (folder() / name).open("ab")


def _ended() -> Path:
    return folder() / "ended"
