"""The cells of Table II, before any format: measured and published numbers, with remarks.

They are one frame: the frame of the runs that rows show (`vprbench.runs.frame`), grouped by row, column and device, and
put beside the numbers that the paper printed.
"""

from __future__ import annotations

import itertools
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import stdev
from typing import Any

import pandas as pd

from vprbench.metrics.intervals import WiderInterval
from vprbench.paper.plan import Plan, Row
from vprbench.paper.published import published
from vprbench.paper.selection import DEVICES, Device, Group, RowRuns, accuracy_device, describe_protocol, of_row
from vprbench.paper.selection import title as title_of
from vprbench.paper.table.best import Contestant
from vprbench.paper.table.quantities import QUANTITIES, RECALL, Quantity
from vprbench.paper.table.remarks import (
    Mark,
    describe_failure,
    explain_absence,
    explain_undefined,
    find_other_timing,
    list_differences,
    list_remarks,
)
from vprbench.runs.frame import tabulate_with_records
from vprbench.runs.recall_intervals import recall_interval
from vprbench.runs.record import Run
from vprbench.runs.tuned import all_without_tuning_places, describe_tuning, overlaps_tuning_places

#: The columns of the frame of cells. Numbers are in the unit of the quantity; what there is not is None.
FACTS = (
    *("row", "column", "quantity"),  # their names
    "mark",  # "measured", or the word for a cell without a number (`remarks.Mark`)
    "value",  # over the seeds: the mean, of minutes and seconds of a fit the median; where mark is "quoted" the paper's
    *("low", "high", "interval", "block"),  # of R@1: 95 % over the queries, of which kind, and queries a block
    *("elsewhere", "elsewhere_low", "elsewhere_high", "elsewhere_spread"),  # of an accuracy, on places not tuned on
    "spread",  # standard deviation over the seeds; None for one
    "seeds",  # those that were measured
    "total",  # of training: with waiting for the images
    "at_boundary",  # of rates: of the step alone that the paper timed
    "best",  # a paired test separates it from every other row
    "disturbed",  # the machine did other things meanwhile, or the laps were too few
    "machine",  # which of the table's machines, from 0
    *("published", "published_mark"),  # mark "none": the paper has no such cell
    "difference",  # measured, of the same step, less published; None on other data
    "notes",  # numbers, from 1, into the table's notes
)


@dataclass(frozen=True)
class Column:
    """A group of columns: one dataset under one protocol."""

    name: str
    title: str
    n_places: int | None  # None where no run is stored
    n_queries: int | None
    protocol: str  # in words
    stand_in_for: str | None  # the title of the real dataset that a rendered one stands in for
    published: str | None = None  # the dataset of the paper's table
    remark: str | None = None  # what a reader has to know of the data


@dataclass(frozen=True)
class Table:
    """Everything that a format of the table prints."""

    cells: pd.DataFrame  # a line for each row, column and quantity: `FACTS`
    columns: tuple[Column, ...]
    rows: tuple[Row, ...]
    notes: tuple[str, ...]  # remarks on cells; note n is notes[n - 1]
    machines: tuple[str, ...]  # one line each
    quantities: tuple[Quantity, ...] = QUANTITIES
    title: str | None = None  # None: Table II, whose spiking rows stand apart
    n_aside: int = 0  # stored runs of its rows that it does not show

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
    facts: Mapping[Device, pd.DataFrame]  # the frame of the runs that are shown, and the runs themselves as `record`

    def device(self, quantity: Quantity) -> Device:
        """Return the device whose runs a cell shows."""
        return quantity.device or accuracy_device(self.found)

    def shown(self, quantity: Quantity) -> pd.DataFrame:
        """Return the frame of the runs that measured a quantity."""
        facts = self.facts[self.device(quantity)]
        if quantity.source(self.row) != "measured":
            return facts[:0]
        return facts if quantity.required is None else facts[facts[quantity.required].notna()]


