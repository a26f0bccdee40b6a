"""Makes `python -m vprbench` the command line, and the process that makes one run of another process."""

from __future__ import annotations

import contextlib
import faulthandler
import io
import os
import signal
import sys
from pathlib import Path
from typing import NoReturn


def main() -> int:
    """Run the command line; returns the exit code, 0 only if every run or command that was asked for is done."""
    _open_streams()
    faulthandler.enable(2)  # standard error: a crash names the line of the plug-in
    if sys.argv[1:2] == ["--job"]:
        return _make_job(Path(sys.argv[2]), int(sys.argv[3]))
    from vprbench.commands.at_once import answered
    from vprbench.errors import BadInput
    from vprbench.text import printable

    try:
        if (code := answered(sys.argv[1:])) is not None:
            sys.stdout.flush()
            return code
    except BadInput as error:
        return _complain(printable(str(error)), 2)
    except OSError:
        sys.stdout = io.StringIO()  # the interpreter flushes it in the end
        return _complain("standard output was closed before all was printed", 1)
    signal.signal(signal.SIGTERM, _interrupt)
    from vprbench import cli, progress

    progress.own_process = True
    code = cli.main()
    _end_children()
    return code


def _make_job(folder: Path, parent: int) -> int:
    """Make the run of a folder in this process, and end at once: a plug-in may have left threads and children."""
    from vprbench.runs import timing_lock

    if sys.platform == "linux":
        import ctypes

        ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG: this process ends with the one that asked
        if os.getppid() != parent:  # which has died before
            return 1
    signal.signal(signal.SIGINT, _interrupt_once)
    try:
        with timing_lock.computing():
            from vprbench import progress
            from vprbench.jobs.child import make_job

            progress.own_process = True
            code = make_job(folder)
    except KeyboardInterrupt as error:  # the process that asked says it
        code = 128 + int((error.args or (signal.SIGINT,))[0])
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


def _end_children() -> None:
    """End the processes that a plug-in has left, which the interpreter would wait for."""
    multiprocessing = sys.modules.get("multiprocessing")
    for child in multiprocessing.active_children() if multiprocessing else ():
        child.terminate()


def _interrupt(number: int, _: object) -> NoReturn:
    raise KeyboardInterrupt(number)


def _interrupt_once(number: int, _: object) -> NoReturn:
    """Interrupt once: a terminal interrupts this process, and so does the one that asked."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    raise KeyboardInterrupt(number)


def _open_streams() -> None:
    """Let a standard stream that is closed be nowhere: the next file that is opened must not take its place."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)
    sys.stdout, sys.stderr = (stream or io.StringIO() for stream in (sys.stdout, sys.stderr))


def _complain(message: str, code: int) -> int:
    with contextlib.suppress(OSError):
        print(f"vprbench: {message}", file=sys.stderr)
    return code


if __name__ == "__main__":
    raise SystemExit(main())
