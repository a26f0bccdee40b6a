"""The cells of a table, before any format: measured and published numbers, with remarks.

They are one frame: the frame of the runs that rows show (`vprbench.runs.frame`), grouped by row, column and device, and
put beside published numbers. Remarks are short codes, or fixed words of the plan.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from statistics import mean, stdev
from typing import Any, Literal

import pandas as pd

from vprbench.metrics.accuracy import recall_at
from vprbench.report.plan import PlanFile, Published, Row
from vprbench.report.selection import (
    DEVICES,
    DatasetRuns,
    Device,
    RowRuns,
    choose_accuracy_device,
    describe_protocol,
    select_row_runs,
)
from vprbench.report.selection import format_title as title_of
from vprbench.report.table.best import Contestant
from vprbench.report.table.quantities import QUANTITIES, RECALL, TIMES, Quantity
from vprbench.runs.frame import tabulate_with_records
from vprbench.runs.notes import DISTURBED
from vprbench.runs.recall_intervals import estimate_interval
from vprbench.runs.record import Failure, Run
from vprbench.runs.tuned import all_without_tuning_places, describe_tuning, overlaps_tuning_places

Mark = Literal[
    "measured",  # by this harness, on the machine that the cell names
    "quoted",  # copied from a publication: in italics, in no contest
    "not applicable",  # there is no such step: printed as -
    "not there",  # the method, its weights or the frames are missing; the row fills by itself once they are there
    "failed",
    "left out",  # too many places for this row within the time of the table
    "unfinished",  # some of the seeds are not stored yet, or none
    "not timed",  # answers are stored, and no rates with them
    "not run",  # no run of this kind is stored, as on a machine without a GPU
]

#: The columns of the frame of cells. Numbers are in the unit of the quantity; an absent one is None.
FACTS = (
    *("row", "column", "quantity"),  # their names
    "mark",  # "measured", or the word for a cell without a number (`Mark`)
    "value",  # over the seeds: the mean, of minutes and seconds of a fit the median; the published one of a quoted cell
    *("low", "high", "interval", "block"),  # of accuracies per query: 95 % over the queries, kind, queries a block
    *("elsewhere", "elsewhere_low", "elsewhere_high", "elsewhere_spread"),  # of an accuracy, on places not tuned on
    "spread",  # standard deviation over the seeds; None for one
    "seeds",  # those that were measured
    "total",  # of training: with waiting for the images
    "at_boundary",  # of rates: of the step alone whose rate is published
    "best",  # a paired test separates it from every other row
    "disturbed",  # the machine did other things meanwhile, or the laps were too few
    "machine",  # which of the table's machines, from 0
    *("published", "published_mark"),  # mark "none": no such cell is published
    "difference",  # measured, of the same step, less published; None on other data
    "notes",  # numbers, from 1, into the table's notes
)

#: Kinds of quantities that show a run's notes of some kinds; a tilde or another cell shows the others.
_SHOWN_BY = {
    **dict.fromkeys([*DISTURBED, "offline", "described"], ()),
    "fitted": ("training", "fit"),
    "answers": ("rate",),
}


@dataclass(frozen=True)
class Column:
    """A group of columns: one dataset under one protocol."""

    name: str
    title: str
    n_places: int | None  # None where no run is stored
    n_queries: int | None
    protocol: str  # in words
    stand_in_for: str | None  # the title of the real dataset that a rendered one stands in for
    published: str | None = None  # its name in the published table
    remark: str | None = None  # fixed words on the data


@dataclass(frozen=True)
class Table:
    """The content of a table in every format."""

    cells: pd.DataFrame  # a line for each row, column and quantity: `FACTS`
    columns: tuple[Column, ...]
    rows: tuple[Row, ...]
    notes: tuple[str, ...]  # remarks on cells; note n is notes[n - 1]
    machines: tuple[str, ...]  # one line each
    quantities: tuple[Quantity, ...] = QUANTITIES
    title: str | None = None  # None: of the published table, whose spiking rows stand apart
    n_aside: int = 0  # stored runs of its rows that it does not show
    published: Published | None = None  # the table that it stands beside

    @property
    def heading(self) -> str:
        """Return the title above it."""
        return self.title or (self.published.title if self.published else "Runs")


@dataclass(frozen=True)
class _Entry:
    """The stored runs of one row in one column."""

    row: Row
    group: DatasetRuns
    found: Mapping[Device, RowRuns]
    facts: Mapping[Device, pd.DataFrame]  # the frame of the runs that are shown, and the runs themselves as `record`

    def choose_runs(self, quantity: Quantity) -> RowRuns:
        """Return the runs of the device that a cell shows."""
        return self.found[quantity.device or choose_accuracy_device(self.found)]

    def select_facts(self, quantity: Quantity) -> pd.DataFrame:
        """Return the frame of the runs that measured a quantity."""
        facts = self.facts[quantity.device or choose_accuracy_device(self.found)]
        if quantity.find_source(self.row) != "measured":
            return facts[:0]
        return facts[facts[quantity.fact].notna()] if quantity.kind in TIMES else facts


def assemble_table(
    groups: Sequence[DatasetRuns],
    rows: Sequence[Row],
    plan: PlanFile,
    slow: Collection[tuple[str, str]] = (),
    quantities: tuple[Quantity, ...] = QUANTITIES,
    title: str | None = None,
) -> Table:
    """Return the table of some rows, a group of columns for each group of runs, one for each of the quantities.

    `slow` holds the column and row of cells that are left out for their number of places. Under a `title` of their
    own the rows stay in their order.
    """
    columns = tuple(_describe_column(group, groups, plan) for group in groups)
    ordered = tuple(sorted(rows, key=lambda row: title is None and row.spiking))
    metrics = [quantity.name for quantity in quantities if quantity.metric]
    cells: dict[tuple[str, str, str], dict[str, Any]] = {}
    n_aside = 0
    for group, column in zip(groups, columns, strict=True):
        entries = []
        for row in ordered:
            found = {device: select_row_runs(group, row, device) for device in DEVICES}
            facts = {device: tabulate_with_records(found[device].runs, metrics) for device in DEVICES}
            entries.append(_Entry(row, group, found, facts))
            n_aside += sum(each.n_aside for each in found.values())
        for quantity in quantities:
            best = _find_best(entries, quantity)
            for entry in entries:
                cell = _make_cell(entry, column, quantity, plan.published, (column.name, entry.row.name) in slow)
                cells[entry.row.name, column.name, quantity.name] = {**cell, "best": best == entry.row.name}
    made = [cells[row.name, column.name, one.name] for row in ordered for column in columns for one in quantities]
    notes, machines = _number_notes_and_machines(made)
    frame = pd.DataFrame(made, columns=[*FACTS], dtype=object)
    return Table(frame, columns, ordered, notes, machines, quantities, title, n_aside, plan.published)


def _describe_column(group: DatasetRuns, groups: Sequence[DatasetRuns], plan: PlanFile) -> Column:
    planned = group.column.planned
    real = plan.columns[planned.stand_in_for].title if planned.stand_in_for else None
    known = (real, planned.published, planned.remark)
    if not group.runs:
        return Column(planned.name, planned.title, None, None, "no run is stored", *known)
    run = group.runs[0]
    counts = run.outcome.n_places, len(run.outcome)
    return Column(group.name, title_of(group, groups), *counts, describe_protocol(run), *known)


def _find_best(entries: Sequence[_Entry], quantity: Quantity) -> str | None:
    """Return the row of a column that is best by a test.

    Rows tuned on places of the column are in no contest, nor is a row that trains nothing in that of training.
    """
    contest = [
        Contestant(entry.row.name, runs, not entry.choose_runs(quantity).missing_seeds)
        for entry in entries
        if (runs := tuple(entry.select_facts(quantity)["record"]))
        and not (quantity.kind == "training" and entry.row.training == "map")
        and not any(map(overlaps_tuning_places, runs))
    ]
    return quantity.best(contest)


def _make_cell(
    entry: _Entry, column: Column, quantity: Quantity, published: Published | None, is_slow: bool
) -> dict[str, Any]:
    """Return one cell, its notes as text and its machine by name and day."""
    row, found, facts = entry.row, entry.choose_runs(quantity), entry.select_facts(quantity)
    dataset = "" if entry.group.view else column.published or ""  # no number of a view is published
    printed = published.numbers.get((row.name, dataset), {}) if published else {}
    value = printed.get(quantity.name)
    mark = "none" if quantity.name not in printed else "not applicable" if value is None else "measured"
    cell: dict[str, Any] = {**dict.fromkeys(FACTS), "row": row.name, "column": column.name, "quantity": quantity.name}
    cell |= {"mark": "not applicable", "published": value, "published_mark": mark, "disturbed": False, "notes": []}
    if (source := quantity.find_source(row)) != "measured":
        is_quoted = source == "quoted" and value is not None
        return cell | ({"mark": "quoted", "value": value, "published_mark": "quoted"} if is_quoted else {})
    if facts.empty:
        absence = _find_absence(entry, quantity, is_slow)
        failures = [one for one in found.failures if one.missing == (absence == "not there")]
        return cell | {"mark": absence, "notes": [_describe_failure(one) for one in failures[:1]]}
    runs = tuple(facts["record"])
    numbers = _compute_numbers(facts, quantity)
    if numbers is None:
        return cell | {"notes": [f"undefined: {_explain_undefined(quantity, runs)}"]}
    if quantity.kind == "rate" and row.boundary is not None:
        numbers["at_boundary"] = quantity.over_seeds([*facts[f"streaming_{row.boundary}_hz"]])
    if value is not None and not column.stand_in_for:
        numbers["difference"] = numbers.get("at_boundary", numbers["value"]) - value
    if others := all_without_tuning_places(runs) if quantity.kind == "accuracy" else ():
        there = _compute_numbers(tabulate_with_records(others, [quantity.name]), quantity) or {}
        numbers["elsewhere"] = there.get("value")
        numbers |= {f"elsewhere_{name}": there.get(name) for name in ("low", "high", "spread")}
    notes = [f"seeds: {len(runs)} of {len(row.seeds)}"] if len(runs) < len(row.seeds) else []
    notes += [_describe_failure(failure, f" seed {failure.config['seed']}") for failure in found.failures]
    notes += filter(None, [describe_tuning(tuple(entry.select_facts(RECALL)["record"]))])
    notes += _list_remarks(quantity, row, runs)
    if quantity.kind == "rate" and value is not None and row.rate_remark is not None:
        notes.append(row.rate_remark)
    return cell | {
        **numbers,
        "mark": "unfinished" if found.missing_seeds else "measured",
        "seeds": tuple(facts["seed"]),
        "disturbed": quantity.kind in TIMES and any(facts["disturbed"]),
        "machine": (facts["machine"].iloc[0], max(facts["time_utc"])[:10]),
        "notes": notes,
    }


def _compute_numbers(facts: pd.DataFrame, quantity: Quantity) -> dict[str, Any] | None:
    """Return the value of runs over their seeds, with its interval and spread; None if it is undefined."""
    values = [quantity.in_unit(value) for value in facts[quantity.fact].dropna()]
    if not values:
        return None
    found: dict[str, Any] = {"value": quantity.over_seeds(values)}
    found["spread"] = stdev(values) if len(values) > 1 else None
    if quantity.total is not None:
        found["total"] = quantity.over_seeds([quantity.in_unit(value) for value in facts[quantity.total].dropna()])
    if quantity.metric is not None and (interval := estimate_interval(tuple(facts["record"]), quantity.metric)):
        ends = {"low": quantity.in_unit(interval.low), "high": quantity.in_unit(interval.high)}
        found |= {**ends, "interval": interval.kind, "block": interval.block}
    return found


def _find_absence(entry: _Entry, quantity: Quantity, is_slow: bool) -> Mark:
    """Return the word in a cell that no run measured."""
    found = entry.choose_runs(quantity)
    if found.failures:
        return "not there" if all(failure.missing for failure in found.failures) else "failed"
    if found.runs:
        return "not timed" if quantity.kind == "rate" else "not run"
    if quantity.device == "cuda" or any(other.runs for other in entry.found.values()) or entry.group.number > 1:
        return "not run"
    return "left out" if is_slow else "unfinished"


def _describe_failure(failure: Failure, seed: str = "") -> str:
    """Return the code of a failure and the first line of its error."""
    line = next(iter(failure.error.strip().splitlines()), "")
    return f"{'missing' if failure.missing else 'failed'}{seed}: {line}"


def _explain_undefined(quantity: Quantity, runs: Sequence[Run]) -> str:
    """Return why a quantity is undefined in all runs of a row."""
    reasons = [run.energy["how"].get(quantity.name) for run in runs if run.energy is not None]
    return next(filter(None, reasons), "no query has a right place")


def _list_remarks(quantity: Quantity, row: Row, runs: Sequence[Run]) -> Iterator[str]:
    """Yield the notes of runs that belong to a quantity, and the codes `ties` and `time to build the map`."""
    if quantity.kind == "training" and row.training == "map":
        yield "time to build the map"
    recalls = [recall for run in runs if (recall := recall_at(run.outcome, 1))] if quantity.name == RECALL.name else []
    if any(recall.hangs_on_ties for recall in recalls):
        low, high = mean(each.pessimistic for each in recalls), mean(each.optimistic for each in recalls)
        yield f"ties: R@1 {100 * low:.1f} to {100 * high:.1f} %"
    for note in (note for run in runs for note in run.notes):
        if quantity.kind in _SHOWN_BY.get(note.kind, ("accuracy",)):
            yield note.text


def _number_notes_and_machines(cells: Sequence[dict[str, Any]]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Put numbers in the place of the cells' notes and machines, in the order in which they come; returns both.

    A machine is named with the newest day of its runs.
    """
    days: dict[str, str] = {}
    for name, day in (cell["machine"] for cell in cells if cell["machine"] is not None):
        days[name] = max(days.get(name, ""), day)
    notes, machines = [*dict.fromkeys(note for cell in cells for note in cell["notes"])], [*days]
    for cell in cells:
        cell["notes"] = tuple(sorted({notes.index(note) + 1 for note in cell["notes"]}))
        cell["machine"] = None if cell["machine"] is None else machines.index(cell["machine"][0])
    return tuple(notes), tuple(f"{name}, {day}" for name, day in days.items())