def assemble(
    groups: Sequence[Group],
    rows: Sequence[Row],
    plan: Plan,
    slow: Collection[tuple[str, str]] = (),
    quantities: tuple[Quantity, ...] = QUANTITIES,
    title: str | None = None,
) -> Table:
    """Return the table of some rows, a group of columns for each group of runs, one for each of the quantities.

    `slow` holds the column and row of cells that are left out for their number of places. Under a `title` other than
    the paper's the rows stay in their order. Looks at runs, failures and plan alone.
    """
    columns = tuple(_describe_column(group, groups, plan) for group in groups)
    ordered = sorted(rows, key=lambda row: title is None and row.spiking)
    entries = _list_entries(ordered, groups, columns, [quantity.name for quantity in quantities if quantity.metric])
    contests = {
        (column.name, quantity.name): _find_best([each for each in entries if each.column is column], quantity)
        for column, quantity in itertools.product(columns, quantities)
    }
    printed = published()
    made = [
        _make_cell(entry, quantity, printed, *contests[entry.column.name, quantity.name], slow)
        for entry, quantity in itertools.product(entries, quantities)
    ]
    notes, machines = _number_notes_and_machines(made)
    cells = pd.DataFrame(made, columns=[*FACTS], dtype=object)
    n_aside = sum(found.n_aside for entry in entries for found in entry.found.values())
    return Table(cells, columns, tuple(ordered), notes, machines, quantities, title, n_aside)


def _describe_column(group: Group, groups: Sequence[Group], plan: Plan) -> Column:
    planned = group.column.planned
    real = plan.columns[planned.stand_in_for].title if planned.stand_in_for else None
    facts = (None, None, "no run is stored", real, planned.published, planned.remark)
    described = Column(planned.name, planned.title, *facts)
    if not group.runs:
        return described
    run = group.runs[0]
    return replace(
        described,
        name=group.name,
        title=title_of(group, groups),
        n_places=run.outcome.n_places,
        n_queries=len(run.outcome),
        protocol=describe_protocol(run),
    )


def _list_entries(
    rows: Sequence[Row], groups: Sequence[Group], columns: Sequence[Column], metrics: Sequence[str]
) -> list[Entry]:
    """Return the stored runs of each row in each column, row by row."""
    entries = []
    for row in rows:
        for group, column in zip(groups, columns, strict=True):
            found = {device: of_row(group, row, device) for device in DEVICES}
            facts = {device: tabulate_with_records(found[device].runs, metrics) for device in DEVICES}
            entries.append(Entry(row, group, column, found, facts))
    return entries


def _find_best(entries: Sequence[Entry], quantity: Quantity) -> tuple[str | None, Mapping[str, str]]:
    """Return which row of a column is best by a test, and by row how it was timed otherwise than the others.

    What was tuned on the places of the column is in no contest.
    """
    there = {entry.row.name: (entry, runs) for entry in entries if (runs := _list_records(entry.shown(quantity)))}
    contest = [
        Contestant(name, runs, not entry.found[entry.device(quantity)].missing_seeds)
        for name, (entry, runs) in there.items()
        if quantity.contends(entry.row) and not any(map(overlaps_tuning_places, runs))
    ]
    timed = {name: runs for name, (_, runs) in there.items()} if quantity.kind == "rate" else {}
    return quantity.best(contest), find_other_timing(timed)


def _list_records(facts: pd.DataFrame) -> tuple[Run, ...]:
    return tuple(facts["record"])


