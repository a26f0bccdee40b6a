"""The words of Table II: every cell, head and explanation as text, before the markup of any format."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

from vprbench.paper.table.cells import Cell, Column, Measured, Table, TableRow
from vprbench.paper.table.quantities import RATES, TRAINING, TRAINING_TIME, OfMetric, Quantity, exponent
from vprbench.run.recall_intervals import METHOD

TITLE = "Table II"
PAPER = "paper"  # the line below a row
INAPPLICABLE = "-"
SPIKING = "spiking"


@dataclass(frozen=True)
class Words:
    """One cell: what stands in the line of the row, and what in the line of the paper below it."""

    kind: Literal["measured", "quoted", "absent"]
    absence: str  # "failed", "-" ...; nothing where all is there
    value: str  # nothing where there is none
    extent: str  # spread, interval, and in brackets what takes in more steps
    best: bool
    machine: int | None  # number from 1, where the table has several
    notes: tuple[int, ...]
    published: str  # never nothing
    published_quoted: bool
    difference: str  # nothing where there is none


def of_cell(table: Table, cell: Cell, quantity: Quantity) -> Words:
    """Return a cell of a table as words."""
    measured = cell.measured
    absence = {"measured": "", "quoted": "", "not applicable": INAPPLICABLE}.get(cell.mark, cell.mark)
    value = "" if cell.quoted is None else _printed(cell.quoted)
    if measured is not None:
        value = ("~" if measured.disturbed else "") + quantity.text(measured.value)
    return Words(
        kind="quoted" if cell.mark == "quoted" else "absent" if absence else "measured",
        absence=f"{absence}:" if absence and value else absence,
        value=value,
        extent="" if measured is None else _extent(measured, quantity),
        best=measured is not None and measured.best,
        machine=None if measured is None or len(table.machines) < 2 else measured.machine + 1,
        notes=cell.notes,
        published=_published(cell),
        published_quoted=cell.published_mark == "quoted",
        difference="" if cell.difference is None else _signed(cell.difference, quantity),
    )


def sections(table: Table) -> list[tuple[TableRow, ...]]:
    """Return the conventional and the spiking rows, apart; without those that have none."""
    parts = (tuple(row for row in table.rows if row.spiking is spiking) for spiking in (False, True))
    return [part for part in parts if part]


def in_paper(row: TableRow, column: Column) -> bool:
    """Tell whether the paper has any cell of a row in a column."""
    return any(cell.published_mark != "none" for (name, _), cell in row.cells.items() if name == column.name)


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


def one_line(text: str) -> str:
    """Return text on one line, without control characters."""
    return " ".join("".join(sign if sign.isprintable() else " " for sign in text).split())


def legend(table: Table) -> list[str]:
    """Return sentences that explain what the cells of a table show, and nothing that they do not.

    The table's caption tells of tests and of disturbed times.
    """
    return list(_legend(table))


def _legend(table: Table) -> Iterator[str]:
    cells = [cell for row in table.rows for cell in row.cells.values()]
    measured = [cell.measured for cell in cells if cell.measured is not None]
    yield "R@1: share of the queries whose best match is a right place."
    if any(m.spread is not None for m in measured):
        yield "±: standard deviation over the seeds."
    intervals = [m for m in measured if m.low is not None]
    if intervals:
        of_mean = "; of several seeds, of their mean" if any(len(m.seeds) > 1 for m in intervals) else ""
        yield f"[low, high]: 95 % interval of R@1 over the queries{of_mean}: {METHOD}."
    if any(m.total is not None for m in _measured(table, TRAINING)):
        yield f"Training: {TRAINING_TIME[0].lower()}{TRAINING_TIME[1:]}"
    yield from _legend_of_rates(_measured(table, RATES))
    yield from (quantity.metric.explained for quantity in table.quantities if isinstance(quantity, OfMetric))
    if any(cell.published_mark != "none" for cell in cells):
        less = "; in brackets measured less printed" if any(cell.difference is not None for cell in cells) else ""
        lacking = "; none: it has no such number" if any(cell.published_mark == "none" for cell in cells) else ""
        yield f"Line {PAPER}: what the paper printed{less}{lacking}."
    if any("quoted" in (cell.mark, cell.published_mark) for cell in cells):
        yield "Italics: quoted from a publication, not measured; in no contest."
    if any("not applicable" in (cell.mark, cell.published_mark) for cell in cells):
        yield f"{INAPPLICABLE}: there is no such step or number."


def _legend_of_rates(rates: Sequence[Measured]) -> Iterator[str]:
    one_step = any(rate.total is not None for rate in rates)
    if one_step:
        yield (
            "Query rates: one image at a time from memory, the step that the paper timed of its rows (encoding for "
            "NetVLAD and GCL, matching for the others); in brackets encoding and matching together, which compares "
            "all rows."
        )
    if any(rate.total is None for rate in rates):
        yield (
            "Query rates without brackets, of rows that are not the paper's: both together."
            if one_step
            else "Query rates: one image at a time from memory, encoding and matching together."
        )


def _measured(table: Table, quantities: Sequence[Quantity]) -> list[Measured]:
    names = {quantity.name for quantity in quantities}
    cells = [cell for row in table.rows for (_, name), cell in row.cells.items() if name in names]
    return [cell.measured for cell in cells if cell.measured is not None]


def _extent(measured: Measured, quantity: Quantity) -> str:
    parts = []
    if measured.spread is not None:
        parts.append(f"± {_spread(measured.spread, quantity.text(measured.value))}")
    if measured.low is not None and measured.high is not None:
        parts.append(f"[{quantity.text(measured.low)}, {quantity.text(measured.high)}]")
    if measured.total is not None:
        parts.append(f"({quantity.text(measured.total)})")
    return " ".join(parts)


def _spread(spread: float, beside: str) -> str:
    """Return a spread with as many decimals as the number beside it, or as many as it takes to see it."""
    decimals = len(beside.partition(".")[2])
    return f"{spread:,.{max(decimals, -exponent(spread, 0))}f}" if spread else "0"


def _published(cell: Cell) -> str:
    if cell.published is not None:
        return _printed(cell.published)
    return "none" if cell.published_mark == "none" else INAPPLICABLE


def _printed(value: float) -> str:
    """Return a number as a publication printed it: 48 and 0.5, never 48.0 or 0.50."""
    return f"{value:,}".removesuffix(".0")


def _signed(difference: float, quantity: Quantity) -> str:
    size = quantity.text(abs(difference))
    return size if float(size.replace(",", "")) == 0 else f"{'-' if difference < 0 else '+'}{size}"
