"""What a process leaves for the one that waits for it: what it set out to do, and how it ended."""

from __future__ import annotations

import contextlib
import functools
import json
import os
from pathlib import Path
from typing import Any

FILE = "VPRBENCH_ENDING"  # the environment variable that names the file, for a process that is waited for


def waited_for() -> bool:
    """Tell whether another process waits for the word of this one."""
    return _place()[0] is not None


def tell(**words: Any) -> None:
    """Add plain values to what this process leaves; nothing if nobody waits, or in a fork of this process."""
    path, process = _place()
    if path is not None and os.getpid() == process:
        with contextlib.suppress(OSError), Path(path).open("a", encoding="utf-8") as file:
            file.write(json.dumps(words) + "\n")


def heard() -> bool:
    """Tell whether the process that waits for this one is still there, where its file goes with it."""
    path, _ = _place()
    return path is not None and Path(path).parent.exists()


def told(path: Path) -> dict[str, Any]:
    """Return all that a process left in `path`; of what it said twice the last."""
    words: dict[str, Any] = {}
    for line in path.read_text(encoding="utf-8").splitlines() if path.exists() else ():
        with contextlib.suppress(ValueError):  # a process may die while it writes
            words |= json.loads(line)
    return words


def leave_if_forked(process: int) -> None:
    """End this process if it is a fork of `process`, whose answer would be a second one."""
    if os.getpid() != process:
        os._exit(0)


@functools.cache
def _place() -> tuple[str | None, int]:
    """Return the file and the process whose word it is; what this process starts does not inherit it."""
    return os.environ.pop(FILE, None), os.getpid()
