"""The process of the command line, by `python -m vprbench` or `vprbench`: its signals and its streams."""

from __future__ import annotations

import atexit
import os
import signal
import sys
from contextlib import suppress
from types import FrameType
from typing import NoReturn

_interruptible = False  # whether a command runs that has to undo something


def _handle_signal(number: int, _: FrameType | None) -> None:
    """Interrupt the command; before it begins and after its end, end the process at once."""
    if _interruptible:
        raise KeyboardInterrupt(number)
    os.write(2, b"vprbench: interrupted\n")
    os._exit(128 + number)


def main() -> NoReturn:
    """Run the command line and end the process; without `os._exit` Python would take PyTorch apart for two seconds."""
    code = run_command_line()
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):  # nobody may be there to read it
            stream.flush()
    os._exit(code)


def run_command_line() -> int:
    """Run the command line; returns the exit code, 0 only if every run or command that was asked for is done."""
    global _interruptible
    for number in (signal.SIGINT, signal.SIGTERM):
        if signal.getsignal(number) is not signal.SIG_IGN:  # of a process in the background
            signal.signal(number, _handle_signal)
    import faulthandler

    faulthandler.enable(2)  # standard error: a crash names the line of the plug-in
    from vprbench import cli
    from vprbench.terminal import streams

    streams.own_process = True
    try:
        _interruptible = True
        return cli.main()
    except KeyboardInterrupt as error:
        streams.complain("interrupted; all that was finished before is kept: give the same command again")
        return 128 + int((error.args or (signal.SIGINT,))[0])  # a plug-in may raise it bare
    finally:
        _interruptible = False
        if "multiprocessing" in sys.modules:  # Python would wait for the processes that a plug-in has left
            for child in sys.modules["multiprocessing"].active_children():
                child.terminate()


if __name__ == "__main__":
    main()
