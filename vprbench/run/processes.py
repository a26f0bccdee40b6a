"""Runs in processes of their own: nothing of one reaches the next, and one that dies without a word is noticed."""

from __future__ import annotations

import contextlib
import io
import json
import os
import signal
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
from vprbench.run.gpus import free_gpu
from vprbench.run.watched import Watched
from vprbench.storage import owner
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
    held: str = ""  # the lock of another process that makes the run now: ask again once it is free


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

    `heard` is told, in a thread, each line that comes on its standard error, in place of this process's own. It works
    in `folder`, or where this process does. `since` is when the sweep began, in seconds by the clock of the disk: a run
    that failed elsewhere meanwhile has failed. A process that dies without a word is a failure: one line on standard
    error, and a record if it had begun a run. Signals reach the
    main thread alone, `stopped` any. Raises KeyboardInterrupt, with the signal, where this process was told to end.
    """
    if in_sweep:
        from vprbench.plugins.entries import as_asked

        arguments = [*map(as_asked, arguments)]
    with _slip() as left, _signals_passed_on() as (watched, signals):
        more = {IN_SWEEP: in_sweep and "1", MARKED: heard and "1", SINCE: since and repr(since), ending.FILE: str(left)}
        given = _environment({name: text for name, text in more.items() if text})
        command = [sys.executable, *_flags(), "-m", "vprbench", *arguments]
        stderr = subprocess.PIPE if heard else None

        def given_up() -> bool:
            if signals:
                raise KeyboardInterrupt(signals[0])
            return stopped is not None and stopped()

        with (
            free_gpu(arguments if in_sweep else (), given_up) as gpu,
            subprocess.Popen(command, env=given | gpu, stdout=stdout, stderr=stderr, cwd=folder) as child,
            _lines_passed_on(child.stderr, heard),
        ):
            watched.append(Watched(child, left))
            for number in signals:
                child.send_signal(number)
            code = watched[0].wait(stopped)
        words, died = ending.told(left), None
        if "code" not in words:
            died = None if signals else _dead(watched[0].words_on(code), words, heard)
            watched[0].tidy()
    if signals and (in_sweep or "code" not in words):
        raise KeyboardInterrupt(signals[0])
    known = {name: words[name] for name in Ending.__dataclass_fields__ if name in words}
    # what happens to a process after its last word changes nothing of what it has stored
    return died or Ending(**known)


def _environment(more: dict[str, str]) -> dict[str, str]:
    """Return the environment of a child, in which it finds this program."""
    path = os.pathsep.join(filter(None, [str(checkout_folder()), os.environ.get("PYTHONPATH")]))
    return {**os.environ, "PYTHONPATH": path, **more}


@contextlib.contextmanager
def scratch() -> Iterator[Path]:
    """Yield a temporary folder, removed in the end, and remove those that killed processes left behind."""
    ending = "-vprbench"
    remove_leftovers(Path(tempfile.gettempdir()), ending)
    begins = f"{PARTIAL}{owner.mark()}-"
    with tempfile.TemporaryDirectory(ending, begins, ignore_cleanup_errors=True) as folder:
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


def _dead(error: str, words: dict[str, Any], heard: Callable[[str], None] | None) -> Ending:
    """Say and record that a process ended without saying how."""
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
def _signals_passed_on() -> Iterator[tuple[list[Watched], list[int]]]:
    """Pass on to children what tells this process to end; yields where they are named, and the signals that came.

    An interruption that is repeated ends the children. One that follows at once is the same: a terminal interrupts all.
    Signals come to the main thread: in another one nothing is passed on.
    """
    watched: list[Watched] = []
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
