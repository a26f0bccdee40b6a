"""This process: which it is among those of all hosts, whether another one still lives, and the cores it may use."""

from __future__ import annotations

import contextlib
import functools
import getpass
import hashlib
import os
import socket
from pathlib import Path
from typing import Any


def this_process() -> dict[str, Any]:
    """Return what tells this process from all others, on whatever host."""
    return {**_host(), "process": os.getpid()}


@functools.cache
def _host() -> dict[str, str]:
    """Return whose processes these are, and where: host, and the system and container that know their numbers."""
    try:
        owner = getpass.getuser()
    except (OSError, KeyError):  # a container may know no name
        owner = str(os.getuid())
    host, numbers = socket.gethostname(), ""
    with contextlib.suppress(OSError):  # no Linux
        boot = Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
        numbers = f" {boot} {Path('/proc/self/ns/pid').readlink()}"
    return {"owner": owner, "host": host, "machine": host + numbers}


def started(process: int) -> int | None:
    """Return when a process started, by which it is told from a later one of its number; None if it has ended."""
    with contextlib.suppress(OSError, ValueError):
        fields = Path(f"/proc/{process}/stat").read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()
        return None if fields[0] in "ZX" else int(fields[19])
    return None


def mark() -> str:
    """Return a short name of this process, for the names of its unfinished files."""
    return _marked(os.getpid())


@functools.cache
def _marked(process: int) -> str:
    return f"{_number_of_host()}-{process}-{started(process) or 0}"


@functools.cache
def _number_of_host() -> str:
    return hashlib.sha256(_host()["machine"].encode()).hexdigest()[:8]


def is_dead(name: str) -> bool:
    """Tell whether a name begins with the mark of a process of this host that lives no more."""
    host, _, rest = name.partition("-")
    process, _, rest = rest.partition("-")
    moment = rest.partition("-")[0]
    if host != _number_of_host() or not (process.isdigit() and moment.isdigit()):
        return False
    try:
        os.kill(int(process), 0)
    except ProcessLookupError:
        return True
    except OSError:  # another user's
        return False
    return int(process) != os.getpid() and started(int(process)) != (int(moment) or None)


def cores() -> list[int]:
    """Return the numbers of the cores that this process may use; all cores if the system does not bind processes."""
    return sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else list(range(os.cpu_count() or 1))


def core_count() -> int:
    """Return how many cores this process may use, at least 1."""
    return len(cores())
