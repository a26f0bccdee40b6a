"""Which process on which host this is, and whether another one of the same host still lives."""

from __future__ import annotations

import contextlib
import functools
import getpass
import os
import socket
from pathlib import Path
from typing import Any


def this_process() -> dict[str, Any]:
    """Return what tells this process from all others, on whatever host."""
    process = os.getpid()
    return {**_host(), "process": process, "parent": os.getppid(), "started": _started(process)}


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


def _started(process: int) -> int | None:
    """Return when a process started, by which it is told from a later one of its number; None if it has ended."""
    with contextlib.suppress(OSError, ValueError):
        fields = Path(f"/proc/{process}/stat").read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()
        return None if fields[0] in "ZX" else int(fields[19])
    return None


def lives(process: Any, started: Any) -> bool | None:
    """Tell whether a process of this host, which started at that time, lives; None if that cannot be told, as of another user's."""
    if os.name != "posix" or not isinstance(process, int) or process < 1:
        return None
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return None
    return bool(_started(process) == started)
