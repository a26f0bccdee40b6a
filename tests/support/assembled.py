"""Tables of made-up runs, and how tests look into them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from stored_runs import PLAN, RAIL, ROWS, run

from vprbench.paper.plan import Row
from vprbench.paper.selection import ResolvedColumn, groups
from vprbench.paper.table.build import assemble
from vprbench.paper.table.cells import Cell, Measured, Table
from vprbench.paper.table.quantities import QUANTITIES, Quantity
from vprbench.paper.table.reasons import Reason
from vprbench.run.record import Failure, Run

NAMES = ("recall_at_1", "train_cpu", "query_cpu", "train_gpu", "query_gpu")


def table(
    runs: Sequence[Run] = (),
    failures: Sequence[Failure] = (),
    rows: Sequence[Row] = ROWS,
    asked: Sequence[ResolvedColumn] = (RAIL,),
    left_out: Mapping[tuple[str, str], str] | None = None,
    quantities: tuple[Quantity, ...] = QUANTITIES,
) -> Table:
    return assemble(groups(runs, failures, asked, rows), rows, PLAN, left_out or {}, quantities)


def cell(made: Table, row: str, quantity: str, column: str = "railway") -> Cell:
    return next(each for each in made.rows if each.name == row).cells[column, quantity]


def measured(made: Table, row: str, quantity: str, column: str = "railway") -> Measured:
    found = cell(made, row, quantity, column).measured
    assert found is not None
    return found


def reasons(made: Table, row: str, quantity: str) -> list[Reason]:
    return [made.notes[number - 1] for number in cell(made, row, quantity).notes]


def codes(made: Table, row: str, quantity: str) -> list[str]:
    return [reason.code for reason in reasons(made, row, quantity)]


def tempo(seed: int = 0, **changes: Any) -> Run:
    return run("vprtempo", seed, **changes)


def absences(made: Table, row: str) -> list[str]:
    return [cell(made, row, quantity.name).mark for quantity in QUANTITIES]
