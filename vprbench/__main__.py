"""The process of the command line, by `python -m vprbench` or `vprbench`: its signals and its streams."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable
from contextlib import suppress
from types import FrameType
from typing import NoReturn


def _end_at_once(number: int, _: FrameType | None) -> None:
    """End the process in one line: nothing has begun that would have to be undone."""
    with suppress(OSError):
        os.write(2, b"vprbench: interrupted\n")
    os._exit(128 + number)


def _interrupt(number: int, _: FrameType | None) -> NoReturn:
    raise KeyboardInterrupt(number)


def _on_signals(handler: Callable[[int, FrameType | None], None]) -> None:
    """Let a handler take interruptions, but for a signal that the process was started to ignore."""
    for number in (signal.SIGINT, signal.SIGTERM):
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
    try:
        _on_signals(_interrupt)
        return cli.main()
    except KeyboardInterrupt as error:
        streams.complain("interrupted")
        return 128 + int((error.args or (signal.SIGINT,))[0])
    finally:
        _on_signals(_end_at_once)
        _end_children()
        exec("")  # or Python, which keeps in mind that code of another exec() was interrupted, ends by SIGINT


def _end_children() -> None:
    """End the processes that a plug-in has left, which the interpreter would wait for."""
    multiprocessing = sys.modules.get("multiprocessing")
    for child in multiprocessing.active_children() if multiprocessing else ():
        child.terminate()


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
