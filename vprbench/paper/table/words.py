"""The text of Table II: every cell, head and explanation, before the markup of any format."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from vprbench.paper.table.cells import Cell, Column, Measured, Table, TableRow
from vprbench.paper.table.quantities import RATES, TRAINING, TRAINING_TIME, Quantity, exponent
from vprbench.paper.templates import ENVIRONMENT, sentences

PAPER = "paper"  # the line below a row
INAPPLICABLE = "-"
SPIKING = "spiking"
ELSEWHERE = "elsewhere"
ENVIRONMENT.globals |= {
    "TRAINING_TIME": TRAINING_TIME,
    "PAPER_LINE": PAPER,
    "INAPPLICABLE": INAPPLICABLE,
    "ELSEWHERE": ELSEWHERE,
}


@dataclass(frozen=True)
class Words:
    """One cell: what stands in the line of the row, and what in the line of the paper below it."""

    kind: Literal["measured", "quoted", "absent"]
    absence: str  # "failed", "-" ...; nothing where all is there
    value: str  # nothing where there is none
    extent: str  # spread, interval, and in brackets what takes in waiting for images
    best: bool
    machine: int | None  # number from 1, where the table has several
    notes: tuple[int, ...]
    in_paper: bool  # the paper has any cell of the row in the column
    published: str  # never nothing
    published_quoted: bool
    beside: str  # behind the published number: the step that it is of here, and the difference


def of_cell(table: Table, row: TableRow, column: Column, quantity: Quantity) -> Words:
    """Return a cell of a table as words."""
    cell = row.cells[column.name, quantity.name]
    measured = cell.measured
    absence = {"measured": "", "quoted": "", "not applicable": INAPPLICABLE}.get(cell.mark, cell.mark)
    value = "" if cell.quoted is None else _printed(cell.quoted)
    if measured is not None:
        value = ("~" if measured.disturbed else "") + quantity.text(measured.value)
    published = "none" if cell.published_mark == "none" else INAPPLICABLE
    return Words(
        kind="quoted" if cell.mark == "quoted" else "absent" if absence else "measured",
        absence=f"{absence}:" if absence and value else absence,
        value=value,
        extent="" if measured is None else _extent(measured, quantity),
        best=measured is not None and measured.best,
        machine=None if measured is None or len(table.machines) < 2 else measured.machine + 1,
        notes=cell.notes,
        in_paper=any(c.published_mark != "none" for (name, _), c in row.cells.items() if name == column.name),
        published=published if cell.published is None else _printed(cell.published),
        published_quoted=cell.published_mark == "quoted",
        beside="" if cell.published is None else _beside(cell, row, quantity),
    )


def sections(table: Table, columns: Sequence[Column]) -> list[list[tuple[TableRow, list[Words]]]]:
    """Return the rows with their cells in some columns; of Table II the conventional and the spiking ones apart."""
    lines = [(row, [of_cell(table, row, c, q) for c in columns for q in table.quantities]) for row in table.rows]
    parts = [[line for line in lines if line[0].spiking is spiking] for spiking in (False, True)]
    return [part for part in (parts if table.title is None else [lines]) if part]


def data(column: Column) -> str:
    """Return what a column was measured on, in one line."""
    counts = [(column.n_places, "places"), (column.n_queries, "queries")]
    parts = [f"{count:,} {what}" for count, what in counts if count is not None]
    parts += [column.protocol] if column.protocol else []
    parts += [f"stands in for {column.stand_in_for}"] if column.stand_in_for else []
    return "; ".join(parts)


def machines(table: Table) -> list[tuple[str, str]]:
    """Return the machines, each after what marks its cells."""
    several = len(table.machines) > 1
    return [(machine_mark(i) if several else "Machine", machine) for i, machine in enumerate(table.machines, 1)]


def machine_mark(machine: int) -> str:
    """Return what marks the cells of a machine, whose number counts from 1."""
    return f"M{machine}"


def legend(table: Table) -> list[str]:
    """Return sentences that explain what the cells of a table show, and nothing that they do not.

    The table's caption tells of tests and of disturbed times.
    """
    cells = [(name, cell) for row in table.rows for (_, name), cell in row.cells.items()]
    training, rates = (
        [cell.measured for name, cell in cells if cell.measured is not None and name in {q.name for q in quantities}]
        for quantities in (TRAINING, RATES)
    )
    return sentences("table/sentences.j2", "legend", table, [cell for _, cell in cells], training, rates)


def _extent(measured: Measured, quantity: Quantity) -> str:
    parts = []
    if measured.spread is not None:
        parts.append(f"± {_spread(measured.spread, quantity.text(measured.value))}")
    if measured.low is not None and measured.high is not None:
        parts.append(f"[{quantity.text(measured.low)}, {quantity.text(measured.high)}]")
    if measured.total is not None:
        parts.append(f"({quantity.text(measured.total)})")
    if (other := measured.elsewhere) is not None:
        parts.append(f"{ELSEWHERE} {quantity.text(other.value)} {_extent(other, quantity)}".rstrip())
    return " ".join(parts)


def _beside(cell: Cell, row: TableRow, quantity: Quantity) -> str:
    alone = None if cell.measured is None else cell.measured.at_boundary
    parts = [] if alone is None else [f"{row.boundary} alone here: {quantity.text(alone)}"]
    return "; ".join(parts if cell.difference is None else [*parts, _signed(cell.difference, quantity)])


def _spread(spread: float, beside: str) -> str:
    """Return a spread with as many decimals as the number beside it, or as many as it takes to see it."""
    decimals = len(beside.partition(".")[2])
    return f"{spread:,.{max(decimals, -exponent(spread, 0))}f}" if spread else "0"


def _printed(value: float) -> str:
    """Return a number as a publication printed it: 48 and 0.5, never 48.0 or 0.50."""
    return f"{value:,}".removesuffix(".0")


def _signed(difference: float, quantity: Quantity) -> str:
    size = quantity.text(abs(difference))
    return size if float(size.replace(",", "")) == 0 else f"{'-' if difference < 0 else '+'}{size}"
