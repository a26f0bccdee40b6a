"""How far a long stage is: methods and runner report it, the command line shows it as a bar or as plain lines."""

from __future__ import annotations

import logging
import os
import shutil
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, redirect_stdout, suppress
from contextvars import ContextVar
from typing import Any, TextIO

from vprbench.text import printable

Listener = Callable[[str, float], None]  # stage, share done from 0 to 1

MARKED = "VPRBENCH_MARKED"  # set for a process whose standard error another one reads: stages and warnings are marked
_MARK, _WARNING = "\x01", "!"
own_process = False  # whether this process is the command line's own, and no program or test that calls it

_listener: ContextVar[Listener | None] = ContextVar("progress_listener", default=None)
_elsewhere: ContextVar[Listener | None] = ContextVar("progress_elsewhere", default=None)
_answers: ContextVar[TextIO | None] = ContextVar("answers", default=None)

_LINE_EVERY = 10.0  # seconds between plain lines
_MARK_EVERY = 0.5  # seconds between marked lines
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


@contextmanager
def overheard(listener: Listener) -> Iterator[None]:
    """Send every report made inside the block to `listener` too."""
    shown = _listener.get()

    def both(stage: str, done: float) -> None:
        listener(stage, done)
        if shown is not None:
            shown(stage, done)

    with listening(both):
        yield


class _OneLine(logging.Formatter):
    def formatMessage(self, record: logging.LogRecord) -> str:  # noqa: N802 - the name is given
        text = printable(super().formatMessage(record), but="\t")
        if record.levelno < logging.WARNING:
            return text
        if os.environ.get(MARKED):
            return f"{_MARK}{_WARNING}{text}"
        return f"\x1b[33m{text}\x1b[0m" if sys.stderr.isatty() and not os.environ.get("NO_COLOR") else text


class _Lines(logging.StreamHandler[TextIO]):
    """Writes on what is standard error now, above a bar that is shown there."""

    def emit(self, record: logging.LogRecord) -> None:
        self.stream = sys.stderr
        bars = sys.modules.get("tqdm.std")
        with bars.tqdm.external_write_mode(file=sys.stderr) if bars else nullcontext():
            super().emit(record)


def log_to_stderr() -> None:
    """Let each logged message be a line on standard error."""
    lines = _Lines()
    lines.setFormatter(_OneLine("%(message)s"))
    logging.basicConfig(level=logging.INFO, handlers=[lines])
    logging.getLogger("hydra").setLevel(logging.WARNING)  # its words on a sweep are not ours


def marked(line: str) -> tuple[str, float] | str | None:
    """Return what a process told by a marked line: a stage and its share, or a warning; None for another line."""
    if line.startswith(_MARK + _WARNING):
        return line.removeprefix(_MARK + _WARNING)
    if not line.startswith(_MARK):
        return None
    stage, _, share = line.removeprefix(_MARK).rpartition("\t")
    return stage, float(share)


@contextmanager
def answers_alone() -> Iterator[Callable[[str], None]]:
    """Yield what prints a line on standard output; all else that is printed inside goes to standard error.

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

    token = _answers.set(stream)
    try:
        with redirect_stdout(sys.stderr):
            yield say
    finally:
        _answers.reset(token)


def answer_stream() -> TextIO:
    """Return where answers go: standard output, also inside `answers_alone`."""
    return _answers.get() or sys.stdout


@contextmanager
def progress_shown(title: str, stream: TextIO | None = None) -> Iterator[None]:
    """Show what is reported inside the block, with the stage and the time left, on standard error or `stream`."""
    shown = _Forgiving(sys.stderr if stream is None else stream)
    title = printable(title)
    show: AbstractContextManager[Listener]
    if (elsewhere := _elsewhere.get()) is not None:
        show = nullcontext(elsewhere)
    elif os.environ.get(MARKED):
        show = nullcontext(_marks(shown))
    elif shown.isatty() or _in_notebook():
        show = _bar(title, shown)
    else:
        show = nullcontext(_lines(title, shown))
    with show as listener, listening(listener):
        yield


@contextmanager
def shown_by(listener: Listener) -> Iterator[None]:
    """Let `listener` show all progress inside the block, in place of bars and lines."""
    token = _elsewhere.set(listener)
    try:
        yield
    finally:
        _elsewhere.reset(token)


def _in_notebook() -> bool:
    """Tell whether a notebook runs this, which shows bars though its streams are no terminals."""
    shell = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    return getattr(shell, "kernel", None) is not None


class _Forgiving:
    """A stream whose reader may go: what it would have read is lost, and nothing else."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def __eq__(self, other: object) -> bool:  # a bar asks whether it is drawn on the stream of a message
        return self._stream is getattr(other, "_stream", other)

    __hash__ = None  # type: ignore[assignment]

    def write(self, text: str) -> int:
        with suppress(OSError, ValueError):  # ValueError: it was closed
            return self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        with suppress(OSError, ValueError):
            self._stream.flush()


@contextmanager
def _bar(title: str, stream: _Forgiving) -> Iterator[Listener]:
    """Yield what moves a bar, and draws it anew for a new stage."""
    with warnings.catch_warnings():  # without ipywidgets the bar of a notebook is text
        warnings.simplefilter("ignore")
        from tqdm.auto import tqdm
    columns, rows = (None, None) if _in_notebook() else shutil.get_terminal_size()  # 80 and 24 if none tells
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


def _marks(stream: _Forgiving) -> Listener:
    """Return what prints a marked line for a new stage, and some more a second."""
    current, last = "", 0.0

    def show(stage: str, done: float) -> None:
        nonlocal current, last
        now = time.perf_counter()
        if stage != current or now - last > _MARK_EVERY:
            current, last = stage, now
            print(f"{_MARK}{printable(stage)}\t{done:.3f}", file=stream, flush=True)

    return show


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
