"""How far a long stage is: methods and runner report it, the command line shows it as a bar or as plain lines."""

from __future__ import annotations

import logging
import os
import shutil
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, redirect_stdout, suppress
from contextvars import ContextVar
from typing import Any, TextIO

from vprbench import ending
from vprbench.text import printable

Listener = Callable[[str, float], None]  # stage, share done from 0 to 1

_listener: ContextVar[Listener | None] = ContextVar("progress_listener", default=None)

_LINE_EVERY = 10.0  # seconds between plain lines
_STEPS = 1000  # resolution of the bar


def report(stage: str, done: float) -> None:
    """Say which share of `stage`, 0 to 1, is done; costs nothing if nobody listens."""
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

    In a process that another process waits for this holds for compiled code too, and until the process ends.
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
    moving = shown.isatty() or _in_notebook()
    with _bar(title, shown) if moving else nullcontext(_lines(title, shown)) as show, listening(show):
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


def _in_notebook() -> bool:
    shell = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    return hasattr(shell, "kernel")


@contextmanager
def _bar(title: str, stream: _Forgiving) -> Iterator[Listener]:
    """Yield what moves a bar, and draws it anew for a new stage."""
    with warnings.catch_warnings():  # without ipywidgets the bar of a notebook is text
        warnings.simplefilter("ignore")
        from tqdm.auto import tqdm
    columns, rows = shutil.get_terminal_size()  # 80 and 24 if a terminal does not tell
    layout = "{desc} {percentage:3.0f} % |{bar}| {elapsed}, {remaining} left"
    current = ""
    with tqdm(total=_STEPS, desc=title, file=stream, bar_format=layout, leave=False, ncols=columns, nrows=rows) as bar:

        def show(stage: str, done: float) -> None:
            nonlocal current
            if stage != current:
                current = stage
                bar.reset()
                bar.set_description_str(f"{title}: {printable(stage)}")
            bar.update(int(done * _STEPS) - bar.n)

        yield show


def _lines(title: str, stream: _Forgiving) -> Listener:
    """Return what prints a line for a new stage, and one every few seconds of a long stage."""
    current, started, last = "", 0.0, 0.0

    def show(stage: str, done: float) -> None:
        nonlocal current, started, last
        now = time.perf_counter()
        line = f"{title}: {printable(stage)}"
        if stage != current:
            current, started, last = stage, now, now
            print(line, file=stream, flush=True)
        elif now - last >= _LINE_EVERY and 0 < done < 1:
            last = now
            left = (now - started) * (1 - done) / done
            print(f"{line} {100 * done:.0f} %, {left:.0f} s left", file=stream, flush=True)

    return show
