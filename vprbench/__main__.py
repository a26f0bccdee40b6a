"""The process of the command line, by `python -m vprbench` or `vprbench`: its signals, its streams, and jobs."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable
from contextlib import suppress
from types import FrameType
from typing import NoReturn

_JOB = "VPRBENCH_JOB"  # environment variable: the folder of a job that another process asks for (jobs/job.py)


def _end_at_once(number: int, _: FrameType | None) -> None:
    """End the process in one line: nothing has begun that would have to be undone."""
    with suppress(OSError):
        if _JOB not in os.environ:  # the process that asked says it
            os.write(2, b"vprbench: interrupted\n")
    os._exit(128 + number)


def _interrupt(number: int, _: FrameType | None) -> NoReturn:
    raise KeyboardInterrupt(number)


def _interrupt_once(number: int, _: FrameType | None) -> NoReturn:
    """Interrupt once: a terminal interrupts this process, and so does the one that asked."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    raise KeyboardInterrupt(number)


def _on_signals(handler: Callable[[int, FrameType | None], None]) -> None:
    """Let a handler take interruptions; a job's process, which ends with another one, keeps the usual SIGTERM."""
    for number in (signal.SIGINT,) if _JOB in os.environ else (signal.SIGINT, signal.SIGTERM):
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, handler)


if __name__ == "__main__":  # before anything else is imported
    _on_signals(_end_at_once)


def main() -> int:
    """Run the command line; returns the exit code, 0 only if every run or command that was asked for is done."""
    _on_signals(_end_at_once)
    _open_streams()
    import faulthandler

    faulthandler.enable(2)  # standard error: a crash names the line of the plug-in
    from vprbench import cli
    from vprbench.terminal import streams

    streams.own_process = True
    if folder := os.environ.get(_JOB):
        return _make_job(folder)
    try:
        _on_signals(_interrupt)
        return cli.main()
    except KeyboardInterrupt as error:
        streams.complain("interrupted")
        return 128 + int((error.args or (signal.SIGINT,))[0])
    finally:
        _on_signals(_end_at_once)
        exec("")  # or Python, which keeps in mind that code of another exec() was interrupted, ends by SIGINT


def _make_job(name: str) -> int:
    """Make the job of a folder in this process, and leave its result there."""
    from pathlib import Path

    from vprbench import cli
    from vprbench.jobs import job
    from vprbench.runs import timing_lock

    folder = Path(name)
    job.current = job.Job.read(folder)
    if sys.platform == "linux":
        import ctypes

        ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG: this process ends with the one that asked
        if os.getppid() != job.current.parent:  # which has died before
            return 1
    _on_signals(_interrupt_once)
    del os.environ[_JOB]
    with timing_lock.computing():
        result = cli.attempt(job.current.options)
    result.write(folder)
    return result.code


def _open_streams() -> None:
    """Let a standard stream that is closed be nowhere: the next file that is opened must not take its place."""
    import io

    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)
    sys.stdout, sys.stderr = (stream or io.StringIO() for stream in (sys.stdout, sys.stderr))


if __name__ == "__main__":
    raise SystemExit(main())
