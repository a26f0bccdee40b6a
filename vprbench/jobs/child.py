"""The process that makes one job: nothing of one run reaches the next, and a process that dies is named."""

from __future__ import annotations

import contextlib
import fcntl
import functools
import io
import math
import os
import signal
import subprocess
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from threading import Thread
from typing import IO, cast

from vprbench.jobs import job
from vprbench.jobs.job import Job, JobResult
from vprbench.plugins.entries import with_plugin_paths
from vprbench.progress import MARKED
from vprbench.runs.timing_lock import folder
from vprbench.storage.atomic import scratch
from vprbench.storage.folders import checkout_folder
from vprbench.text import printable


@contextlib.contextmanager
def free_gpu(options: Sequence[str], given_up: Callable[[], bool]) -> Iterator[dict[str, str]]:
    """Yield the environment variables that name a free GPU; none for options of a run without `device=cuda`.

    Waits until a GPU is free, or `given_up`. A GPU that the options name by its number needs no variable.
    """
    device = next((option for option in reversed(options) if option.startswith("device=")), "")
    kind, _, number = device.removeprefix("device=").partition(":")
    names = _gpus() if kind == "cuda" else []
    if number.isdigit():
        names = names[int(number) :][:1]
    while names and not given_up():
        for name in names:
            with (folder() / f"gpu-{name}").open("ab") as file:
                try:
                    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                except BlockingIOError:
                    continue
                yield {} if number else {"CUDA_VISIBLE_DEVICES": name}
                return
        time.sleep(_LOOK_EVERY)
    yield {}


@functools.cache
def _gpus() -> list[str]:
    """Return the GPUs that a process started here sees, by names that hold in every process of this host."""
    found = []
    with contextlib.suppress(OSError, subprocess.TimeoutExpired):
        asked = ["nvidia-smi", "--query-gpu=uuid", "--format=csv,noheader"]
        found = subprocess.run(asked, capture_output=True, text=True, timeout=30, check=False).stdout.split()
    visible = os.environ.get("CUDA_VISIBLE_DEVICES")
    if visible is None:
        return found
    names = filter(None, map(str.strip, visible.split(",")))
    return [found[int(name)] if name.isdigit() and int(name) < len(found) else name for name in names]


_LOOK_EVERY = 0.1  # seconds
_PATIENCE = 20.0  # seconds that an interrupted process has to end
_LINES = 200  # of standard error, among which the reason of a death is looked for


def run_job(
    options: Sequence[str],
    heard: Callable[[str], None] | None = None,
    stopped: Callable[[], bool] = lambda: False,
    folder: str | None = None,
) -> JobResult:
    """Make the run of these options of the command line in a new process, which ends with this one.

    `heard` is given each line of its standard error, in a thread, stages and warnings marked; without it the lines go
    to this process's own. The process works in `folder`, or where this one does, and is interrupted once it is
    `stopped`. A process that dies is a failure with its exit code or signal, which one line on standard error tells.
    Raises KeyboardInterrupt if this process is interrupted, after the other one has ended.
    """
    options = [*map(with_plugin_paths, options)]
    with scratch() as place, free_gpu(options, stopped) as gpu:
        Job(tuple(options), os.getpid()).write(place)
        given = _environment({job.FOLDER: str(place), **({MARKED: "1"} if heard else {}), **gpu})
        command = [sys.executable, *_flags(), "-m", "vprbench"]
        lines: deque[str] = deque(maxlen=_LINES)
        with (
            subprocess.Popen(command, env=given, stderr=subprocess.PIPE, cwd=folder) as child,
            _lines_passed_on(cast(IO[bytes], child.stderr), lines, heard or _echo),
        ):
            code = _end_of(child, _limit_seconds(options), stopped)
        result = JobResult.read(place)
    if result is not None:
        return result
    method = next((each for each in reversed(options) if each.startswith("method=")), "the run")
    error = _words_on(code, lines) if code is not None else f"was not done after limit_minutes={_limit(options)}"
    (heard or _echo)(printable(f"vprbench: {method} {error}"))
    return JobResult(1, error=error)


def results_of(options: Sequence[str]) -> Path:
    """Return the results folder that options of the command line name."""
    given = [option.partition("=")[2] for option in options if option.startswith("results=")]
    return Path(given[-1] if given else "results").expanduser().absolute()


def _end_of(child: subprocess.Popen[bytes], limit_seconds: float, stopped: Callable[[], bool]) -> int | None:
    """Return the exit code of a process; None if it was ended at its limit."""
    end = time.monotonic() + limit_seconds
    try:
        while not stopped():
            with contextlib.suppress(subprocess.TimeoutExpired):
                return child.wait(_LOOK_EVERY)
            if time.monotonic() > end:
                return None
        _interrupt(child)
    except KeyboardInterrupt:
        _interrupt(child)
        raise
    finally:
        child.kill()
        child.wait()
    return child.returncode


def _interrupt(child: subprocess.Popen[bytes]) -> None:
    """Interrupt a process until it ends, for as long as it has time to; it may begin only now to listen."""
    end = time.monotonic() + _PATIENCE
    while time.monotonic() < end:
        child.send_signal(signal.SIGINT)
        with contextlib.suppress(subprocess.TimeoutExpired):
            child.wait(_LOOK_EVERY)
            return


def _limit(options: Sequence[str]) -> str | None:
    return next((each.partition("=")[2] for each in reversed(options) if each.startswith("limit_minutes=")), None)


def _limit_seconds(options: Sequence[str]) -> float:
    """Return the seconds that a run may take; infinite if there is no limit, or if the run itself has to refuse it."""
    with contextlib.suppress(TypeError, ValueError):
        return 60 * float(cast(str, _limit(options)))
    return math.inf


def _words_on(code: int, lines: Sequence[str]) -> str:
    """Say how a process that left no result has ended, with the place that a crash names, or its last line."""
    said = [line.strip() for line in lines if line.strip()]
    place = [line for line in said if line.startswith('File "')]
    last = f": {(place or said[-1:])[0]}" if said else ""
    if code >= 0:
        return f"ended without a result, with exit code {code}{last}"
    memory = ", as for want of memory" if -code == signal.SIGKILL else ""
    return f"was ended by signal {-code} ({signal.Signals(-code).name}){memory}{last}"


def _echo(line: str) -> None:
    with contextlib.suppress(OSError, ValueError):
        print(line, file=sys.stderr, flush=True)


def _environment(more: dict[str, str]) -> dict[str, str]:
    """Return the environment of a process, in which it finds this program."""
    path = os.pathsep.join(filter(None, [str(checkout_folder()), os.environ.get("PYTHONPATH")]))
    return {**os.environ, "PYTHONPATH": path, **more}


def _flags() -> list[str]:
    """Return the options of the interpreter that this program was started with."""
    own = [at for at, pair in enumerate(pairwise(sys.orig_argv)) if pair == ("-m", "vprbench")]
    return sys.orig_argv[1 : own[0]] if own else ["-P"]  # a program that does not look for modules in its folder


@contextlib.contextmanager
def _lines_passed_on(stream: IO[bytes], lines: deque[str], heard: Callable[[str], None]) -> Iterator[None]:
    """Keep each line of a process's standard error, and give it to `heard`."""

    def read() -> None:
        with contextlib.suppress(ValueError, OSError), io.TextIOWrapper(stream, "utf-8", "replace") as text:
            for line in text:  # which may be closed while it is read
                lines.append(line.rstrip("\n"))
                heard(lines[-1])

    reader = Thread(target=read, daemon=True)
    reader.start()
    try:
        yield
    finally:
        reader.join(1.0)  # a process that was left behind may hold the stream open
