"""Runs in processes of their own, so that nothing of one can reach the next: sweeps, and what the table lacks."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

import vprbench

IN_SWEEP = "VPRBENCH_IN_SWEEP"  # set for the runs of a sweep: they record even a failure that is the user's


def run_apart(overrides: Sequence[str], stdout: int | None = None) -> subprocess.CompletedProcess[str]:
    """Run one configuration with the command line of a new process, which ends when this one is told to."""
    home = str(Path(vprbench.__file__).resolve().parents[1])
    path = os.pathsep.join(filter(None, [home, os.environ.get("PYTHONPATH")]))
    before = signal.signal(signal.SIGTERM, _end)
    try:
        return subprocess.run(
            [sys.executable, "-m", "vprbench", *overrides],
            env={**os.environ, IN_SWEEP: "1", "PYTHONPATH": path},
            stdout=stdout,
            text=True,
            check=False,
        )
    finally:
        signal.signal(signal.SIGTERM, before)


def _end(number: int, _: object) -> NoReturn:
    """End this process by an exception, on which `subprocess.run` ends its child too."""
    raise SystemExit(128 + number)