def _make_cell(
    entry: Entry,
    quantity: Quantity,
    printed: Mapping[tuple[str, str], Mapping[str, float | None]],
    best: str | None,
    other_timing: Mapping[str, str],
    slow: Collection[tuple[str, str]],
) -> dict[str, Any]:
    """Return one cell, its notes as text and its machine by name."""
    row, column = entry.row, entry.column
    dataset = "" if entry.group.view else entry.group.column.planned.published or ""  # the paper has no views
    paper = printed.get((row.name, dataset), {})
    value = paper.get(quantity.name)
    mark = "none" if quantity.name not in paper else "not applicable" if value is None else "measured"
    cell: dict[str, Any] = {**dict.fromkeys(FACTS), "row": row.name, "column": column.name, "quantity": quantity.name}
    cell |= {"mark": "not applicable", "published": value, "published_mark": mark, "best": False, "disturbed": False}
    cell["notes"] = []
    source = quantity.source(row)
    if source != "measured":
        return cell if source == "none" else cell | _quote(row, quantity, value, printed)
    facts = entry.shown(quantity)
    runs = _list_records(facts)
    if not runs:
        mark, remark = _explain_absence(entry, quantity, slow)
        return cell | {"mark": mark, "notes": [remark] if remark else []}
    numbers = _compute_numbers(facts, quantity)
    if numbers is None:
        return cell | {"notes": [explain_undefined(quantity, runs)]}
    found = entry.found[entry.device(quantity)]
    notes = [f"seeds: {len(runs)} of {len(row.seeds)}"] if len(runs) < len(row.seeds) else []
    notes += [describe_failure(failure, with_seed=True) for failure in found.failures]
    notes += filter(None, [describe_tuning(_list_records(entry.shown(RECALL)))])
    notes += list_remarks(quantity, row, runs)
    notes += filter(None, [other_timing.get(row.name)])
    if quantity.kind == "rate" and row.boundary is not None:
        numbers["at_boundary"] = quantity.over_seeds([*facts[f"streaming_{row.boundary}_hz"]])
    if value is not None:
        notes += list_differences(quantity, row, entry.group.column.planned, column.stand_in_for, runs[0])
        ours = numbers.get("at_boundary", numbers["value"])
        numbers["difference"] = None if column.stand_in_for else ours - value
    if others := all_without_tuning_places(runs) if quantity.kind == "accuracy" else ():
        names = [quantity.name] if quantity.metric else []
        elsewhere = _compute_numbers(tabulate_with_records(others, names), quantity) or {}
        numbers |= {"elsewhere": elsewhere.pop("value", None)}
        numbers |= {f"elsewhere_{name}": elsewhere.get(name) for name in ("low", "high", "spread")}
    return cell | {
        **numbers,
        "mark": "unfinished" if found.missing_seeds else "measured",
        "best": best == row.name,
        "seeds": tuple(facts["seed"]),
        "disturbed": quantity.kind in ("training", "fit", "rate") and any(facts["disturbed"]),
        "machine": (facts["machine"].iloc[0], max(facts["time_utc"])[:10]),
        "notes": notes,
    }


def _compute_numbers(facts: pd.DataFrame, quantity: Quantity) -> dict[str, Any] | None:
    """Return what runs gave over their seeds, with its interval and spread; None if it is undefined."""
    values = [quantity.in_unit(value) for value in facts[quantity.fact].dropna()]
    if not values:
        return None
    found: dict[str, Any] = {"value": quantity.over_seeds(values)}
    found["spread"] = stdev(values) if len(values) > 1 else None
    if quantity.total is not None:
        totals = [quantity.in_unit(value) for value in facts[quantity.total].dropna()]
        found["total"] = quantity.over_seeds(totals)
    if quantity.fact == RECALL.fact:
        found |= _describe_interval(recall_interval(_list_records(facts)))
    return found


def _describe_interval(interval: WiderInterval | None) -> dict[str, Any]:
    if interval is None:
        return {}
    ends = {"low": 100 * interval.low, "high": 100 * interval.high}
    return {**ends, "interval": interval.kind, "block": interval.block}


def _quote(
    row: Row,
    quantity: Quantity,
    value: float | None,
    printed: Mapping[tuple[str, str], Mapping[str, float | None]],
) -> dict[str, Any]:
    """Return what the paper says of the pre-training, which is the same whatever is recognised afterwards."""
    said = [cells.get(quantity.name) for (name, _), cells in printed.items() if name == row.name]
    known = next((each for each in [value, *said] if each is not None), None)
    if known is None:
        return {"notes": ["pre-trained: no time is published"]}
    return {"mark": "quoted", "value": known, "published_mark": "none" if value is None else "quoted"}


def _explain_absence(entry: Entry, quantity: Quantity, slow: Collection[tuple[str, str]]) -> tuple[Mark, str]:
    device = entry.device(quantity)
    found = entry.found[device]
    if entry.group.number > 1 and not found.runs and not found.failures:
        return "not run", ""
    elsewhere = any(entry.found[other].runs for other in DEVICES if other != device)
    return explain_absence(found, quantity, elsewhere, (entry.group.column.planned.name, entry.row.name) in slow)


def _number_notes_and_machines(cells: Sequence[dict[str, Any]]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Put numbers in the place of the cells' notes and machines, in the order in which they come; returns both.

    A machine is named with the newest day of its runs.
    """
    days: dict[str, str] = {}
    for cell in cells:
        if cell["machine"] is not None:
            name, day = cell["machine"]
            days[name] = max(days.get(name, ""), day)
    notes = [*dict.fromkeys(note for cell in cells for note in cell["notes"])]
    machines = [*days]
    for cell in cells:
        cell["notes"] = tuple(sorted({notes.index(note) + 1 for note in cell["notes"]}))
        cell["machine"] = None if cell["machine"] is None else machines.index(cell["machine"][0])
    return tuple(notes), tuple(f"{name}, {day}" for name, day in days.items())
