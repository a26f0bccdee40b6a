"""A table in a terminal that fills cell by cell: below it what runs where, and how much is done; lines above."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from types import TracebackType

from rich.console import Group, RenderableType
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from vprbench.terminal.console import console
from vprbench.text import printable

_REST = 7  # lines of a screen that are not rows
_NAME = 30  # columns of a row's name, at most
_RUNNING = 8  # steps shown that run elsewhere, at most


@dataclass
class _Step:
    """A step that runs."""

    title: str
    host: str  # empty: here, which needs no line of its own
    words: str = "starts"
    share: float = 0.0
    since: float = field(default_factory=time.perf_counter)


class LiveTable:
    """Cells by row and column; each is empty, running, or holds what it is told."""

    def __init__(self, rows: Sequence[str], columns: Sequence[str], total: int) -> None:
        """Show these rows and columns, and how many of `total` steps are done."""
        self._rows, self._columns, self._total = list(rows), list(columns), total
        self._cells: dict[tuple[str, str], Text] = {}
        self._at = self._rows[:1]  # the row that is worked on
        self._running: dict[int, _Step] = {}
        self._steps, self._failed, self._made, self._spent = 0, 0, 0, 0.0
        self.console = console(sys.stderr)
        self._live = Live(
            self,
            console=self.console,
            refresh_per_second=2,
            transient=True,
            redirect_stdout=sys.stdout.isatty(),
            vertical_overflow="crop",
        )

    def __enter__(self) -> LiveTable:
        """Begin to draw."""
        self._live.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        """Leave the terminal as it was, but for the lines above."""
        self._live.stop()

    def show(self, row: str, column: str, text: str, style: str = "") -> None:
        """Fill a cell."""
        self._at = [row]
        self._cells[row, column] = Text(printable(text), style=style)

    def begin(self, number: int, title: str = "", host: str = "") -> None:
        """Count the time of a step that is not there yet, and show it if it runs on a host that is named."""
        self._running[number] = _Step(title, host)

    def share(self, number: int, words: str, done: float) -> None:
        """Tell what a step does, and which share of it, 0 to 1, is done."""
        if number in self._running:
            self._running[number].words, self._running[number].share = words, done

    def step(self, number: int, failed: bool = False) -> None:
        """Count a step as done."""
        if (ran := self._running.pop(number, None)) is not None:
            self._made += 1
            self._spent += time.perf_counter() - ran.since
        self._steps, self._failed = self._steps + 1, self._failed + failed

    def line(self, text: str, style: str = "") -> None:
        """Print a line above the table."""
        self.console.print(Text.from_ansi(text, style=style))

    def __rich__(self) -> Group:
        """Return what is drawn now."""
        table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="bold")
        for head in ("", *self._columns):
            table.add_column(Text(printable(head)), no_wrap=True, overflow="ellipsis", justify="left")
        table.columns[0].max_width = _NAME
        first = self._rows.index(self._at[0]) if self._at else 0
        running = [*self._running.values()]
        elsewhere = [step for step in running if step.host][:_RUNNING]
        room = max(1, self.console.height - _REST - len(elsewhere))
        first = max(0, min(first - room // 2, len(self._rows) - room))
        for row in self._rows[first : first + room]:
            cells = [self._cells.get((row, column), Text("·", style="dim")) for column in self._columns]
            table.add_row(Text(printable(row)), *cells)
        at = Table.grid(padding=(0, 2))
        for step in elsewhere:
            at.add_row(*(Text(printable(each), style="cyan") for each in (step.host, step.title, step.words)))
        bar = Table.grid(padding=(0, 1))
        done = self._steps + sum(step.share for step in running)
        words = f"{self._steps} of {self._total}"
        if elsewhere:
            words += f", {len(running)} running, {self._total - self._steps - len(running)} waiting"
        words += f", {self._failed} failed" * bool(self._failed)
        bar.add_row(ProgressBar(total=max(self._total, 1), completed=done, width=40), words + self._left(running))
        parts: list[RenderableType] = [table, Text()] if self._rows else []
        return Group(*parts, *([at, Text()] if elsewhere else []), bar)

    def _left(self, running: Sequence[_Step]) -> str:
        """Return how long the rest takes, if it takes as long as what was made until now, as many at a time."""
        shares = sum(step.share for step in running)
        spent = self._spent + sum(time.perf_counter() - step.since for step in running)
        if self._made + shares <= 0:
            return ""
        rest = self._total - self._steps - shares
        seconds = spent / (self._made + shares) * rest / max(1, len(running))
        minutes, seconds = divmod(round(seconds), 60)
        return f", {minutes}:{seconds:02} left" if minutes < 60 else f", {minutes // 60}:{minutes % 60:02} h left"
