"""Looks after a process while it runs: its limit, its claim, its stops while another is timed, and what it leaves."""

from __future__ import annotations

import contextlib
import json
import math
import os
import signal
import socket
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from vprbench import ending
from vprbench.run import claims, slot
from vprbench.storage.atomic import PARTIAL, remove_leftovers


class Watched:
    """A child that is looked after while it runs: its limit of time, and the timing of other cells of this host."""

    def __init__(self, child: subprocess.Popen[bytes], left: Path, cell: bool) -> None:
        """Look after a child that leaves its words in `left`; `cell`: it makes a run, whatever it says."""
        self._child, self._left, self._cell = child, left, cell
        self._place = slot.Place(child.pid)
        self._kills, self._beat = _oom_kills(), 0.0
        self._stopped, self._since = 0.0, math.inf  # seconds in all before, and the moment of the stop that lasts
        self.late = self._ends = False

    def wait(self, stopped: Callable[[], bool] | None = None) -> int:
        """Return the exit code of the child once it has ended; it is interrupted as soon as `stopped` says so."""
        try:
            while True:
                self._look()
                if stopped is not None and stopped():
                    self.end_by(signal.SIGINT)  # at each look: it may begin only now to listen, and listens once
                with contextlib.suppress(subprocess.TimeoutExpired):
                    return self._child.wait(slot.LOOK_EVERY)
        finally:
            self._place.end()

    def words_on(self, code: int) -> str:
        """Say how a child that has said nothing itself has ended."""
        if self.late:
            return f"was not done after limit_minutes={ending.told(self._left)['limit_minutes']}"
        if code >= 0:
            return f"ended without a word, with exit code {code}"
        memory = _memory_words(self._kills) if -code == signal.SIGKILL else ""
        return f"was ended by signal {-code} ({signal.Signals(-code).name}){memory}"

    def tidy(self) -> None:
        """Take away the claim and the unfinished files of a child that is dead and could not do so."""
        words = ending.told(self._left)
        if "claim" in words:
            claims.clear(words["claim"])
        if "results" in words:
            for folder in {path.parent for path in Path(words["results"]).rglob(f"{PARTIAL}*")}:
                remove_leftovers(folder)

    def _look(self) -> None:
        words, now = ending.told(self._left), time.monotonic()
        allowed = words.get("until", math.inf) + words.get("queued", 0.0) + self._stopped + max(0.0, now - self._since)
        if now > allowed:
            self.late = True
            self._child.kill()
        if "claim" in words and now - self._beat >= claims.BEAT_SECONDS:
            self._beat = now
            claims.beat(words["claim"])
        if self._cell or "run" in words:
            self._give_way(words)

    def _give_way(self, words: dict[str, Any]) -> None:
        """Stop the child while another cell is timed, once its end is bound to that of this process."""
        if words.get("timing"):
            self._place.leave()
            self._go_on()
        elif self._since == math.inf or not slot.taken():
            self._place.enter()  # before the look: who has just taken the slot sees it, or is seen
            if self._ends or not (words.get("bound") and slot.taken()):
                self._go_on()
            elif self._since == math.inf:
                self._since = time.monotonic()
                self._child.send_signal(signal.SIGSTOP)
                self._place.leave()

    def _go_on(self) -> None:
        """Continue the child if it was stopped, which is told for how long."""
        if self._since < math.inf:
            self._stopped += time.monotonic() - self._since
            self._since = math.inf
            with contextlib.suppress(OSError), self._left.open("a", encoding="utf-8") as file:
                file.write(json.dumps({"stopped": self._stopped}) + "\n")
            self._child.send_signal(signal.SIGCONT)

    def end_by(self, number: signal.Signals) -> None:
        """Send a signal that ends the child, even if it is stopped."""
        self._ends = True
        self._child.send_signal(number)
        self._child.send_signal(signal.SIGCONT)


def _memory_words(before: dict[str, int]) -> str:
    """Say whether the system has ended a process for want of memory since it had ended so many."""
    for path, count in _oom_kills().items():
        if count > before.get(path, count):
            return f": out of memory on {socket.gethostname()} (oom_kill of {path} went from {before[path]} to {count})"
    return ": not for want of memory, no such kill was counted" if before else ", as for want of memory"


def _oom_kills() -> dict[str, int]:
    """Return how many processes the system has ended for want of memory, by the file that counts them."""
    own = [line.split(":", 2)[2].strip() for line in _lines("/proc/self/cgroup")]
    v2 = [f"/sys/fs/cgroup{group}/memory.events" for group in own]
    v1 = [f"/sys/fs/cgroup/memory{group}/memory.oom_control" for group in own]
    files = (os.path.normpath(path) for path in (*v2, *v1, "/proc/vmstat"))
    counts = {path: line.split() for path in files for line in _lines(path) if line.startswith("oom_kill ")}
    return {path: int(count) for path, (_, count) in counts.items()}


def _lines(path: str) -> list[str]:
    with contextlib.suppress(OSError):
        return Path(path).read_text(encoding="utf-8").splitlines()
    return []
