"""The lock on a run of a results folder: of many processes one makes the run, and the system frees the lock with it."""

from __future__ import annotations

import contextlib
import fcntl
import getpass
import hashlib
import json
import logging
import os
import re
import socket
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Self

from filelock import FileLock, Timeout

from vprbench.errors import BadInput
from vprbench.plugins.options import option

logger = logging.getLogger(__name__)

FOLDER = ".locks"  # within a results folder: a file for each run that is being made
_LOOK_EVERY = 0.5  # seconds between looks at a lock that is waited for
_CLAIM = ("method", "dataset", "seed", "device", "corruption", "owner", "host", "process", "since")
_STORED = {"runs": "*/[!.]*/run.json", "failures": "*/[!.]*/failure.json"}


class HeldElsewhereError(Exception):
    """Another process makes the run now."""

    def __init__(self, run: str, path: Path) -> None:
        """Name the run, and hold the file of its lock."""
        claim = _read_claim(path)
        super().__init__(f"{run} is being made by {claim['owner']} on {claim['host']} (process {claim['process']})")
        self.path = path


class RunLock:
    """The lock on one run; leave the block to free it."""

    def __init__(self, root: Path, run: str, about: Mapping[str, Any]) -> None:
        """Name the run of the results folder `root`, and its method, dataset, seed, device and corruption."""
        name = re.sub(r"[^A-Za-z0-9_-]+", "-", run)[-150:]  # the hash tells names apart that read alike
        name = f"{name}-{hashlib.sha256(run.encode(errors='surrogateescape')).hexdigest()[:8]}"
        self.path = root.absolute() / FOLDER / name  # a method may change the working folder
        self._lock = FileLock(self.path, thread_local=False)
        self._run, self._about = run, about

    def acquire(self, wait: bool = True) -> bool:
        """Take the lock, if need be once its holder has ended; returns False if another process holds it.

        Where nothing can be locked a warning says so, and the run is made all the same.
        """
        while True:
            try:
                self.path.parent.mkdir(parents=True, exist_ok=True)
                self._lock.acquire(blocking=wait, poll_interval=_LOOK_EVERY)
                break
            except Timeout:
                return False
            except FileNotFoundError:  # another process has just removed the folder
                continue
            except OSError as error:
                reason = error.strerror or error
                logger.warning("%s cannot be locked (%s): another process may make it too", self._run, reason)
                return True
        since = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
        claim = {"owner": _read_user(), "host": socket.gethostname(), "process": os.getpid(), "since": since}
        with contextlib.suppress(OSError):
            self.path.write_text(json.dumps({**self._about, **claim}), encoding="utf-8")
        return True

    def __enter__(self) -> Self:
        """Hold the lock, which was acquired."""
        return self

    def __exit__(self, *_: object) -> None:
        """Free the lock, and leave no file."""
        if self._lock.is_locked:
            with contextlib.suppress(OSError):
                self.path.unlink()  # a process that has opened it meanwhile sees that it is gone, and opens another
        self._lock.release()
        with contextlib.suppress(OSError):
            self.path.parent.rmdir()


def read_claims(root: Path) -> list[dict[str, Any]]:
    """Return the runs of a results folder that processes make now, as plain values, the oldest first."""
    claims = [_read_claim(path) for path in _list_locks(root) if is_held(path)]
    return sorted(claims, key=lambda claim: str(claim["since"]))


def remove_leftovers(root: Path) -> None:
    """Remove the files of locks that nobody holds: their holders were killed."""
    for path in _list_locks(root):
        lock = FileLock(path)
        with contextlib.suppress(OSError, Timeout), lock.acquire(blocking=False):
            path.unlink()
    with contextlib.suppress(OSError):
        (root / FOLDER).rmdir()


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


def _list_locks(root: Path) -> list[Path]:
    with contextlib.suppress(OSError):
        return sorted((root / FOLDER).iterdir())
    return []


def _read_claim(path: Path) -> dict[str, Any]:
    """Return the claim of a holder; None for each part that it lacks, or while it is written."""
    claim = None
    with contextlib.suppress(OSError, ValueError):
        claim = json.loads(path.read_bytes())
    return {name: claim.get(name) if isinstance(claim, dict) else None for name in _CLAIM}


def _read_user() -> str:
    try:
        return getpass.getuser()
    except (OSError, KeyError):  # a container may know no name
        return str(os.getuid())


@dataclass(frozen=True)
class StatusOptions:
    """Where to look."""

    results: str = option("results")
    output: Literal["row", "json"] = option("row", "or json: one object")
    wide: bool = option(False, "true: all columns, however narrow the terminal")


def status(results: str) -> dict[str, Any]:
    """Return what a results folder holds and who works on it, as plain values; raises BadInput if there is none."""
    root = Path(results).expanduser()
    if not root.is_dir():
        raise BadInput(f"results={results} is no folder: give the folder of a run, a table or a comparison")
    stored = {
        kind: sum(not path.parent.parent.name.startswith(".") for path in root.glob(pattern))
        for kind, pattern in _STORED.items()
    }
    return {"results": str(root), **stored, "claims": read_claims(root)}


def row(claim: Mapping[str, Any]) -> dict[str, str]:
    """Return a run that is being made as the cells of a line, by their columns."""
    words = {name: "?" if value is None else str(value) for name, value in claim.items()}
    on = "" if claim["corruption"] is None else f", {words['corruption']}"
    columns = ("host", "process", "since", "seed", "device", "owner")
    return {"run": f"{words['method']} on {words['dataset']}{on}", **{name: words[name] for name in columns}}
