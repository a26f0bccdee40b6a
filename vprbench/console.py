"""What a person sees while something runs: one progress bar, or plain lines where there is no terminal."""

from __future__ import annotations

import shutil
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TextIO

from tqdm import tqdm

from vprbench.progress import listening

_LINE_EVERY = 10.0  # seconds between plain lines
_STEPS = 1000  # resolution of the bar


@contextmanager
def progress_shown(title: str, stream: TextIO | None = None) -> Iterator[None]:
    """Show what is reported inside the block, with the stage and the time left, on standard error or `stream`."""
    stream = sys.stderr if stream is None else stream
    if stream.isatty():
        with _Bar(title, stream) as bar, listening(bar.show):
            yield
    else:
        with listening(_Lines(title, stream).show):
            yield


class _Bar:
    def __init__(self, title: str, stream: TextIO) -> None:
        columns, rows = shutil.get_terminal_size()  # 80 and 24 where a terminal does not tell
        layout = "{desc} {percentage:3.0f} % |{bar}| {elapsed}, {remaining} left"
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
            self._bar.set_description_str(f"{self._title}: {stage}")
        self._bar.update(int(done * _STEPS) - self._bar.n)


class _Lines:
    def __init__(self, title: str, stream: TextIO) -> None:
        self._title = title
        self._stream = stream
        self._stage = ""
        self._started = self._last = 0.0

    def show(self, stage: str, done: float) -> None:
        """Print a line for a new stage, and one every few seconds of a long one."""
        now = time.perf_counter()
        if stage != self._stage:
            self._stage, self._started, self._last = stage, now, now
            print(f"{self._title}: {stage}", file=self._stream, flush=True)
        elif now - self._last >= _LINE_EVERY and 0 < done < 1:
            self._last = now
            left = (now - self._started) * (1 - done) / done
            print(f"{self._title}: {stage} {100 * done:.0f} %, {left:.0f} s left", file=self._stream, flush=True)
