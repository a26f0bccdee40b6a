"""One lock a host: runs share it while they compute, and a run holds it alone while it is timed."""

from __future__ import annotations

import contextlib
import fcntl
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import IO

FOLDER = "VPRBENCH_SLOT"  # the environment variable that names the folder of the lock, which has to be of this host

_computing: list[IO[bytes]] = []  # the open file by which this process computes


@contextlib.contextmanager
def computing() -> Iterator[None]:
    """Compute inside the block, beside other runs of this host; waits while a run is timed.

    A block inside a block changes nothing.
    """
    if _computing:
        yield
        return
    with (folder() / "computing").open("ab") as file:
        fcntl.flock(file, fcntl.LOCK_SH)
        _computing.append(file)
        try:
            yield
        finally:
            _computing.remove(file)
            fcntl.flock(file, fcntl.LOCK_UN)  # a fork of this process may hold the file open


@contextlib.contextmanager
def alone() -> Iterator[None]:
    """Be the only run of this host inside the block; waits until the runs that compute now have computed.

    A run that computes goes on computing afterwards.
    """
    with computing():
        (own,) = _computing
        fcntl.flock(own, fcntl.LOCK_UN)  # two runs that wait for each other would wait for ever
        fcntl.flock(own, fcntl.LOCK_EX)
        yield
        fcntl.flock(own, fcntl.LOCK_SH)


def is_only_run() -> bool:
    """Tell whether no other run of this host computes or is timed now; for a process that computes."""
    (own,) = _computing
    only = True
    try:
        fcntl.flock(own, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        only = False
    fcntl.flock(own, fcntl.LOCK_SH)  # the system has taken back the shared lock in either case
    return only


def folder() -> Path:
    """Return the folder of the lock of this host and user, made if need be."""
    path = Path(os.environ.get(FOLDER) or Path(tempfile.gettempdir()) / f"vprbench-slot-{os.getuid()}")
    path.mkdir(mode=0o700, parents=True, exist_ok=True)
    return path
