"""Progress of long stages: methods and runner report it, the command line shows it as a bar or as plain lines."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from functools import partial
from typing import TextIO

from vprbench.text import escape_unprintable, format_duration, format_percent

Listener = Callable[[str, float], None]  # stage, share done from 0 to 1
_Draw = Callable[[str, float, float], None]  # text, share done, seconds since the stage began

QUIET = "VPRBENCH_QUIET"  # environment variable of a process whose progress nobody sees

_listener: Listener | None = None
_LINE_EVERY = 10.0  # seconds between plain lines
_DRAW_EVERY = 0.1  # seconds between two states of a bar


def report(stage: str, done: float) -> None:
    """Say which share of `stage`, 0 to 1, is done; costs nothing if nobody listens."""
    if _listener is not None:
        _listener(stage, done)


@contextmanager
def send_reports_to(listener: Listener) -> Iterator[None]:
    """Send every report made inside the block to `listener`."""
    global _listener
    outer, _listener = _listener, listener
    try:
        yield
    finally:
        _listener = outer


def hide_progress() -> AbstractContextManager[None]:
    """Let no bar or line of progress appear inside the block."""
    return send_reports_to(lambda *_: None)


@contextmanager
def show_progress(title: str, stream: TextIO | None = None) -> Iterator[None]:
    """Show each reported stage and the time left, on standard error or `stream`: a bar in a terminal, lines elsewhere.

    Where somebody listens already, as inside another such block, this shows nothing of its own.
    """
    if _listener is not None or os.environ.get(QUIET):
        yield
        return
    stream = stream or sys.stderr
    shown = _draw_bar(stream) if stream.isatty() else nullcontext(partial(_print_line, stream))
    with shown as draw, send_reports_to(_draw_sometimes(title, draw, _DRAW_EVERY if stream.isatty() else _LINE_EVERY)):
        yield


def _draw_sometimes(title: str, draw: _Draw, every: float) -> Listener:
    """Return a listener that draws a new stage at once, and one that goes on every so many seconds."""
    current, started, drawn = "", 0.0, 0.0

    def show(stage: str, done: float) -> None:
        nonlocal current, started, drawn
        now, is_new = time.perf_counter(), stage != current
        if is_new:
            current, started = stage, now
        if is_new or (now - drawn >= every and 0 < done < 1):
            drawn = now
            with suppress(OSError, ValueError):  # nobody may be there to read it
                draw(escape_unprintable(f"{title}: {stage}"), done, now - started)

    return show


@contextmanager
def _draw_bar(stream: TextIO) -> Iterator[_Draw]:
    """Yield a function that draws a bar; no thread draws beside a timed run."""
    from rich.console import Console
    from rich.markup import escape
    from rich.progress import Progress

    is_terminal = sys.stdout.isatty()
    bar = Progress(console=Console(file=stream), auto_refresh=False, transient=True, redirect_stdout=is_terminal)
    task = bar.add_task("", total=1.0, visible=False)

    def draw(text: str, done: float, seconds: float) -> None:
        if seconds == 0:
            bar.reset(task, description=escape(text))
        bar.update(task, completed=done, visible=True, refresh=True)

    bar.start()
    try:
        yield draw
    finally:
        with suppress(OSError):
            bar.stop()


def _print_line(stream: TextIO, text: str, done: float, seconds: float) -> None:
    """Print a stage as a line, and of a stage that goes on its share done and the time left."""
    left = f" {format_percent(done, 0)} %, {format_duration(seconds * (1 - done) / done)} left" if seconds else ""
    print(f"{text}{left}", file=stream, flush=True)
