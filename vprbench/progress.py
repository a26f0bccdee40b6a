"""How far a long stage is: methods and runner report it, the command line shows it as a bar or as plain lines."""

from __future__ import annotations

import logging
import os
import shutil
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout, suppress
from contextvars import ContextVar
from typing import Any, TextIO

from vprbench import ending
from vprbench.text import printable

Listener = Callable[[str, float], None]  # stage, share done from 0 to 1

_listener: ContextVar[Listener | None] = ContextVar("progress_listener", default=None)

_LINE_EVERY = 10.0  # seconds between plain lines
_STEPS = 1000  # resolution of the bar


def report(stage: str, done: float) -> None:
    """Say which share of `stage`, 0 to 1, is done; costs nothing where nobody listens."""
    listener = _listener.get()
    if listener is not None:
        listener(stage, done)


@contextmanager
def listening(listener: Listener) -> Iterator[None]:
    """Send every report made inside the block to `listener`."""
    token = _listener.set(listener)
    try:
        yield
    finally:
        _listener.reset(token)


class _OneLine(logging.Formatter):
    def formatMessage(self, record: logging.LogRecord) -> str:  # noqa: N802 - the name is given
        return printable(super().formatMessage(record), but="\t")


def log_lines() -> None:
    """Let each logged message be a line on standard error."""
    logging.basicConfig(level=logging.INFO)
    logging.getLogger("hydra").setLevel(logging.WARNING)  # its words on a sweep are not ours
    for handler in logging.getLogger().handlers:
        if type(handler) is logging.StreamHandler:
            handler.setFormatter(_OneLine("%(message)s"))


@contextmanager
def answers_alone() -> Iterator[Callable[[str], None]]:
    """Yield what prints a line on standard output; all else that is printed inside goes to standard error.

    In a process that another one waits for that holds for compiled code too, and until the process ends.
    """
    stream = sys.stdout
    if ending.waited_for():
        stream.flush()
        stream = os.fdopen(os.dup(1), "w", encoding=stream.encoding, errors="replace")
        os.dup2(2, 1)

    def say(line: str) -> None:
        with suppress(OSError, ValueError):  # a reader that has gone, or a full disk, makes no stored run a failure
            print(line, file=stream, flush=True)

    with redirect_stdout(sys.stderr):
        yield say


@contextmanager
def progress_shown(title: str, stream: TextIO | None = None) -> Iterator[None]:
    """Show what is reported inside the block, with the stage and the time left, on standard error or `stream`."""
    shown = _Forgiving(sys.stderr if stream is None else stream)
    title = printable(title)
    if shown.isatty():
        with _Bar(title, shown) as bar, listening(bar.show):
            yield
    else:
        with listening(_Lines(title, shown).show):
            yield


class _Forgiving:
    """A stream whose reader may go: what it would have read is lost, and nothing else."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        with suppress(OSError, ValueError):  # ValueError: it was closed
            return self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        with suppress(OSError, ValueError):
            self._stream.flush()


class _Bar:
    def __init__(self, title: str, stream: _Forgiving) -> None:
        columns, rows = shutil.get_terminal_size()  # 80 and 24 where a terminal does not tell
        layout = "{desc} {percentage:3.0f} % |{bar}| {elapsed}, {remaining} left"
        from tqdm import tqdm

        self._bar = tqdm(
            total=_STEPS, desc=title, file=stream, bar_format=layout, leave=False, ncols=columns, nrows=rows
        )
        self._title = title
        self._stage = ""

    def __enter__(self) -> _Bar:
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.close()

    def show(self, stage: str, done: float) -> None:
        """Draw the bar anew for a new stage, and move it."""
        if stage != self._stage:
            self._stage = stage
            self._bar.reset()
            self._bar.set_description_str(f"{self._title}: {printable(stage)}")
        self._bar.update(int(done * _STEPS) - self._bar.n)


class _Lines:
    def __init__(self, title: str, stream: _Forgiving) -> None:
        self._title = title
        self._stream = stream
        self._stage = ""
        self._started = self._last = 0.0

    def show(self, stage: str, done: float) -> None:
        """Print a line for a new stage, and one every few seconds of a long one."""
        now = time.perf_counter()
        if stage != self._stage:
            self._stage, self._started, self._last = stage, now, now
            print(f"{self._title}: {printable(stage)}", file=self._stream, flush=True)
        elif now - self._last >= _LINE_EVERY and 0 < done < 1:
            self._last = now
            left = (now - self._started) * (1 - done) / done
            line = f"{self._title}: {printable(stage)} {100 * done:.0f} %, {left:.0f} s left"
            print(line, file=self._stream, flush=True)
