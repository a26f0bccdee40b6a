"""The text of Table II: every cell, head and explanation, before the markup of any format."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pandas as pd

from vprbench.paper.plan import Row
from vprbench.paper.table.cells import Column, Table
from vprbench.paper.table.quantities import RATES, TRAINING, TRAINING_TIME, Quantity
from vprbench.paper.templates import ENVIRONMENT, sentences
from vprbench.runs.frame import named_tuples
from vprbench.text import format_spread

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


def in_words(table: Table) -> pd.DataFrame:
    """Return what is printed of each cell, a line each, in the line of the row and in that of the paper below it.

    - `kind`: "measured", "quoted" or "absent"; `absence`: "failed", "-" ..., empty where all is there
    - `value`: empty where there is none; `extent`: spread, interval, and in brackets what takes in waiting for images
    - `best`; `machine`: its number from 1, 0 if the table has one machine; `notes`: their numbers
    - `in_paper`: the paper has any cell of the row in the column; `published`: never empty; `published_quoted`
    - `beside`: behind the published number: the step that it is of here, and the difference
    """
    by_name = {quantity.name: quantity for quantity in table.quantities}
    boundaries = {row.name: row.boundary for row in table.rows}
    printed = table.cells[table.cells["published_mark"] != "none"]
    in_paper = {*zip(printed["row"], printed["column"], strict=True)}
    several = len(table.machines) > 1
    lines = []
    for cell in named_tuples(table.cells):
        quantity = by_name[cell.quantity]
        absence = {"measured": "", "quoted": "", "not applicable": INAPPLICABLE}.get(cell.mark, cell.mark)
        value = _printed(cell.value) if cell.mark == "quoted" else ""
        if cell.seeds is not None:
            value = ("~" if cell.disturbed else "") + quantity.text(cell.value)
        nothing = "none" if cell.published_mark == "none" else INAPPLICABLE
        lines.append(
            {
                "row": cell.row,
                "column": cell.column,
                "kind": "quoted" if cell.mark == "quoted" else "absent" if absence else "measured",
                "absence": f"{absence}:" if absence and value else absence,
                "value": value,
                "extent": "" if cell.seeds is None else _extent(cell, quantity),
                "best": cell.best,
                "machine": cell.machine + 1 if several and cell.machine is not None else 0,
                "notes": cell.notes,
                "in_paper": (cell.row, cell.column) in in_paper,
                "published": nothing if cell.published is None else _printed(cell.published),
                "published_quoted": cell.published_mark == "quoted",
                "beside": "" if cell.published is None else _beside(cell, boundaries[cell.row], quantity),
            }
        )
    return pd.DataFrame(lines, dtype=object)


def sections(table: Table, columns: Sequence[Column]) -> list[list[tuple[Row, list[Any]]]]:
    """Return the rows with the words of their cells in some columns; of Table II the spiking ones stand apart."""
    cells: dict[tuple[str, str], list[Any]] = {}
    for cell in named_tuples(in_words(table)):
        cells.setdefault((cell.row, cell.column), []).append(cell)
    lines = [(row, [cell for column in columns for cell in cells[row.name, column.name]]) for row in table.rows]
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
    cells = [*named_tuples(table.cells)]
    training, rates = (
        [cell for cell in cells if cell.seeds is not None and cell.quantity in {q.name for q in quantities}]
        for quantities in (TRAINING, RATES)
    )
    return sentences("table/sentences.j2", "legend", table, cells, training, rates)


def _extent(cell: Any, quantity: Quantity) -> str:
    parts = [_range(cell.value, cell.spread, cell.low, cell.high, quantity)]
    if cell.total is not None:
        parts.append(f"({quantity.text(cell.total)})")
    if (other := cell.elsewhere) is not None:
        parts.append(f"{ELSEWHERE} {quantity.text(other)}")
        parts.append(_range(other, cell.elsewhere_spread, cell.elsewhere_low, cell.elsewhere_high, quantity))
    return " ".join(filter(None, parts))


def _range(value: float, spread: float | None, low: float | None, high: float | None, quantity: Quantity) -> str:
    """Return the spread over the seeds and the interval, of those that there are."""
    parts = [] if spread is None else [f"± {format_spread(spread, quantity.text(value))}"]
    if low is not None and high is not None:
        parts.append(f"[{quantity.text(low)}, {quantity.text(high)}]")
    return " ".join(parts)


def _beside(cell: Any, boundary: str | None, quantity: Quantity) -> str:
    alone = cell.at_boundary
    parts = [] if alone is None else [f"{boundary} alone here: {quantity.text(alone)}"]
    return "; ".join(parts if cell.difference is None else [*parts, _signed(cell.difference, quantity)])


def _printed(value: float) -> str:
    """Return a number as a publication printed it: 48 and 0.5, never 48.0 or 0.50."""
    return f"{value:,}".removesuffix(".0")


def _signed(difference: float, quantity: Quantity) -> str:
    size = quantity.text(abs(difference))
    return size if float(size.replace(",", "")) == 0 else f"{'-' if difference < 0 else '+'}{size}"
