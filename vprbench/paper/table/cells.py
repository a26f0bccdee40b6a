"""The cells of Table II, before any format: what was measured, what the paper printed, and why they differ."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from vprbench.metrics.intervals import IntervalKind
from vprbench.paper.plan import Quantity

Mark = Literal[
    "measured",  # by this harness, on the machine that the cell names
    "quoted",  # copied from a publication: in italics, in no contest
    "not applicable",  # there is no such step: printed as -
    "not there",  # the method, its weights or the frames are missing; the row fills by itself once they are not
    "failed",
    "left out",  # too many places for this row within the time of the table
    "unfinished",  # some of the seeds are not stored yet, or none
    "not run",  # no run of this kind is stored, as on a machine without a GPU
]


@dataclass(frozen=True)
class Measured:
    """What the runs of one row on one dataset and device gave, in the unit of its column: %, minutes or Hz."""

    value: float  # the mean over the seeds; of minutes, without waiting for images, the median
    low: float | None  # of R@1, 95 % interval over the queries; of several seeds, of the hits' mean over them
    high: float | None
    spread: float | None  # standard deviation over the seeds; None for one
    seeds: tuple[int, ...]
    total: float | None  # rates: Hz at encode + match; training: minutes with the images read too
    best: bool  # a paired test separates it from every other row
    disturbed: bool  # the machine did other things meanwhile, or the laps were too few; never of R@1
    machine: int  # which of the table's machines, from 0
    interval: IntervalKind | None = None  # of R@1: what low and high are of
    block: int | None = None  # of R@1: consecutive queries that were taken to be alike


@dataclass(frozen=True)
class Cell:
    """One cell: what was measured, or why nothing was, beside what the paper printed."""

    mark: Mark
    measured: Measured | None  # where mark is "measured", and what there is where it is "unfinished"
    quoted: float | None  # where mark is "quoted"
    published: float | None  # None: the paper printed "-", or has no such cell
    published_mark: Literal["measured", "quoted", "not applicable", "none"]  # none: the paper has no such cell
    difference: float | None  # measured less published; None where there are not both, or they are of other data
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
    cells: Mapping[tuple[str, Quantity], Cell]  # by the column's name and the quantity


@dataclass(frozen=True)
class Table:
    """Everything that a format of the table prints."""

    columns: tuple[Column, ...]
    rows: tuple[TableRow, ...]
    caption: tuple[str, ...]  # sentences
    notes: tuple[str, ...]  # note n is notes[n - 1]
    machines: tuple[str, ...]  # one line each
