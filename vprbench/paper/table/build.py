"""Groups of stored runs -> the cells of Table II: measured beside published, with reasons, machines and a caption."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from statistics import stdev

from vprbench.paper.plan import Plan, Row
from vprbench.paper.published import published
from vprbench.paper.selection import DEVICES, Group, of_row
from vprbench.paper.table.best import Contestant, machine
from vprbench.paper.table.caption import caption
from vprbench.paper.table.cells import Cell, Column, Entry, Measured, Table, TableRow
from vprbench.paper.table.quantities import QUANTITIES, RECALL, Numbers, Quantity
from vprbench.paper.table.reasons import MARKS, Reason, absent, reason
from vprbench.paper.titles import describe_protocol
from vprbench.paper.titles import title as title_of
from vprbench.runs.record import Run
from vprbench.runs.tuned import others_of, tuned_here, tuned_note


def assemble(
    groups: Sequence[Group],
    rows: Sequence[Row],
    plan: Plan,
    left_out: Mapping[tuple[str, str], str],
    quantities: tuple[Quantity, ...] = QUANTITIES,
    title: str | None = None,
) -> Table:
    """Return the table of some rows, a group of columns for each group of runs, one for each of the quantities.

    `left_out` says by the names of column and row where rows stand that take too long. Under a `title` other than the
    paper's the rows stay in their order. Looks at runs, failures and plan alone.
    """
    columns = tuple(_column(group, groups, plan) for group in groups)
    ordered = sorted(rows, key=lambda row: title is None and row.spiking)
    entries = {
        row.name: [
            Entry(row, group, column, {device: of_row(group, row, device) for device in DEVICES})
            for group, column in zip(groups, columns, strict=True)
        ]
        for row in ordered
    }
    sheet = _Sheet(plan, left_out)
    for i, quantity in itertools.product(range(len(columns)), quantities):
        sheet.compare([entries[row.name][i] for row in ordered], quantity)
    made = tuple(
        TableRow(
            row.name,
            row.spiking,
            {(entry.column.name, q.name): sheet.cell(entry, q) for entry in entries[row.name] for q in quantities},
            row.boundary,
        )
        for row in ordered
    )
    machines = tuple(f"{machine}, {day}" for machine, day in sheet.machines.items())
    sentences = tuple(caption(groups, columns, entries, made, quantities))
    return Table(columns, made, sentences, tuple(sheet.notes.values()), machines, quantities, title)


def _column(group: Group, groups: Sequence[Group], plan: Plan) -> Column:
    planned = group.asked.planned
    real = plan.columns[planned.stand_in_for].title if planned.stand_in_for else None
    if not group.runs:
        return Column(planned.name, planned.title, None, None, "no run is stored", real, planned.remark)
    run = group.runs[0]
    n_queries = len(run.outcome)
    return Column(
        group.name,
        title_of(group, groups),
        run.outcome.n_places,
        n_queries,
        describe_protocol(run),
        real,
        planned.remark,
    )


@dataclass
class _Sheet:
    """Compares rows, makes cells, and numbers their notes and machines in the order in which they come."""

    plan: Plan
    left_out: Mapping[tuple[str, str], str]
    printed: Mapping[tuple[str, str], Mapping[str, float | None]] = field(default_factory=published)
    best: dict[tuple[str, str], str | None] = field(default_factory=dict)  # row by column and quantity
    apart: dict[tuple[str, str], Mapping[str, Reason]] = field(default_factory=dict)  # likewise, by row
    notes: dict[str, Reason] = field(default_factory=dict)  # by text
    machines: dict[str, str] = field(default_factory=dict)  # the newest day of each

    def compare(self, entries: Sequence[Entry], quantity: Quantity) -> None:
        """Find which row of a column is best by a test, and which are set apart.

        What was tuned on the places of the column is in no contest.
        """
        there = {entry.row.name: (entry, runs) for entry in entries if (runs := entry.runs(quantity))}
        contest = [
            Contestant(name, runs, not entry.found[entry.device(quantity)].missing_seeds)
            for name, (entry, runs) in there.items()
            if quantity.contends(entry.row) and not any(map(tuned_here, runs))
        ]
        for entry in entries[:1]:
            place = entry.column.name, quantity.name
            self.best[place] = quantity.best(contest)
            self.apart[place] = quantity.set_apart({name: runs for name, (_, runs) in there.items()})

    def cell(self, entry: Entry, quantity: Quantity) -> Cell:
        """Return one cell."""
        row, column = entry.row, entry.column
        published = "" if entry.group.view else entry.group.asked.planned.published or ""  # the paper has no views
        printed = self.printed.get((row.name, published), {})
        value = printed.get(quantity.name)
        empty = Cell(
            mark="not applicable",
            measured=None,
            quoted=None,
            published=value,
            published_mark="none"
            if quantity.name not in printed
            else "not applicable"
            if value is None
            else "measured",
            difference=None,
            notes=(),
        )
        if quantity.source(row) != "measured":
            return empty if quantity.source(row) == "none" else self._quoted(empty, row, quantity)
        runs = entry.runs(quantity)
        if not runs:
            absence = self._absence(entry, quantity)
            return replace(empty, mark=MARKS[absence.code], notes=self._numbers([absence]))
        numbers = quantity.numbers(row, runs)
        if numbers is None:
            return replace(empty, notes=self._numbers([quantity.undefined(runs)]))
        found = entry.found[entry.device(quantity)]
        told = [reason("seeds", row, found)] if found.missing_seeds else []
        told += [reason("fewer", len(runs), len(found.runs))] if len(runs) < len(found.runs) else []
        told += [Reason("tuned", note) for note in filter(None, [tuned_note(entry.runs(RECALL))])]
        told += quantity.remarks(row, runs)
        told += filter(None, [self.apart[column.name, quantity.name].get(row.name)])
        if value is not None:
            told += quantity.differences(row, entry.group.asked.planned, column.stand_in_for, runs[0])
        return replace(
            empty,
            mark="unfinished" if found.missing_seeds else "measured",
            measured=self._measured(entry, quantity, runs, numbers),
            difference=None if value is None or column.stand_in_for else numbers.compared - value,
            notes=self._numbers(told),
        )

    def _quoted(self, empty: Cell, row: Row, quantity: Quantity) -> Cell:
        """Return what the paper says of the pre-training, which is the same whatever is recognised afterwards."""
        said = [cells.get(quantity.name) for (name, _), cells in self.printed.items() if name == row.name]
        known = next((value for value in [empty.published, *said] if value is not None), None)
        if known is None:
            return replace(empty, notes=self._numbers([reason("unpublished")]))
        return replace(
            empty,
            mark="quoted",
            quoted=known,
            published_mark="none" if empty.published is None else "quoted",
            notes=self._numbers([reason("quoted")]),
        )

    def _absence(self, entry: Entry, quantity: Quantity) -> Reason:
        device = entry.device(quantity)
        found = entry.found[device]
        if found.runs and not found.failures:  # which are of these runs, while they were timed
            return quantity.lacking(found.runs)
        if entry.group.number > 1:
            return reason("protocol without runs")
        elsewhere = any(entry.found[other].runs for other in DEVICES if other != device)
        place = (entry.group.asked.planned.name, entry.row.name)
        return absent(entry.row, device, found, elsewhere, self.left_out.get(place))

    def _measured(self, entry: Entry, quantity: Quantity, runs: Sequence[Run], numbers: Numbers) -> Measured:
        interval = numbers.interval
        others = others_of(runs) if quantity.of_answers else ()
        elsewhere = quantity.numbers(entry.row, others) if others else None
        return Measured(
            value=numbers.value,
            low=100 * interval.low if interval else None,
            high=100 * interval.high if interval else None,
            spread=stdev(numbers.values) if len(numbers.values) > 1 else None,
            seeds=tuple(run.config["seed"] for run in runs),
            total=numbers.total,
            at_boundary=numbers.at_boundary,
            best=self.best[entry.column.name, quantity.name] == entry.row.name,
            disturbed=quantity.disturbed(runs),
            machine=self._machine(runs),
            interval=interval.kind if interval else None,
            block=interval.block if interval else None,
            elsewhere=None if elsewhere is None else self._measured(entry, quantity, others, elsewhere),
        )

    def _machine(self, runs: Sequence[Run]) -> int:
        """Return the number of a machine, from 0; the runs of a row share theirs."""
        name = machine(runs[0])
        days = [run.environment["time_utc"][:10] for run in runs]
        self.machines[name] = max([self.machines.get(name, ""), *days])
        return list(self.machines).index(name)

    def _numbers(self, reasons: Sequence[Reason]) -> tuple[int, ...]:
        self.notes |= {told.text: told for told in reasons if told.text not in self.notes}
        known = list(self.notes)
        return tuple(sorted({known.index(told.text) + 1 for told in reasons}))
