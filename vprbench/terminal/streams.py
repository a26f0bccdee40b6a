"""The standard streams of a command: results alone on standard output, log lines and all else on standard error."""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout, suppress
from typing import TextIO

from vprbench.text import escape_unprintable

own_process = False  # whether this process is the command line's own, and no program or test that calls it

_results: TextIO | None = None


class _StderrHandler(logging.Handler):
    """Prints each record as one line on the standard error of the moment: rich replaces it while a bar is shown."""

    def emit(self, record: logging.LogRecord) -> None:
        _print_on_stderr(record.getMessage())


def log_to_stderr() -> None:
    """Let each logged message be a line on standard error."""
    logging.basicConfig(level=logging.INFO, handlers=[_StderrHandler()])


def complain(message: str) -> None:
    """Print why a command does not end with exit code 0, as one line on standard error."""
    _print_on_stderr(f"vprbench: {message}")


def _print_on_stderr(line: str) -> None:
    with suppress(OSError, ValueError):  # nobody may be there to read it
        print(escape_unprintable(line, but="\t"), file=sys.stderr, flush=True)


@contextmanager
def results_only_on_stdout() -> Iterator[Callable[[str], None]]:
    """Yield a function that prints a line on standard output; all other prints go to standard error.

    In a process of the command line this holds for compiled code too, and until the process ends.
    """
    global _results
    stream = sys.stdout
    if own_process:
        stream.flush()
        stream = os.fdopen(os.dup(1), "w", encoding=stream.encoding, errors="replace")
        os.dup2(2, 1)

    def say(line: str) -> None:
        with suppress(OSError, ValueError):  # a reader that has gone, or a full disk, makes no stored run a failure
            print(line, file=stream, flush=True)

    _results = stream
    try:
        with redirect_stdout(sys.stderr):
            yield say
    finally:
        _results = None


def get_result_stream() -> TextIO:
    """Return the stream of results: standard output, also inside `results_only_on_stdout`."""
    return _results or sys.stdout
