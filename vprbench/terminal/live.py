"""A table in a terminal that fills cell by cell, with a bar of all that is to be done below, and lines above."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from types import TracebackType

from rich.console import Group
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from vprbench.terminal.console import console
from vprbench.text import printable

_REST = 7  # lines of a screen that are not rows
_NAME = 30  # columns of a row's name, at most


class LiveTable:
    """Cells by row and column; each is empty, running, or holds what it is told."""

    def __init__(self, rows: Sequence[str], columns: Sequence[str], total: int) -> None:
        """Show these rows and columns, and how many of `total` steps are done."""
        self._rows, self._columns, self._total = list(rows), list(columns), total
        self._cells: dict[tuple[str, str], Text] = {}
        self._at = self._rows[:1]  # the row that is worked on
        self._steps, self._share, self._made = 0, 0.0, 0
        self._spent, self._since = 0.0, 0.0
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

    def begin(self) -> None:
        """Count the time of a step that is not there yet."""
        self._share, self._since = 0.0, time.perf_counter()

    def share(self, done: float) -> None:
        """Tell which share of the step, 0 to 1, is done."""
        self._share = done

    def step(self) -> None:
        """Count a step as done."""
        if self._since:
            self._made += 1
            self._spent += time.perf_counter() - self._since
        self._steps, self._share, self._since = self._steps + 1, 0.0, 0.0

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
        room = max(1, self.console.height - _REST)
        first = max(0, min(first - room // 2, len(self._rows) - room))
        for row in self._rows[first : first + room]:
            cells = [self._cells.get((row, column), Text("·", style="dim")) for column in self._columns]
            table.add_row(Text(printable(row)), *cells)
        done = self._steps + self._share
        bar = Table.grid(padding=(0, 1))
        bar.add_row(
            ProgressBar(total=max(self._total, 1), completed=done, width=40),
            f"{self._steps} of {self._total}{self._left()}",
        )
        return Group(table, Text(), bar)

    def _left(self) -> str:
        """Return how long the rest takes, if it takes as long as what was made until now."""
        made = self._made + self._share
        spent = self._spent + (time.perf_counter() - self._since if self._since else 0.0)
        if made <= 0:
            return ""
        seconds = spent / made * (self._total - self._steps - self._share)
        minutes, seconds = divmod(round(seconds), 60)
        return f", {minutes}:{seconds:02} left" if minutes < 60 else f", {minutes // 60}:{minutes % 60:02} h left"
