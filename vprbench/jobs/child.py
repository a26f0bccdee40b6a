"""A run in a process of its own: nothing of one run reaches the next, and a process that dies is a failure."""

from __future__ import annotations

import contextlib
import faulthandler
import functools
import json
import math
import multiprocessing
import os
import re
import signal
import sys
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from multiprocessing import forkserver, resource_tracker
from multiprocessing.context import ForkServerContext, ForkServerProcess
from pathlib import Path
from threading import Thread
from types import FrameType
from typing import IO, NoReturn

from vprbench.jobs.job import JobResult, make_run
from vprbench.progress import QUIET
from vprbench.runs import timing_lock
from vprbench.runs.request import RunRequest
from vprbench.runs.store import Store
from vprbench.storage.atomic import scratch
from vprbench.storage.folders import checkout_folder
from vprbench.terminal.streams import log_to_stderr, results_only_on_stdout
from vprbench.text import printable

_REQUEST, _RESULT, _STDERR = "request.json", "result.json", "stderr"  # files of a child's folder
_LOOK_EVERY = 0.1  # seconds
_PATIENCE = 20.0  # seconds that an interrupted process has to end
_N_LINES = 200  # last lines of standard error, among which a crash names its place
_CRASH_SITE = re.compile(r'\s*File "[^"]*", line \d+ in ')  # of faulthandler; a traceback has a comma before "in"
_PRELOADED = [
    "torch",
    "numba",
    "hydra.utils",
    "vprbench.jobs.child",
    "vprbench.runs.get_or_run",
    "vprbench.methods.parts.filters.patches_compiled",
]


def run_in_child(
    request_json: str,
    hear: Callable[[str], None] | None = None,
    stopped: Callable[[], bool] = lambda: False,
    folder: str | None = None,
    environment: Mapping[str, str] | None = None,
) -> JobResult:
    """Make a run in a new process, which ends with this one.

    Args:
        request_json: the run, as `RunRequest.to_json` gives it.
        hear: takes each line of the process's standard error, which shows no progress; None prints the lines.
        stopped: returns True once the process has to be interrupted.
        folder: the working folder of the process; None for this one's.
        environment: more variables of its environment.

    Returns:
        The outcome. A process that dies is a failure with its exit code or signal, and its last line.

    Raises:
        KeyboardInterrupt: this process was interrupted; the child has ended before.
    """
    request = RunRequest.from_json(request_json)
    with scratch() as place, (place / _STDERR).open("wb"), (place / _STDERR).open("rb") as written:
        (place / _REQUEST).write_text(request_json, encoding="utf-8")
        lines = _Lines(written, hear or _echo)
        variables = {**os.environ, **(environment or {}), **({QUIET: "1"} if hear else {})}
        child = _warm_context().Process(target=make_job, args=(place, folder, variables), daemon=True)
        code = _follow(child, lines, request.limit_minutes, stopped)
        with contextlib.suppress(FileNotFoundError):
            return JobResult(**json.loads((place / _RESULT).read_text(encoding="utf-8")))
    Store(Path(request.results).expanduser()).remove_leftovers()
    limit = f"was not done after limit_minutes={request.limit_minutes}"
    error = limit if code is None else _describe_death(code, lines.last)
    lines.hear(printable(f"vprbench: {request.method_name} {error}"))
    return JobResult(1, error)


def make_job(place: Path, folder: str | None, environment: Mapping[str, str]) -> NoReturn:
    """Make the run of a child's folder in this process, leave its outcome there, and end at once.

    A plug-in may have started threads and processes, which the interpreter would wait for.
    """
    try:
        stderr = os.open(place / _STDERR, os.O_WRONLY | os.O_APPEND)
    except FileNotFoundError:  # the process that wanted the run was interrupted before it knew of this one
        os._exit(1)
    os.dup2(stderr, 1)
    os.dup2(stderr, 2)
    os.setpgid(0, 0)  # the processes that a plug-in starts end with this one
    Thread(target=_end_with_parent, daemon=True).start()
    multiprocessing.current_process().daemon = False  # a plug-in may start processes
    os.environ.clear()
    os.environ.update(environment)
    if folder is not None:
        os.chdir(folder)
    faulthandler.enable(2, all_threads=False)  # a crash names the line of the plug-in
    signal.signal(signal.SIGINT, _interrupt_once)
    try:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
        log_to_stderr()
        printed: list[str] = []
        with timing_lock.computing(), results_only_on_stdout():
            request = RunRequest.from_json((place / _REQUEST).read_bytes())
            result = make_run(request, printed.append, wait=False)
        partial = place / f"{_RESULT}.partial"
        partial.write_text(replace(result, printed="\n".join(printed)).to_json(), encoding="utf-8")
        partial.rename(place / _RESULT)
        code = result.code
    except KeyboardInterrupt:
        code = 128 + signal.SIGINT
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError):
            stream.flush()
    os._exit(code)


