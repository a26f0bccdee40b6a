"""A run in a process of its own: nothing of one run reaches the next, and a process that dies is named."""

from __future__ import annotations

import contextlib
import json
import math
import os
import signal
import subprocess
import sys
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import IO

from vprbench.jobs.job import JobResult, make_run
from vprbench.progress import QUIET
from vprbench.runs.request import RunRequest
from vprbench.runs.store import Store
from vprbench.storage.atomic import scratch
from vprbench.storage.folders import checkout_folder
from vprbench.terminal.streams import log_to_stderr, results_only_on_stdout
from vprbench.text import printable

_REQUEST, _RESULT = "request.json", "result.json"
_LOOK_EVERY = 0.1  # seconds
_PATIENCE = 20.0  # seconds that a process has to end, once it is interrupted or has left its result
_LINES = 200  # of standard error, among which the reason of a death is looked for


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
        stopped: tells whether the process has to be interrupted.
        folder: the working folder of the process; None for this one's.
        environment: more variables of its environment.

    Returns:
        The outcome. A process that dies is a failure with its exit code or signal.

    Raises:
        KeyboardInterrupt: this process was interrupted; the other one has ended before.
    """
    request = RunRequest.from_json(request_json)
    with scratch() as place, (place / "stderr").open("wb") as said, (place / "stderr").open("rb") as written:
        (place / _REQUEST).write_text(request_json, encoding="utf-8")
        variables = {
            **os.environ,
            **(environment or {}),
            "PYTHONPATH": _python_path(),
            **({QUIET: "1"} if hear else {}),
        }
        command = [sys.executable, *_interpreter_flags(), "-m", "vprbench", "--job", str(place), str(os.getpid())]
        lines = _Lines(written, hear or _echo)
        with subprocess.Popen(command, env=variables, stderr=said, cwd=folder, process_group=0) as child:
            code = _follow(child, place / _RESULT, lines, request.limit_minutes, stopped)
        with contextlib.suppress(FileNotFoundError):
            return JobResult(**json.loads((place / _RESULT).read_text(encoding="utf-8")))
    Store(Path(request.results).expanduser()).remove_leftovers()
    limit = f"was not done after limit_minutes={request.limit_minutes}"
    error = limit if code is None else _describe_death(code, lines.last)
    lines.hear(printable(f"vprbench: {request.method_name} {error}"))
    return JobResult(1, error)


def make_job(folder: Path) -> int:
    """Make the run of a folder in this process, and leave its outcome there; returns the exit code."""
    from vprbench.runs import timing_lock

    log_to_stderr()
    printed: list[str] = []
    with timing_lock.computing(), results_only_on_stdout():
        request = RunRequest.from_json((folder / _REQUEST).read_bytes())
        result = make_run(request, printed.append, wait=False)
    partial = folder / f"{_RESULT}.partial"
    partial.write_text(replace(result, printed="\n".join(printed)).to_json(), encoding="utf-8")
    partial.rename(folder / _RESULT)
    return result.code


class _Lines:
    """The lines that a process writes to a file, as they come; a pipe would stay open with the process's children."""

    def __init__(self, file: IO[bytes], hear: Callable[[str], None]) -> None:
        """Read from `file`, and give each line to `hear`."""
        self.hear = hear
        self.last: deque[str] = deque(maxlen=_LINES)
        self._file, self._rest = file, b""

    def pass_on(self, ended: bool = False) -> None:
        """Pass on the lines that are whole, or all if the process has ended."""
        *lines, self._rest = (self._rest + self._file.read()).split(b"\n")
        if ended and self._rest:
            lines, self._rest = [*lines, self._rest], b""
        for line in lines:
            self.last.append(line.decode("utf-8", "replace"))
            self.hear(self.last[-1])


def _follow(
    child: subprocess.Popen[bytes],
    result: Path,
    lines: _Lines,
    limit_minutes: float | None,
    stopped: Callable[[], bool],
) -> int | None:
    """Wait for a process and pass on its lines; returns its exit code, None if it was killed at its limit.

    A process that has left its result and does not end, as for children of its own, is killed; its children are ended
    with it.
    """
    ends = math.inf if limit_minutes is None else time.monotonic() + 60 * limit_minutes
    try:
        while child.poll() is None:
            lines.pass_on()
            if result.exists():
                ends = min(ends, time.monotonic() + _PATIENCE)
            if stopped():
                _interrupt(child)
            elif time.monotonic() > ends:
                return None
            with contextlib.suppress(subprocess.TimeoutExpired):
                child.wait(_LOOK_EVERY)
    except KeyboardInterrupt:
        _interrupt(child)
        raise
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(child.pid, signal.SIGKILL)  # with the processes that a plug-in has started
        child.wait()
        lines.pass_on(ended=True)
    return child.returncode


def _interrupt(child: subprocess.Popen[bytes]) -> None:
    """Interrupt a process until it ends, for as long as it has time to; it may begin only now to listen."""
    end = time.monotonic() + _PATIENCE
    while time.monotonic() < end:
        child.send_signal(signal.SIGINT)
        with contextlib.suppress(subprocess.TimeoutExpired):
            child.wait(_LOOK_EVERY)
            return
    child.kill()


def _describe_death(code: int, lines: Iterable[str]) -> str:
    """Say how a process that left no result has ended, with the place that a crash names, or its last line."""
    said = [line.strip() for line in lines if line.strip()]
    crashed = next((i for i, line in enumerate(said) if line.startswith("Current thread")), 0)
    place = [line for line in said[crashed:] if line.startswith('File "')]
    last = f": {(place or said[-1:])[0]}" if said else ""
    if code >= 0:
        return f"ended without a result, with exit code {code}{last}"
    memory = ", as for want of memory" if -code == signal.SIGKILL else ""
    return f"was ended by signal {-code} ({signal.Signals(-code).name}){memory}{last}"


def _echo(line: str) -> None:
    with contextlib.suppress(OSError, ValueError):
        print(line, file=sys.stderr, flush=True)


def _python_path() -> str:
    """Return the path on which a process finds this program."""
    return os.pathsep.join(filter(None, [str(checkout_folder()), os.environ.get("PYTHONPATH")]))


def _interpreter_flags() -> list[str]:
    """Return the options of the interpreter that this program was started with."""
    own = [at for at, pair in enumerate(pairwise(sys.orig_argv)) if pair == ("-m", "vprbench")]
    return sys.orig_argv[1 : own[0]] if own else ["-P"]  # a program that does not look for modules in its folder
