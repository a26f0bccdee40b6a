"""Makes `python -m vprbench` the command line, in a process that another one waits for: it may die without a word."""

from __future__ import annotations

import contextlib
import io
import os
import signal
import sys
from typing import NoReturn

from vprbench import ending


def main() -> int:
    """Run the command line; returns the exit code, 0 only if every run or command that was asked for is done."""
    if ending.waited_for():
        return _waited_for()
    from vprbench.commands.at_once import answered
    from vprbench.errors import BadInput
    from vprbench.text import printable

    _open_streams()
    try:
        if (code := answered(sys.argv[1:])) is not None:
            sys.stdout.flush()
            return code
    except BadInput as error:
        return _complain(printable(str(error)), 2)
    except OSError:
        sys.stdout = io.StringIO()  # the interpreter flushes it in the end
        return _complain("standard output was closed before all was printed", 1)
    from vprbench.run.processes import run_apart

    try:
        return run_apart(sys.argv[1:], in_sweep=False).code
    except KeyboardInterrupt as interruption:
        return _complain("interrupted; what was finished before is kept", 128 + interruption.args[0])
    except OSError as error:
        return _complain(f"no process can be started: {error}", 1)


def _waited_for() -> int:
    """Do what the command line asks for, and end with the process that waits."""
    if sys.platform == "linux":
        import ctypes

        ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG
        if not ending.heard():  # it has died before
            return 1
    signal.signal(signal.SIGINT, _interrupt)
    try:
        from vprbench.run import timing_lock

        with timing_lock.computing() if "VPRBENCH_IN_SWEEP" in os.environ else contextlib.nullcontext():
            from vprbench import cli

            code = cli.main()
    except SystemExit as error:  # of Hydra, which says why; a plug-in's is caught where the plug-in runs
        code = error.code if isinstance(error.code, int) else int(error.code is not None)
    except KeyboardInterrupt:  # before the command line could say so: the process that waits does
        return 128 + signal.SIGINT
    except BaseException:
        ending.tell(code=1)  # and the traceback says the rest
        raise
    ending.tell(code=code)
    return code


def _interrupt(*_: object) -> NoReturn:
    """Interrupt once: a terminal interrupts this process, and so does the one that waits."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    raise KeyboardInterrupt


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
