"""The cores that this process may use."""

from __future__ import annotations

import os


def cores() -> list[int]:
    """Return the numbers of the cores that this process may use; all cores if the system does not bind processes."""
    return sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else list(range(os.cpu_count() or 1))


def core_count() -> int:
    """Return how many cores this process may use, at least 1."""
    return len(cores())
