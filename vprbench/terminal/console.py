"""The terminal: its width, its colours, and tables that never wrap in it."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TextIO

from rich.cells import cell_len
from rich.console import Console, RenderableType
from rich.table import Table
from rich.text import Text

from vprbench.terminal.streams import get_result_stream
from vprbench.text import escape_unprintable

LEAST_WIDTH = 100  # columns, where no terminal says how wide it is
_GAP = 2  # columns behind each of a table


def make_console(stream: TextIO | None = None) -> Console:
    """Return rich's console for `stream`, that of results if None: colours only on terminals, and none for NO_COLOR.

    It is as wide as the terminal; what is no terminal has 100 columns, or more if COLUMNS says so.
    """
    stream = get_result_stream() if stream is None else stream
    columns = os.environ.get("COLUMNS", "")
    width = None if stream.isatty() else max(LEAST_WIDTH, int(columns) if columns.isdecimal() else 0)
    return Console(file=stream, width=width, markup=False, emoji=False, highlight=False, force_jupyter=False)


def show_table(
    columns: Sequence[str], rows: Sequence[Sequence[str]], wide: bool = False, least: Sequence[str] = ()
) -> None:
    """Print what `format_table` returns on standard output."""
    print(format_table(columns, rows, wide, least))


def format_table(
    columns: Sequence[str], rows: Sequence[Sequence[str]], wide: bool = False, least: Sequence[str] = ()
) -> str:
    """Return a table as text whose lines fit the terminal, or are as long as they are if `wide`.

    Whole columns that do not fit are left out, those of `least` first and then from the right, and named below; the
    first two stay, and the widest of them is cut short if need be.
    """
    room = make_console()
    cells = [[escape_unprintable(text) for text in row] for row in (columns, *rows)]
    widths = [max(map(cell_len, column)) + _GAP for column in zip(*cells, strict=True)]
    kept = list(range(len(widths)))
    order = [columns.index(name) for name in least if name in columns]
    order += [at for at in reversed(kept[2:]) if at not in order]
    while not wide and order and sum(widths[at] for at in kept) > room.width + _GAP:
        kept.remove(order.pop(0))
    over = sum(widths[at] for at in kept) - room.width - _GAP
    if over > 0 and not wide:
        widest = max(kept, key=widths.__getitem__)
        widths[widest] = max(1 + _GAP, widths[widest] - over)
    table = Table(box=None, padding=(0, _GAP, 0, 0), pad_edge=False, header_style="bold")
    for at in kept:
        table.add_column(Text(cells[0][at]), width=widths[at] - _GAP, no_wrap=True, overflow="ellipsis")
    for row in cells[1:]:
        table.add_row(*(Text(row[at]) for at in kept))
    room.width = sum(widths[at] for at in kept)
    left_out = ", ".join(name for at, name in enumerate(columns) if at not in kept)
    below = ["\n" + format_line(f"left out: {left_out} (wide=true shows them)", "dim")] if left_out else []
    return "".join([format_lines(table, room), *below])


def format_line(line: str, style: str = "", fits: bool = False) -> str:
    """Return a sentence as a line, or broken between words and in colour for a terminal; broken anywhere if `fits`."""
    room = make_console()
    if not (room.is_terminal or fits):
        return escape_unprintable(line)
    return format_lines(Text(escape_unprintable(line), style=style), room)


def format_lines(content: RenderableType, room: Console) -> str:
    """Return a table or text as lines, as wide and coloured as `room` is, without blanks at their ends."""
    with room.capture() as lines:
        room.print(content)
    return "\n".join(line.rstrip() for line in lines.get().splitlines())
