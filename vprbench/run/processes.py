"""Runs in processes of their own: nothing of one reaches the next, and one that dies without a word is noticed."""

from __future__ import annotations

import contextlib
import io
import json
import math
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from threading import Thread, current_thread, main_thread
from typing import IO, TYPE_CHECKING, Any, cast

from vprbench import ending
from vprbench.errors import BadInput
from vprbench.progress import MARKED
from vprbench.run import slot
from vprbench.storage.atomic import PARTIAL, remove_leftovers
from vprbench.storage.folders import checkout_folder
from vprbench.text import printable

if TYPE_CHECKING:
    from vprbench.run.record import Failure

IN_SWEEP = "VPRBENCH_IN_SWEEP"  # set for the runs of a sweep: they record even a failure that is the user's
SINCE = "VPRBENCH_SWEEP_SINCE"  # and when it began: what another process failed at since then is not tried again
_PATIENCE = 1.0  # seconds after which a second interruption ends what the first did not


@dataclass(frozen=True)
class Ending:
    """How one process ended."""

    code: int  # 0: all that was asked for is stored
    missing: bool = False  # method, weights or frames are not there
    error: str = ""
    recorded: bool = False  # whether the store knows of the error
    key: str = ""  # of the run that is stored
    held: str = ""  # the claim of another process that makes the run now: ask again once it is gone


def run_apart(
    arguments: Sequence[str],
    stdout: int | None = None,
    in_sweep: bool = True,
    heard: Callable[[str], None] | None = None,
    stopped: Callable[[], bool] | None = None,
    folder: str | None = None,
    since: float | None = None,
) -> Ending:
    """Run the command line in a new process, which ends with this one; returns how it ended.

    `heard` is told, in a thread, each line that comes on its standard error, in place of this process's own. Once
    `stopped` says so it is interrupted. It works in `folder`; None: where this process does. `since` is when the sweep
    began, in seconds by the clock of the disk: a run that failed elsewhere meanwhile has failed.
    A process that dies without a word is a failure: one line on standard error, and a record if it had begun a run.
    Any thread may wait so, but signals reach the main thread alone. The process is stopped while another cell of this
    host is timed. Raises KeyboardInterrupt, with the signal, where this process was told to end meanwhile.
    """
    if in_sweep:
        from vprbench.plugins.entries import as_asked

        arguments = [*map(as_asked, arguments)]
    home = str(checkout_folder())
    path = os.pathsep.join(filter(None, [home, os.environ.get("PYTHONPATH")]))
    with _slip() as left, _signals_passed_on() as (watched, signals):
        given = {**os.environ, "PYTHONPATH": path, ending.FILE: str(left)} | ({IN_SWEEP: "1"} if in_sweep else {})
        given |= ({MARKED: "1"} if heard else {}) | ({} if since is None else {SINCE: repr(since)})
        command = [sys.executable, *_flags(), "-m", "vprbench", *arguments]
        stderr = subprocess.PIPE if heard else None
        while in_sweep and slot.taken() and not signals and not (stopped and stopped()):
            time.sleep(slot.LOOK_EVERY)
        kills = oom_kills()
        with (
            subprocess.Popen(command, env=given, stdout=stdout, stderr=stderr, cwd=folder) as child,
            _lines_passed_on(child.stderr, heard),
        ):
            watched.append(_Watched(child, left, in_sweep))
            for number in signals:
                child.send_signal(number)
            code = watched[0].wait(stopped)
        words = ending.told(left)
    if signals and (in_sweep or "code" not in words):
        raise KeyboardInterrupt(signals[0])
    if "code" not in words:
        return _dead(code, words, watched[0].late, kills, heard)
    known = {name: words[name] for name in Ending.__dataclass_fields__ if name in words}
    return Ending(**known)  # what happens to a process after its last word changes nothing of what it has stored


class _Watched:
    """A child that is looked after while it runs: its limit of time, and the timing of other cells of this host."""

    def __init__(self, child: subprocess.Popen[bytes], left: Path, cell: bool) -> None:
        """Look after a child that leaves its words in `left`; `cell`: it makes a run, whatever it says."""
        self._child, self._left, self._cell = child, left, cell
        self._place = slot.Place(child.pid)
        self._stopped, self._since = 0.0, math.inf  # seconds in all before, and the moment of the stop that lasts
        self.late = self._ends = False

    def wait(self, stopped: Callable[[], bool] | None = None) -> int:
        """Return the exit code of the child once it has ended; it is interrupted as soon as `stopped` says so."""
        try:
            while True:
                self._look()
                if stopped is not None and stopped() and not self._ends:
                    self.end_by(signal.SIGINT)
                with contextlib.suppress(subprocess.TimeoutExpired):
                    return self._child.wait(slot.LOOK_EVERY)
        finally:
            self._place.end()

    def _look(self) -> None:
        words, now = ending.told(self._left), time.monotonic()
        allowed = words.get("until", math.inf) + words.get("queued", 0.0) + self._stopped + max(0.0, now - self._since)
        if now > allowed:
            self.late = True
            self._child.kill()
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