class _Lines:
    """The lines that a process writes to a file, as they come; a pipe would stay open with the process's children."""

    def __init__(self, file: IO[bytes], hear: Callable[[str], None]) -> None:
        """Read from `file`, and give each line to `hear`."""
        self.hear = hear
        self.last: deque[str] = deque(maxlen=_N_LINES)
        self._file, self._rest = file, b""

    def pass_on(self, ended: bool = False) -> None:
        """Pass on the lines that are whole, or all if the process has ended."""
        *lines, self._rest = (self._rest + self._file.read()).split(b"\n")
        if ended and self._rest:
            lines, self._rest = [*lines, self._rest], b""
        for line in lines:
            self.last.append(line.decode("utf-8", "replace"))
            self.hear(self.last[-1])


@functools.cache
def _warm_context() -> ForkServerContext:
    """Return the context of a server that has imported libraries of runs and forks a process for each.

    The server has started no thread, and SIGINT is blocked in it: an interruption waits until the run handles it.
    """
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(_PRELOADED)
    python_path = os.pathsep.join(filter(None, [str(checkout_folder()), os.environ.get("PYTHONPATH")]))
    before = dict(os.environ)
    resource_tracker.ensure_running()  # or the server starts it, which unblocks SIGINT
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        os.environ |= {"OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": python_path, "PYTHONSAFEPATH": "1"}
        forkserver.ensure_running()
    finally:
        os.environ.clear()
        os.environ.update(before)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    return context


def _follow(
    child: ForkServerProcess, lines: _Lines, limit_minutes: float | None, stopped: Callable[[], bool]
) -> int | None:
    """Start a process, pass on its lines until it ends; returns its exit code, None if it was killed at its limit."""
    ends = math.inf if limit_minutes is None else time.monotonic() + 60 * limit_minutes
    try:
        child.start()
        while child.is_alive():
            lines.pass_on()
            if stopped():
                _interrupt(child)
            elif time.monotonic() > ends:
                return None
            child.join(_LOOK_EVERY)
    except KeyboardInterrupt:
        _interrupt(child)
        raise
    finally:
        if child.pid is not None:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(child.pid, signal.SIGKILL)  # with the processes that a plug-in has started
            child.kill()
            child.join()
        lines.pass_on(ended=True)
    return child.exitcode


def _interrupt(child: ForkServerProcess) -> None:
    """Interrupt a process, and kill it if it does not end."""
    if child.pid is not None:
        with contextlib.suppress(ProcessLookupError):
            os.kill(child.pid, signal.SIGINT)
        child.join(_PATIENCE)
        child.kill()


def _interrupt_once(_: int, __: FrameType | None) -> NoReturn:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    raise KeyboardInterrupt


def _end_with_parent() -> None:
    """End this process and its children once the process that wants the run has ended."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os.killpg(0, signal.SIGKILL)


def _describe_death(code: int, lines: Iterable[str]) -> str:
    """Say how a process that left no result has ended, with the place that a crash names, or its last line."""
    said = [line.strip() for line in lines if line.strip()]
    last = next(filter(_CRASH_SITE.match, said), said[-1] if said else "")
    last = last and f": {last}"
    if code >= 0:
        return f"ended without a result, with exit code {code}{last}"
    memory = ", as for want of memory" if -code == signal.SIGKILL else ""
    return f"was ended by signal {-code} ({signal.Signals(-code).name}){memory}{last}"


def _echo(line: str) -> None:
    with contextlib.suppress(OSError, ValueError):
        print(line, file=sys.stderr, flush=True)
