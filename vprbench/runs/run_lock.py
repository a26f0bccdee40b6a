"""The lock on a run of a results folder: of many processes one makes the run, and the system frees the lock with it."""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import json
import logging
import os
import socket
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

logger = logging.getLogger(__name__)

FOLDER = ".locks"  # within a results folder: a file for each run that was made there
_LOOK_EVERY = 0.5  # seconds between looks at a lock that is waited for
_CLAIM = ("method", "dataset", "seed", "device", "corruption", "owner", "host", "process", "since")


class HeldElsewhereError(Exception):
    """Another process makes the run now."""

    def __init__(self, path: Path) -> None:
        """Name the run and its process, and hold the file of the lock."""
        self.path, claim = path, _read_claim(path)
        by = f"{claim['owner']} on {claim['host']} (process {claim['process']})"
        super().__init__(f"{claim['method']} on {claim['dataset']} is being made by {by}")


@contextlib.contextmanager
def lock_run(root: Path, run: str, about: Mapping[str, Any], wait: bool = True) -> Iterator[None]:
    """Hold the lock on a run inside the block; where nothing can be locked a warning says so.

    `root` is the results folder, as an absolute path, and `run` the folder of the run within it. `about` is its method,
    dataset, seed, device and corruption, for `read_claims`. Raises HeldElsewhereError if another process holds the lock
    and this one is not to wait.
    """
    path = root / FOLDER / hashlib.sha256(run.encode(errors="surrogateescape")).hexdigest()[:32]
    lock = FileLock(path, thread_local=False)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            lock.acquire(blocking=False)
        except Timeout:
            error = HeldElsewhereError(path)
            if not wait:
                raise error from None
            logger.info("%s: waiting for it", error)
            lock.acquire(poll_interval=_LOOK_EVERY)
        holder = {"owner": os.environ.get("USER") or str(os.getuid()), "host": socket.gethostname()}
        since = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
        claim = {**about, **holder, "process": os.getpid(), "since": since}
        path.write_text(json.dumps(claim), encoding="utf-8")
    except OSError as error:
        logger.warning("%s cannot be locked (%s): another process may make it too", run, error.strerror or error)
    try:
        yield
    finally:
        lock.release()


def read_claims(root: Path) -> list[dict[str, Any]]:
    """Return the runs of a results folder that processes make now, as plain values, the oldest first."""
    claims = [_read_claim(path) for path in sorted((root / FOLDER).glob("*")) if is_held(path)]
    return sorted(claims, key=lambda claim: str(claim["since"]))


def is_held(path: Path | str) -> bool:
    """Tell whether a process holds this lock: once it does not, its run is stored, or free to be made."""
    try:
        with Path(path).open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:  # it is gone
        return False
    return False


def _read_claim(path: Path) -> dict[str, Any]:
    """Return the claim of a holder; None for each part that it lacks, or while it is written."""
    claim = None
    with contextlib.suppress(OSError, ValueError):
        claim = json.loads(path.read_bytes())
    return {name: claim.get(name) if isinstance(claim, dict) else None for name in _CLAIM}
