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


class TimingLock:
    """The lock of a process that computes: the open file by which it shares the host with others."""

    def __init__(self, file: IO[bytes]) -> None:
        """Share the lock `file`; waits while a run is timed."""
        self._file = file
        fcntl.flock(file, fcntl.LOCK_SH)

    @contextlib.contextmanager
    def hold_alone(self) -> Iterator[None]:
        """Be the only run of this host inside the block; waits until the runs that compute now have computed.

        A run that computes goes on computing afterwards.
        """
        fcntl.flock(self._file, fcntl.LOCK_UN)  # two runs that wait for each other would wait for ever
        fcntl.flock(self._file, fcntl.LOCK_EX)
        yield
        fcntl.flock(self._file, fcntl.LOCK_SH)

    def is_only_run(self) -> bool:
        """Tell whether no other run of this host computes or is timed now."""
        only = True
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            only = False
        fcntl.flock(self._file, fcntl.LOCK_SH)  # the system has taken back the shared lock in either case
        return only


@contextlib.contextmanager
def share_host(held: TimingLock | None = None) -> Iterator[TimingLock]:
    """Compute inside the block, beside other runs of this host; yields the lock.

    A lock that this process holds already, `held`, stays as it is.
    """
    if held is not None:
        yield held
        return
    with (folder() / "computing").open("ab") as file:
        try:
            yield TimingLock(file)
        finally:
            fcntl.flock(file, fcntl.LOCK_UN)  # a fork of this process may hold the file open


def folder() -> Path:
    """Return the folder of the lock of this host and user, made if need be."""
    path = Path(os.environ.get(FOLDER) or Path(tempfile.gettempdir()) / f"vprbench-slot-{os.getuid()}")
    path.mkdir(mode=0o700, parents=True, exist_ok=True)
    return path
