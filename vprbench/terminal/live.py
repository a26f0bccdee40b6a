"""A live table of many runs: which cells wait, which run and since when, and the results of those that are done."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from rich.console import Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from vprbench.progress import hide_progress
from vprbench.terminal.console import make_console
from vprbench.text import escape_unprintable, format_duration

_REST = 5  # lines of a screen that are neither rows nor runs
_NAME = 30  # columns of a row's name, at most
_RUNNING = 8  # runs shown, at most


class LiveTable:
    """Cells by row and column: a dot for one that waits, until `show` fills it; no other progress is shown."""

    def __init__(self, rows: Sequence[str], columns: Sequence[str], total: int) -> None:
        """Show these rows and columns, and how many of `total` runs are done."""
        self._rows, self._columns, self._total = list(rows), list(columns), total
        self._cells: dict[tuple[str, str], Text] = {}
        self._last_row = 0
        self._running: dict[int, tuple[str, float]] = {}  # title and start in seconds, by the run's number
        self._done, self._failed, self._made = 0, 0, 0
        self._started = time.perf_counter()
        self.console = make_console(sys.stderr)

    @contextmanager
    def shown(self) -> Iterator[None]:
        """Draw the table inside the block; afterwards the terminal is as it was, but for the lines above the table."""
        redirects = sys.stdout.isatty()
        live = Live(self, console=self.console, refresh_per_second=2, transient=True, redirect_stdout=redirects)
        with hide_progress(), live:
            yield

    def show(self, row: str, column: str, text: str, style: str = "") -> None:
        """Fill a cell."""
        self._last_row = self._rows.index(row)
        self._cells[row, column] = Text(escape_unprintable(text), style=style)

    def begin(self, number: int, title: str) -> None:
        """Show that a run has begun."""
        self._running[number] = (title, time.perf_counter())

    def end(self, number: int, failed: bool = False) -> None:
        """Count a run as done, whether it was begun or found in the store."""
        self._made += self._running.pop(number, None) is not None
        self._done, self._failed = self._done + 1, self._failed + failed

    def line(self, text: str, style: str = "") -> None:
        """Print a line above the table."""
        self.console.print(Text.from_ansi(text, style=style))

    def __rich__(self) -> Group:
        """Return the table, the runs and the counts of this moment."""
        now, running = time.perf_counter(), [*self._running.values()][:_RUNNING]
        table = Table("", box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="bold")
        table.columns[0].max_width = _NAME
        for name in self._columns:
            table.add_column(Text(escape_unprintable(name)), no_wrap=True, overflow="ellipsis")
        room = max(1, self.console.height - _REST - len(running))
        first = max(0, min(self._last_row - room // 2, len(self._rows) - room))
        for row in self._rows[first : first + room]:
            cells = [self._cells.get((row, column), Text("·", style="dim")) for column in self._columns]
            table.add_row(Text(escape_unprintable(row), overflow="ellipsis", no_wrap=True), *cells)
        lines = [f"{format_duration(now - start)}  {escape_unprintable(title)}" for title, start in running]
        runs = [Text(line, style="cyan", overflow="ellipsis", no_wrap=True) for line in lines]
        waiting = self._total - self._done - len(self._running)
        counts = f"{self._done} of {self._total}, {len(self._running)} running, {waiting} waiting"
        counts += f", {self._failed} failed" * bool(self._failed)
        if self._made:  # the rest takes as long as the runs that were made
            left = (now - self._started) / self._made * (self._total - self._done)
            counts += f", {format_duration(left)} left"
        return Group(*[table] * bool(self._rows), *runs, Text(counts))
