"""Progress of long stages: methods and runner report it, the command line shows it as a bar or as plain lines."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from contextvars import ContextVar
from typing import Any, TextIO

from vprbench.text import format_duration, format_percent, printable

Listener = Callable[[str, float], None]  # stage, share done from 0 to 1

QUIET = "VPRBENCH_QUIET"  # environment variable of a process whose progress nobody sees

_listener: ContextVar[Listener | None] = ContextVar("progress_listener", default=None)
_shown: ContextVar[bool] = ContextVar("progress_shown", default=False)

_LINE_EVERY = 10.0  # seconds between plain lines
_DRAW_EVERY = 0.1  # seconds between two states of a bar


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


@contextmanager
def progress_shown(title: str, stream: TextIO | None = None) -> Iterator[None]:
    """Show each reported stage and the time left, on standard error or `stream`: a bar in a terminal, lines elsewhere.

    Inside another such block, or where a live table is shown, this shows nothing of its own.
    """
    if _shown.get() or os.environ.get(QUIET):
        yield
        return
    target = _LossyStream(sys.stderr if stream is None else stream)
    title = printable(title)
    show: AbstractContextManager[Listener]
    show = _draw_bar(title, target) if target.isatty() else nullcontext(_print_lines(title, target))
    with show as listener, showing(), listening(listener):
        yield


@contextmanager
def showing() -> Iterator[None]:
    """Let no other bar or line of progress appear inside the block."""
    token = _shown.set(True)
    try:
        yield
    finally:
        _shown.reset(token)


class _LossyStream:
    """A stream that drops its output once its reader has gone."""

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


@contextmanager
def _draw_bar(title: str, stream: Any) -> Iterator[Listener]:
    """Yield a listener that draws a bar, from its beginning for a new stage; no thread draws beside a timed run."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    words = TextColumn("{task.description} {task.percentage:3.0f} %", markup=False)
    bar = Progress(
        *(words, BarColumn(), TimeElapsedColumn(), TimeRemainingColumn(), TextColumn("left")),
        console=Console(file=stream, force_jupyter=False),
        auto_refresh=False,
        transient=True,
        redirect_stdout=sys.stdout.isatty(),
        get_time=lambda: time.perf_counter(),
    )
    current, drawn = "", 0.0
    with bar:
        task = bar.add_task(title, total=1.0)

        def show(stage: str, done: float) -> None:
            nonlocal current, drawn
            if stage != current:
                current, drawn = stage, 0.0
                bar.reset(task, description=f"{title}: {printable(stage)}")
            bar.update(task, completed=done)
            if (now := time.perf_counter()) - drawn >= _DRAW_EVERY:
                drawn = now
                bar.refresh()

        yield show


def _print_lines(title: str, stream: Any) -> Listener:
    """Return a listener that prints a line for a new stage, and one every few seconds of a long stage."""
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
            left = format_duration((now - started) * (1 - done) / done)
            print(f"{line} {format_percent(done, 0)} %, {left} left", file=stream, flush=True)

    return show
