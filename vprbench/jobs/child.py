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
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from multiprocessing import forkserver, resource_tracker
from multiprocessing.connection import wait
from multiprocessing.context import ForkServerContext, ForkServerProcess
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Lock, Thread
from typing import IO, NoReturn

from vprbench.jobs.job import JobResult, describe_failure, make_run
from vprbench.progress import QUIET
from vprbench.runs.record import Failure
from vprbench.runs.request import RunRequest
from vprbench.runs.timing_lock import share_host
from vprbench.storage.atomic import replace_text
from vprbench.storage.folders import checkout_folder
from vprbench.terminal.streams import log_to_stderr, results_only_on_stdout
from vprbench.text import escape_unprintable

_RESULT, _STDERR = "result.json", "stderr"  # files of a child's folder
_LOOK_EVERY = 0.1  # seconds
_PATIENCE = 20.0  # seconds that an interrupted process has to end
_CRASH_SITE = re.compile(r'\s*File "[^"]*", line \d+ in ')  # of faulthandler; a traceback has a comma before "in"
_PRELOADED = ["torch", "numba", "hydra.utils", "vprbench.jobs.child", "vprbench.runs.get_or_run"]
_PRELOADED += ["vprbench.methods.parts.filters.patches"]

_starting = Lock()  # multiprocessing starts and ends processes in one thread at a time


def run_in_child(
    request_json: str,
    is_shown: bool = True,
    stopped: Callable[[], bool] = lambda: False,
    environment: Mapping[str, str] | None = None,
) -> JobResult:
    """Make a run in a new process, which ends with this one.

    Args:
        request_json: the run, as `RunRequest.to_json` gives it.
        is_shown: whether the process's standard error, with its progress, is printed as it comes.
        stopped: returns True once the run has to be interrupted.
        environment: more variables of its environment.

    Returns:
        The outcome, with the lines of standard error that were not printed. A process that dies is a failure with its
        exit code or signal, and its last line.

    Raises:
        KeyboardInterrupt: this process was interrupted, or the run was stopped; the child has ended before.
    """
    request, lines = RunRequest.from_json(request_json), list[str]()

    def note(line: str) -> None:
        lines.append(line)
        if is_shown:
            print_child_line(line)

    with TemporaryDirectory(prefix="vprbench-", ignore_cleanup_errors=True) as folder:
        place = Path(folder)
        (place / _STDERR).touch()
        with _starting:
            variables = {**os.environ, **(environment or {}), **({} if is_shown else {QUIET: "1"})}
            child = start_server().Process(target=make_job, args=(request_json, place, variables), daemon=True)
            child.start()
        code = _follow_process(child, place / _STDERR, note, request.limit_minutes, stopped)
        if (place / _RESULT).exists():
            content = json.loads((place / _RESULT).read_bytes())
            failure = content.pop("failure")
            result = JobResult(**content, failure=failure and Failure(**failure))
        else:
            death = _describe_death(code, lines, request.limit_minutes)
            result = JobResult(1, describe_failure(request, death))
            note(escape_unprintable(f"vprbench: {request.method_name} {death}"))
    return replace(result, lines=[] if is_shown else lines)


def make_job(request_json: str, place: Path, environment: Mapping[str, str]) -> NoReturn:
    """Make a run in this process, leave its outcome in the folder `place`, and end at once.

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
    faulthandler.enable(2, all_threads=False)  # a crash names the line of the plug-in
    signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
        log_to_stderr()
        printed: list[str] = []
        with share_host() as lock, results_only_on_stdout():
            result = make_run(RunRequest.from_json(request_json), printed.append, lock)
        replace_text(place / _RESULT, json.dumps(asdict(replace(result, printed="\n".join(printed)))))
    except KeyboardInterrupt:
        os._exit(128 + signal.SIGINT)
    os._exit(result.code)


@functools.cache
def start_server() -> ForkServerContext:
    """Return the context of a server that has imported libraries of runs and forks a process for each.

    It imports beside this process, which need not wait. The server has started no thread, and SIGINT is blocked in it:
    an interruption waits until the run handles it.
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


def _follow_process(
    child: ForkServerProcess,
    stderr: Path,
    note: Callable[[str], None],
    limit_minutes: float | None,
    stopped: Callable[[], bool],
) -> int | None:
    """Note the lines that a process writes until it ends; returns its exit code, None if it was killed at its limit."""
    pid, ends = child.pid, time.monotonic() + 60 * (limit_minutes or math.inf)
    assert pid is not None
    with stderr.open("rb") as written:
        try:
            while not wait([child.sentinel], _LOOK_EVERY):
                _note_lines(written, note)
                if time.monotonic() > ends:
                    return None
                if stopped():
                    raise KeyboardInterrupt
        except KeyboardInterrupt:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGINT)
            wait([child.sentinel], _PATIENCE)
            raise
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(pid, signal.SIGKILL)  # with the processes that a plug-in has started
            with _starting:
                child.kill()
                child.join()
            _note_lines(written, note, ended=True)
    return child.exitcode


def _note_lines(written: IO[bytes], note: Callable[[str], None], ended: bool = False) -> None:
    """Note the lines that a process has written since; a line that has no end waits until the process has ended."""
    for line in written:
        if not (ended or line.endswith(b"\n")):
            written.seek(-len(line), os.SEEK_CUR)
            return
        note(line.decode("utf-8", "replace").rstrip("\n"))


def print_child_line(line: str) -> None:
    """Print a line of a process on standard error, if anybody reads it."""
    with contextlib.suppress(OSError, ValueError):
        print(escape_unprintable(line, but="\t"), file=sys.stderr, flush=True)


def _end_with_parent() -> None:
    """End this process and its children once the process that wants the run has ended."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os.killpg(0, signal.SIGKILL)


def _describe_death(code: int | None, lines: Sequence[str], limit_minutes: float | None) -> str:
    """Say how a process that left no result has ended, with the place that a crash names, or its last line."""
    if code is None:
        return f"was not done after limit_minutes={limit_minutes}"
    said = [line.strip() for line in lines if line.strip()]
    last = next(filter(_CRASH_SITE.match, said), said[-1] if said else "")
    last = last and f": {last}"
    if code >= 0:
        return f"ended without a result, with exit code {code}{last}"
    memory = ", as for want of memory" if -code == signal.SIGKILL else ""
    return f"was ended by signal {-code} ({signal.Signals(-code).name}){memory}{last}"
