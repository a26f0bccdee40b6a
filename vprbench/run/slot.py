"""One cell of a host is timed at a time, the others stopped; all by locks that the system frees with their holders."""

from __future__ import annotations

import contextlib
import fcntl
import math
import os
import tempfile
import time
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO

from vprbench import ending

FOLDER = "VPRBENCH_SLOT"  # the environment variable that names the folder of the locks, which has to be of this host
LOOK_EVERY = 0.1  # seconds between looks at a lock, and at a child
_PATIENCE = 10.0  # seconds for others to stop; a program that nobody waits for cannot be stopped


class Place:
    """One cell among those that run on this host, kept by whoever waits for its process."""

    def __init__(self, process: int) -> None:
        """Keep the place of a process, which is not taken yet."""
        self._process = process
        self._held: tuple[Path, IO[bytes]] | None = None

    def enter(self) -> None:
        """Be seen by whoever wants to be alone; nothing if it is already."""
        if self._held is None:
            path = _running() / f"{self._process}-{uuid.uuid4().hex}"
            hidden = folder() / path.name  # until it is locked, or it would be taken for one that is left behind
            file = hidden.open("ab")
            _locked(file)
            self._held = hidden.rename(path), file

    def leave(self) -> None:
        """Be seen no more, stopped or timed."""
        if self._held is not None:
            (path, file), self._held = self._held, None
            path.unlink(missing_ok=True)
            file.close()

    def end(self) -> None:
        """Leave for good; others learn that it was there."""
        self.leave()
        _ended().touch()


@contextlib.contextmanager
def present() -> Iterator[None]:
    """Let others see a run of this process, unless another process waits for it, and keeps its place."""
    if ending.waited_for():
        yield
        return
    place = Place(os.getpid())
    place.enter()
    try:
        yield
    finally:
        place.end()


@contextlib.contextmanager
def alone() -> Iterator[Callable[[], bool]]:
    """Take the timing slot of this host, once it is free; yields what tells whether no other cell has run since.

    Those who wait for the other cells stop them meanwhile. What cannot be stopped is waited for some seconds.
    """
    began = time.monotonic()
    ending.tell(timing=True, queued=math.inf)
    try:
        with _slot().open("ab") as file:
            quiet = _queued(file)
            if quiet:
                file.truncate(0)
                file.write(b"%d" % os.getpid())
                file.flush()
                entered = time.monotonic()
                while (beside := others()) and time.monotonic() - entered < _PATIENCE:
                    time.sleep(LOOK_EVERY)
                quiet = not beside
            ending.tell(queued=time.monotonic() - began)
            since = undisturbed()
            try:
                yield lambda: quiet and since()
            finally:
                fcntl.flock(file, fcntl.LOCK_UN)  # a fork of this process may hold the file open
    finally:
        ending.tell(timing=False)


def taken() -> bool:
    """Tell whether a cell of this host is timed, or about to be; one that was stopped itself, as by Ctrl-Z, is not."""
    with _slot().open("ab") as file:
        return not _locked(file, shared=True) and not _suspended()


def others() -> bool:
    """Tell whether other cells run on this host, and remove what killed ones have left."""
    found = False
    for path in _running().iterdir():
        if not path.name.startswith(f"{os.getpid()}-"):
            with contextlib.suppress(FileNotFoundError), path.open("rb") as file:
                if _locked(file, shared=True):
                    path.unlink(missing_ok=True)
                else:
                    found = True
    return found


def undisturbed() -> Callable[[], bool]:
    """Return what tells whether this host was this cell's own from now on: no other cell ran, or was timed."""
    moment = time.time()
    marks = (_slot(), _ended())
    return lambda: not (others() or any(path.exists() and path.stat().st_mtime > moment for path in marks))


def folder() -> Path:
    """Return the folder of the locks of this host and user, made if need be."""
    path = Path(os.environ.get(FOLDER) or Path(tempfile.gettempdir()) / f"vprbench-slot-{os.getuid()}")
    path.mkdir(mode=0o700, parents=True, exist_ok=True)
    return path


def _running() -> Path:
    path = folder() / "running"
    path.mkdir(exist_ok=True)
    return path


def _slot() -> Path:
    return folder() / "timing"


def _ended() -> Path:
    return folder() / "ended"


def _queued(file: IO[bytes]) -> bool:
    """Wait for the slot; returns False, without it, if who holds it is stopped, and may be for ever."""
    while not _locked(file):
        if _suspended():
            return False
        time.sleep(LOOK_EVERY)
    return True


def _suspended() -> bool:
    """Tell whether the process that holds the slot is stopped."""
    import psutil  # not needed where nobody is timed

    with contextlib.suppress(OSError, ValueError, psutil.Error):
        return bool(psutil.Process(int(_slot().read_bytes())).status() == psutil.STATUS_STOPPED)
    return False


def _locked(file: IO[bytes], shared: bool = False) -> bool:
    """Lock a file for as long as it is open; returns False where somebody else does."""
    try:
        fcntl.flock(file, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True
