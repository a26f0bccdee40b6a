"""The standard streams of a command: results alone on standard output, log lines and all else on standard error."""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout, suppress
from contextvars import ContextVar
from typing import TextIO

from vprbench.text import printable

own_process = False  # whether this process is the command line's own, and no program or test that calls it

_results: ContextVar[TextIO | None] = ContextVar("results", default=None)


class _LineFormatter(logging.Formatter):
    def formatMessage(self, record: logging.LogRecord) -> str:  # noqa: N802 - the name is given
        text = printable(super().formatMessage(record), but="\t")
        coloured = record.levelno >= logging.WARNING and sys.stderr.isatty() and not os.environ.get("NO_COLOR")
        return f"\x1b[33m{text}\x1b[0m" if coloured else text


class _StderrHandler(logging.StreamHandler[TextIO]):
    """Writes on the standard error of the moment: rich replaces it while a bar or a live table is shown."""

    def emit(self, record: logging.LogRecord) -> None:
        self.stream = sys.stderr
        super().emit(record)


def log_to_stderr() -> None:
    """Let each logged message be a line on standard error."""
    handler = _StderrHandler()
    handler.setFormatter(_LineFormatter("%(message)s"))
    logging.basicConfig(level=logging.INFO, handlers=[handler])
    logging.getLogger("hydra").setLevel(logging.WARNING)  # its words on a sweep are not ours


@contextmanager
def results_only_on_stdout() -> Iterator[Callable[[str], None]]:
    """Yield a function that prints a line on standard output; all other prints go to standard error.

    In a process of the command line this holds for compiled code too, and until the process ends.
    """
    stream = sys.stdout
    if own_process:
        stream.flush()
        stream = os.fdopen(os.dup(1), "w", encoding=stream.encoding, errors="replace")
        os.dup2(2, 1)

    def say(line: str) -> None:
        with suppress(OSError, ValueError):  # a reader that has gone, or a full disk, makes no stored run a failure
            print(line, file=stream, flush=True)

    token = _results.set(stream)
    try:
        with redirect_stdout(sys.stderr):
            yield say
    finally:
        _results.reset(token)


def result_stream() -> TextIO:
    """Return the stream of results: standard output, also inside `results_only_on_stdout`."""
    return _results.get() or sys.stdout


def complain(message: str) -> None:
    """Print why a command does not end with exit code 0, as one line on standard error."""
    with suppress(OSError):  # nobody may be there to read it
        print(printable(f"vprbench: {message}"), file=sys.stderr, flush=True)
