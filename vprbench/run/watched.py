"""Looks after a process while it runs: its limit of time, and what it leaves."""

from __future__ import annotations

import contextlib
import math
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

from vprbench import ending
from vprbench.run import run_lock
from vprbench.storage.atomic import PARTIAL, remove_leftovers

_LOOK_EVERY = 0.1  # seconds


class Watched:
    """A child that is looked after while it runs."""

    def __init__(self, child: subprocess.Popen[bytes], left: Path) -> None:
        """Look after a child that leaves its words in `left`."""
        self._child, self._left = child, left
        self.late = False

    def wait(self, stopped: Callable[[], bool] | None = None) -> int:
        """Return the exit code of the child once it has ended; it is interrupted as soon as `stopped` says so."""
        while True:
            self._look()
            if stopped is not None and stopped():
                self._child.send_signal(signal.SIGINT)  # at each look: it may begin only now to listen
            with contextlib.suppress(subprocess.TimeoutExpired):
                return self._child.wait(_LOOK_EVERY)

    def words_on(self, code: int) -> str:
        """Say how a child that has said nothing itself has ended."""
        if self.late:
            return f"was not done after limit_minutes={ending.told(self._left)['limit_minutes']}"
        if code >= 0:
            return f"ended without a word, with exit code {code}"
        memory = ", as for want of memory" if -code == signal.SIGKILL else ""
        return f"was ended by signal {-code} ({signal.Signals(-code).name}){memory}"

    def tidy(self) -> None:
        """Remove the lock and the unfinished files of a child that is dead and could not do so."""
        words = ending.told(self._left)
        if "results" in words:
            results = Path(words["results"])
            run_lock.remove_leftovers(results)
            for folder in {path.parent for path in results.rglob(f"{PARTIAL}*")}:
                remove_leftovers(folder)

    def end_by(self, number: signal.Signals) -> None:
        """Send a signal that ends the child."""
        self._child.send_signal(number)

    def _look(self) -> None:
        if time.monotonic() > ending.told(self._left).get("until", math.inf):
            self.late = True
            self._child.kill()