def oom_kills() -> dict[str, int]:
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


@contextlib.contextmanager
def scratch() -> Iterator[Path]:
    """Yield a temporary folder, removed in the end, and remove those that killed processes left behind."""
    ending = "-vprbench"
    remove_leftovers(Path(tempfile.gettempdir()), ending)
    with tempfile.TemporaryDirectory(prefix=PARTIAL, suffix=ending, ignore_cleanup_errors=True) as folder:
        yield Path(folder)


def record(failure: Failure, root: Path) -> None:
    """Store a failure, where that is possible: the error itself is told in any case."""
    from vprbench.run.store import Store

    with contextlib.suppress(OSError, BadInput):
        root.mkdir(parents=True, exist_ok=True)
        Store(root).save_failure(failure)


def as_json(failure: Failure) -> str:
    """Return what a reader of JSON is told of a failure."""
    return json.dumps({name: getattr(failure, name) for name in ("method", "dataset", "error", "missing")})


def _dead(
    code: int, words: dict[str, Any], late: bool, kills: dict[str, int], heard: Callable[[str], None] | None
) -> Ending:
    """Say and record that a process ended without saying how; `kills` were counted before it began."""
    error = f"ended without a word, with exit code {code}"
    if late:
        error = f"was not done after limit_minutes={words['limit_minutes']}"
    elif code < 0:
        error = f"was ended by signal {-code} ({signal.Signals(-code).name})"
        if -code == signal.SIGKILL:
            error += _memory_words(kills)
    if words.get("doing"):
        error += f" while {words['doing']}"
    run = words.get("run")
    whose = "the command" if run is None else f"{run['method']} on {run['dataset']}"
    line = printable(f"vprbench: {whose} {error}")
    with contextlib.suppress(OSError):
        heard(line) if heard else print(line, file=sys.stderr, flush=True)
    if run is None:
        return Ending(1, False, error)
    from vprbench.run import machine
    from vprbench.run.record import Failure

    failure = Failure(**run, error=error, environment=machine.capture("cpu", words["threads"]))
    record(failure, Path(words["results"]))
    if words["output"] == "json":
        print(as_json(failure), flush=True)
    return Ending(1, False, error, recorded=True)


def _memory_words(before: dict[str, int]) -> str:
    """Say whether the system has ended a process for want of memory since it had ended so many."""
    for path, count in oom_kills().items():
        if count > before.get(path, count):
            return f": out of memory on {socket.gethostname()} (oom_kill of {path} went from {before[path]} to {count})"
    return ": not for want of memory, no such kill was counted" if before else ", as for want of memory"


def _flags() -> list[str]:
    """Return the options of the interpreter that this program was started with."""
    own = [at for at, pair in enumerate(pairwise(sys.orig_argv)) if pair == ("-m", "vprbench")]
    return sys.orig_argv[1 : own[0]] if own else ["-P"]  # a program that does not look for modules in its folder


@contextlib.contextmanager
def _slip() -> Iterator[Path]:
    """Yield the file for the last words of a child; if the system can, one that no kill of this process leaves."""
    with tempfile.TemporaryFile() as nameless:
        path = Path(f"/proc/{os.getpid()}/fd/{nameless.fileno()}")
        if path.exists():
            yield path
            return
    with scratch() as folder:
        yield folder / "ending"


@contextlib.contextmanager
def _lines_passed_on(stream: IO[bytes] | None, heard: Callable[[str], None] | None) -> Iterator[None]:
    """Tell each line of a child's standard error, where it is read, to `heard`."""

    def read() -> None:
        with contextlib.suppress(ValueError, OSError):  # it is closed while it is read
            for line in io.TextIOWrapper(cast(IO[bytes], stream), encoding="utf-8", errors="replace"):
                cast(Callable[[str], None], heard)(line.rstrip("\n"))

    reader = Thread(target=read, daemon=True)
    if stream is not None and heard is not None:
        reader.start()
    yield
    if reader.ident is not None:
        reader.join(_PATIENCE)  # a process that the child has left behind may hold its standard error


@contextlib.contextmanager
def _signals_passed_on() -> Iterator[tuple[list[_Watched], list[int]]]:
    """Pass on to children what tells this process to end; yields where they are named, and the signals that came.

    An interruption that is repeated ends the children. One that follows at once is the same: a terminal interrupts all.
    Signals come to the main thread: in another one nothing is passed on.
    """
    watched: list[_Watched] = []
    signals: list[int] = []
    moments: list[float] = []

    def pass_on(number: int, _: object) -> None:
        signals.append(number)
        moments.append(time.monotonic())
        for each in watched:
            each.end_by(signal.SIGKILL if moments[-1] - moments[0] > _PATIENCE else signal.Signals(number))

    handled = (signal.SIGTERM, signal.SIGINT) if current_thread() is main_thread() else ()
    before = {number: signal.signal(number, pass_on) for number in handled}
    try:
        yield watched, signals
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
