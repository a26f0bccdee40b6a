"""Runs in processes of their own, so that nothing of one can reach the next: sweeps, and what the table lacks."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import vprbench

IN_SWEEP = "VPRBENCH_IN_SWEEP"  # set for the runs of a sweep: they record even a failure that is the user's


def run_apart(overrides: Sequence[str], stdout: int | None = None) -> subprocess.CompletedProcess[str]:
    """Run one configuration with the command line of a new process."""
    home = str(Path(vprbench.__file__).resolve().parents[1])
    path = os.pathsep.join(filter(None, [home, os.environ.get("PYTHONPATH")]))
    return subprocess.run(
        [sys.executable, "-m", "vprbench", *overrides],
        env={**os.environ, IN_SWEEP: "1", "PYTHONPATH": path},
        stdout=stdout,
        text=True,
        check=False,
    )
