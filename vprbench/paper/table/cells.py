"""The cells of Table II, before any format: what was measured, what the paper printed, and why they differ."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from vprbench.metrics.intervals import IntervalKind
from vprbench.paper.plan import Boundary, Row
from vprbench.paper.selection import Device, Group, RowRuns, accuracy_device
from vprbench.paper.table.quantities import QUANTITIES, Quantity
from vprbench.paper.table.reasons import Mark, Reason
from vprbench.runs.record import Run


@dataclass(frozen=True)
class Measured:
    """What the runs of one row on one dataset and device gave, in the unit of its column: %, minutes or Hz."""

    value: float  # the mean over the seeds; of minutes, without waiting for images, the median
    low: float | None  # of R@1, 95 % interval over the queries; of several seeds, of the hits' mean over them
    high: float | None
    spread: float | None  # standard deviation over the seeds; None for one
    seeds: tuple[int, ...]
    total: float | None  # of training: minutes with the images read too
    best: bool  # a paired test separates it from every other row
    disturbed: bool  # the machine did other things meanwhile, or the laps were too few; never of R@1
    machine: int  # which of the table's machines, from 0
    interval: IntervalKind | None = None  # of R@1: what low and high are of
    block: int | None = None  # of R@1: consecutive queries that were taken to be alike
    at_boundary: float | None = None  # of rates: Hz of the step that the paper timed
    elsewhere: Measured | None = None  # of an accuracy: on the other queries, where some show what it was tuned on


@dataclass(frozen=True)
class Cell:
    """One cell: what was measured, or why nothing was, beside what the paper printed."""

    mark: Mark
    measured: Measured | None  # where mark is "measured", and what there is where it is "unfinished"
    quoted: float | None  # where mark is "quoted"
    published: float | None  # None: the paper printed "-", or has no such cell
    published_mark: Literal["measured", "quoted", "not applicable", "none"]  # none: the paper has no such cell
    difference: float | None  # measured, of the same step, less published; None without both or on other data
    notes: tuple[int, ...]  # numbers, from 1, into the table's notes: reasons


@dataclass(frozen=True)
class Column:
    """A group of columns: one dataset under one protocol."""

    name: str
    title: str
    n_places: int | None  # None where no run is stored
    n_queries: int | None
    protocol: str  # in words
    stand_in_for: str | None  # the title of the real dataset that a rendered one stands in for
    remark: str | None = None  # what a reader has to know of the data


@dataclass(frozen=True)
class TableRow:
    """One method."""

    name: str
    spiking: bool
    cells: Mapping[tuple[str, str], Cell]  # by the names of column and quantity
    boundary: Boundary | None = None  # what the paper's query rate covers


@dataclass(frozen=True)
class Table:
    """Everything that a format of the table prints."""

    columns: tuple[Column, ...]
    rows: tuple[TableRow, ...]
    caption: tuple[str, ...]  # sentences
    notes: tuple[Reason, ...]  # note n is notes[n - 1]
    machines: tuple[str, ...]  # one line each
    quantities: tuple[Quantity, ...] = QUANTITIES
    title: str | None = None  # None: Table II, whose spiking rows stand apart

    @property
    def heading(self) -> str:
        """Return what stands above it."""
        return "Table II" if self.title is None else self.title


@dataclass(frozen=True)
class Entry:
    """What is stored of one row in one column."""

    row: Row
    group: Group
    column: Column
    found: Mapping[Device, RowRuns]

    def device(self, quantity: Quantity) -> Device:
        """Return the device whose runs a cell shows."""
        return quantity.device or accuracy_device(self.found)

    def runs(self, quantity: Quantity) -> tuple[Run, ...]:
        """Return the runs that a cell shows."""
        if quantity.source(self.row) != "measured":
            return ()
        return quantity.shown(self.row, self.found[self.device(quantity)].runs)
