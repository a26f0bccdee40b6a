"""Groups of stored runs -> the cells of Table II: measured beside published, with reasons, machines and a caption."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from statistics import mean, median, stdev

from vprbench.metrics.accuracy import hits_at, recall_at
from vprbench.paper.plan import QUANTITIES, Plan, Quantity, Row, published
from vprbench.paper.selection import DEVICES, Group, of_row, protocol_words, title
from vprbench.paper.table import best as contests
from vprbench.paper.table import caption as table_caption
from vprbench.paper.table.absence import Absence, absent, one_sentence, stored_seeds
from vprbench.paper.table.best import Contestant
from vprbench.paper.table.cells import Cell, Column, Measured, Table, TableRow
from vprbench.paper.table.comparison import other_timing, reasons
from vprbench.paper.table.entries import RATES, TRAINING, Entry
from vprbench.run.note import DISTURBED, FAILED_AUDITS, NoteKind
from vprbench.run.recall_intervals import recall_interval
from vprbench.run.record import Run
from vprbench.run.tuned import tuned_here, tuned_note

_APART: frozenset[NoteKind] = DISTURBED | {"described", "resumed"}  # told by a mark, or with the training alone


def assemble(
    groups: Sequence[Group], rows: Sequence[Row], plan: Plan, left_out: Mapping[tuple[str, str], str]
) -> Table:
    """Return the table of some rows, a group of columns for each group of runs.

    R@1 is the expected value under ties, the mean over the seeds; query rates are 1 / median of the streaming laps, the
    mean over the seeds; minutes are those of the fit without waiting for images, the median over the seeds (timing
    rules, 2.2). `left_out` says by the names of column and row where rows stand that take too long. Looks at runs,
    failures and plan alone.
    """
    columns = tuple(_column(group, groups, plan) for group in groups)
    ordered = sorted(rows, key=lambda row: row.spiking)
    entries = {
        row.name: [
            Entry(row, group, column, {device: of_row(group, row, device) for device in DEVICES})
            for group, column in zip(groups, columns, strict=True)
        ]
        for row in ordered
    }
    best = {
        (column.name, quantity): _best([entries[row.name][i] for row in ordered], quantity)
        for (i, column), quantity in itertools.product(enumerate(columns), QUANTITIES)
    }
    timed = {
        (column.name, quantity): other_timing(
            {row.name: runs[0] for row in ordered if (runs := entries[row.name][i].runs(quantity))}
        )
        for (i, column), quantity in itertools.product(enumerate(columns), RATES)
    }
    sheet = _Sheet(plan, left_out, best, timed)
    made = tuple(
        TableRow(
            row.name,
            row.spiking,
            {(entry.column.name, q): sheet.cell(entry, q) for entry in entries[row.name] for q in QUANTITIES},
        )
        for row in ordered
    )
    caption = tuple(table_caption.sentences(groups, columns, entries, made))
    machines = tuple(f"{machine}, {day}" for machine, day in sheet.machines.items())
    return Table(columns, made, caption, tuple(sheet.notes), machines)


def _column(group: Group, groups: Sequence[Group], plan: Plan) -> Column:
    planned = group.asked.planned
    real = plan.columns[planned.stand_in_for].title if planned.stand_in_for else None
    if not group.runs:
        return Column(planned.name, planned.title, None, None, "no run is stored", real, planned.remark)
    run = group.runs[0]
    name = planned.name if group.number == 1 else f"{planned.name}-{group.number}"
    n_queries = len(run.outcome)
    return Column(
        name, title(group, groups), run.outcome.n_places, n_queries, protocol_words(run), real, planned.remark
    )


def _best(entries: Sequence[Entry], quantity: Quantity) -> str | None:
    """Return the row of a column that is best by a test.

    What was tuned on its places is in no contest, and what only builds a map in none of training.
    """
    rows = [
        Contestant(entry.row.name, runs, entry.row.boundary, not entry.found[entry.device(quantity)].missing_seeds)
        for entry in entries
        if (runs := entry.runs(quantity))
        and not any(map(tuned_here, runs))
        and not (quantity in TRAINING and entry.row.training == "map")
    ]
    if quantity == "recall_at_1":
        return contests.best_recall(rows)
    return contests.best_training(rows) if quantity in TRAINING else contests.best_rate(rows)


@dataclass
class _Sheet:
    """Makes cells, and numbers their notes and machines in the order in which they come."""

    plan: Plan
    left_out: Mapping[tuple[str, str], str]
    best: Mapping[tuple[str, Quantity], str | None]
    timed: Mapping[tuple[str, Quantity], Mapping[str, str]]  # by row what to say of its rate
    printed: Mapping[tuple[str, str], Mapping[Quantity, float | None]] = field(default_factory=published)
    notes: dict[str, int] = field(default_factory=dict)
    machines: dict[str, str] = field(default_factory=dict)  # the newest day of each

    def cell(self, entry: Entry, quantity: Quantity) -> Cell:
        """Return one cell."""
        row = entry.row
        printed = self.printed.get((row.name, entry.group.asked.planned.published or ""), {})
        value = printed.get(quantity)
        empty = Cell(
            mark="not applicable",
            measured=None,
            quoted=None,
            published=value,
            published_mark="none" if quantity not in printed else "not applicable" if value is None else "measured",
            difference=None,
            notes=(),
        )
        if quantity in TRAINING and not row.learns_here:
            return empty if row.training == "none" else self._quoted(empty, row, quantity)
        runs = entry.runs(quantity)
        if quantity == "recall_at_1" and runs and contests.mean_recall(runs) is None:
            return replace(empty, notes=self._numbers(["no query has a right place"]))
        if not runs:
            absence = self._absence(entry, quantity)
            return replace(empty, mark=absence.mark, notes=self._numbers([absence.reason]))
        measured = self._measured(entry, quantity, runs)
        found = entry.found[entry.device(quantity)]
        texts = [stored_seeds(row, found)] if found.missing_seeds else []
        texts += _remarks(entry, quantity, runs)
        texts += filter(None, [self.timed.get((entry.column.name, quantity), {}).get(row.name)])
        if value is not None:
            texts += reasons(row, entry.group.asked.planned, entry.column.stand_in_for, quantity, runs[0])
        return replace(
            empty,
            mark="unfinished" if found.missing_seeds else "measured",
            measured=measured,
            difference=None if value is None or entry.column.stand_in_for else measured.value - value,
            notes=self._numbers(texts),
        )

    def _quoted(self, empty: Cell, row: Row, quantity: Quantity) -> Cell:
        """Return what the paper says of the pre-training, which is the same whatever is recognised afterwards."""
        said = [cells.get(quantity) for (name, _), cells in self.printed.items() if name == row.name]
        known = next((value for value in [empty.published, *said] if value is not None), None)
        if known is None:
            notes = self._numbers(["trained elsewhere beforehand; how long that took is not published"])
            return replace(empty, notes=notes)
        notes = self._numbers(["quoted from the paper: the pre-training of the network, done elsewhere"])
        return replace(
            empty,
            mark="quoted",
            quoted=known,
            published_mark="none" if empty.published is None else "quoted",
            notes=notes,
        )

    def _absence(self, entry: Entry, quantity: Quantity) -> Absence:
        device = entry.device(quantity)
        found = entry.found[device]
        if found.runs:  # and none of them trained
            loaded = any(run.network is not None for run in found.runs)
            what = "a stored network was loaded" if loaded else "descriptors of an earlier run were used"
            return Absence("not run", f"no training time: {what}")
        if entry.group.number > 1:
            return Absence("not run", "no run of this row under this protocol is stored")
        elsewhere = any(entry.found[other].runs for other in DEVICES if other != device)
        place = (entry.group.asked.planned.name, entry.row.name)
        return absent(entry.row, device, found, elsewhere, self.left_out.get(place))

    def _measured(self, entry: Entry, quantity: Quantity, runs: Sequence[Run]) -> Measured:
        interval = total = None
        if quantity == "recall_at_1":
            values = [100 * float(hits_at(run.outcome, 1).mean()) for run in runs]
            interval = recall_interval(runs)
        elif quantity in TRAINING:
            values = [run.training_compute_seconds / 60 for run in runs if run.training_compute_seconds is not None]
            total = median(run.training_seconds / 60 for run in runs if run.training_seconds is not None)
        else:
            values = [contests.rate(run, entry.row.boundary) for run in runs]
            if entry.row.boundary is not None:
                total = mean(contests.rate(run, None) for run in runs)
        return Measured(
            value=median(values) if quantity in TRAINING else mean(values),
            low=100 * interval.low if interval else None,
            high=100 * interval.high if interval else None,
            spread=stdev(values) if len(values) > 1 else None,
            seeds=tuple(run.config["seed"] for run in runs),
            total=total,
            best=self.best[entry.column.name, quantity] == entry.row.name,
            disturbed=quantity != "recall_at_1" and any(map(contests.disturbed, runs)),
            machine=self._machine(runs),
            interval=interval.kind if interval else None,
            block=interval.block if interval else None,
        )

    def _machine(self, runs: Sequence[Run]) -> int:
        """Return the number of a machine, from 0; the runs of a row share theirs."""
        machine = contests.machine(runs[0])
        days = [run.environment["time_utc"][:10] for run in runs]
        self.machines[machine] = max([self.machines.get(machine, ""), *days])
        return list(self.machines).index(machine)

    def _numbers(self, texts: Sequence[str]) -> tuple[int, ...]:
        return tuple(sorted(self.notes.setdefault(text, len(self.notes) + 1) for text in dict.fromkeys(texts)))


def _remarks(entry: Entry, quantity: Quantity, runs: Sequence[Run]) -> Iterator[str]:
    """Yield what a reader of a number has to know, from the notes of its runs among others."""
    yield from (one_sentence(note, sentences=False) for note in map(tuned_note, runs) if note)
    if quantity in TRAINING:
        if entry.row.training == "map":
            yield "the time to build the map from the references"
        yield from _told(runs, lambda kind: kind == "resumed")
        return
    if quantity in RATES and entry.row.boundary is None:
        yield "encode and match together: the paper has no such row"
    if quantity == "recall_at_1":
        recalls = [recall for run in runs if (recall := recall_at(run.outcome, 1)) is not None]
        if any(recall.hangs_on_ties for recall in recalls):
            low, high = (100 * mean(getattr(r, way) for r in recalls) for way in ("pessimistic", "optimistic"))
            yield f"scores tie: R@1 is {low:.1f} to {high:.1f} %, by how ties are broken; given is its expected value"
    yield from _told(runs, lambda kind: kind not in _APART and (kind in FAILED_AUDITS) == (quantity in RATES))


def _told(runs: Sequence[Run], of: Callable[[NoteKind], bool]) -> Iterator[str]:
    return (one_sentence(note.text, sentences=False) for run in runs for note in run.notes if of(note.kind))
