"""The cells of a table, before any format: measured and published numbers, with remarks.

They are one frame: the frame of the runs that rows show (`vprbench.runs.frame`), grouped by row, column and device, and
put beside published numbers. Remarks are short codes, or fixed words of the plan.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from statistics import mean, stdev
from typing import Any, NamedTuple

import pandas as pd

from vprbench.metrics.accuracy import compute_recall
from vprbench.report.plan import Plan, Row
from vprbench.report.selection import DEVICES, DatasetRuns, Device, MethodRuns, select_row_runs
from vprbench.report.table.quantities import RECALL, TIMES, Quantity
from vprbench.runs.frame import tabulate_with_records
from vprbench.runs.notes import DISTURBED
from vprbench.runs.recall_intervals import estimate_interval
from vprbench.runs.record import Failure, Run
from vprbench.runs.tuned import all_without_tuning_places, describe_tuning, overlaps_tuning_places
from vprbench.text import NOTHING, format_percent, format_spread

#: The columns of the frame of cells. Numbers are in the unit of the quantity; an absent one is None.
FACTS = (
    *("row", "column", "quantity"),  # their names
    # "measured" by this harness, "quoted" from a publication, or the word for a cell without a number: "not applicable"
    # (there is no such step), "not there" (weights or frames are missing), "failed", "left out" (too many places for
    # the time of the table), "unfinished" (some seeds are not stored), "not timed", "not run"
    "mark",
    "value",  # over the seeds: the mean, of minutes and seconds of a fit the median; the published one of a quoted cell
    *("low", "high", "interval", "block"),  # of accuracies per query: 95 % over the queries, kind, queries a block
    *("elsewhere", "elsewhere_low", "elsewhere_high"),  # of an accuracy, on places not tuned on
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

#: More columns: the same as text; empty where there is none.
TEXTS = (
    "absence",  # "failed", "-" ...
    "text",  # the number
    "extent",  # its spread, interval, in brackets with waiting for images, and the number elsewhere
    "printed",  # the published number, in brackets the rate of the same step here and the difference
)

#: Kinds of quantities that show a run's notes of some kinds; a tilde or another cell shows the others.
_SHOWN_BY = {
    **dict.fromkeys([*DISTURBED, "offline", "described"], ()),
    "fitted": ("training", "fit"),
    "answers": ("rate",),
}


class Cells(NamedTuple):
    """The cells of a table with their notes and machines: fields of a `Report`."""

    cells: pd.DataFrame  # a line for each row, column and quantity: `FACTS` and `TEXTS`
    notes: tuple[str, ...]  # remarks on cells; note n is notes[n - 1]
    machines: tuple[str, ...]  # one line each
    n_aside: int  # stored runs of the rows that the table does not show


@dataclass(frozen=True)
class _Entry:
    """The stored runs of one row in one column, by the kind of device; None: that of the accuracy."""

    row: Row
    group: DatasetRuns
    is_slow: bool
    found: Mapping[Device | None, MethodRuns]
    facts: Mapping[Device | None, pd.DataFrame]  # the frame of the runs, and the runs themselves as `record`

    def select_facts(self, quantity: Quantity) -> pd.DataFrame:
        """Return the frame of the runs that measured a quantity."""
        facts = self.facts[quantity.device]
        if quantity.find_source(self.row) != "measured":
            return facts[:0]
        return facts[facts[quantity.fact].notna()] if quantity.kind in TIMES else facts


def tabulate(plan: Plan, groups: Sequence[DatasetRuns], quantities: Sequence[Quantity]) -> Cells:
    """Return the cells of a plan's rows, a group of columns for each group of runs, one for each of the quantities."""
    metrics = [quantity.name for quantity in quantities if quantity.metric]
    made: list[dict[str, Any]] = []
    n_aside = 0
    for group in groups:
        entries = []
        for row in plan.rows:
            found: dict[Device | None, MethodRuns] = {each: select_row_runs(group, row, each) for each in DEVICES}
            facts = {device: tabulate_with_records(one.runs, metrics) for device, one in found.items()}
            of_accuracy = max(DEVICES, key=lambda device: found[device].coverage)
            found[None], facts[None] = found[of_accuracy], facts[of_accuracy]
            entries.append(_Entry(row, group, plan.is_slow(group.column, row), found, facts))
            n_aside += sum(found[device].n_aside for device in DEVICES)
        for quantity in quantities:
            best = _find_best(entries, quantity)
            for entry in entries:
                cell = _make_cell(entry, quantity, plan)
                made.append({**cell, "best": best == entry.row.name, **_format_cell(cell, entry.row, quantity)})
    names = [row.name for row in plan.rows]
    made.sort(key=lambda cell: names.index(cell["row"]))
    notes, machines = _number_notes_and_machines(made)
    frame = pd.DataFrame(made, columns=[*FACTS, *TEXTS], dtype=object)
    return Cells(frame, notes, machines, n_aside)


def _find_best(entries: Sequence[_Entry], quantity: Quantity) -> str | None:
    """Return the row of a column that is best by a test; rows tuned on places of the column are in no contest."""
    contest = []
    for entry in entries:
        runs = tuple(entry.select_facts(quantity)["record"])
        if runs and not any(map(overlaps_tuning_places, runs)):
            contest.append(MethodRuns(entry.row.name, runs, entry.found[quantity.device].missing_seeds))
    return quantity.best(contest)


def _make_cell(entry: _Entry, quantity: Quantity, plan: Plan) -> dict[str, Any]:
    """Return one cell, its notes as text and its machine by name and day."""
    row, column = entry.row, entry.group.column
    found, facts = entry.found[quantity.device], entry.select_facts(quantity)
    dataset = "" if entry.group.view else column.published or ""  # no number of a view is published
    printed = plan.published.numbers.get((row.name, dataset), {}) if plan.published else {}
    value = printed.get(quantity.name)
    mark = "none" if quantity.name not in printed else "not applicable" if value is None else "measured"
    cell = {**dict.fromkeys(FACTS), "row": row.name, "column": entry.group.name, "quantity": quantity.name}
    cell |= {"mark": "not applicable", "published": value, "published_mark": mark, "disturbed": False, "notes": []}
    if (source := quantity.find_source(row)) != "measured":
        is_quoted = source == "quoted" and value is not None
        return cell | ({"mark": "quoted", "value": value, "published_mark": "quoted"} if is_quoted else {})
    if facts.empty:
        absence = _find_absence(entry, quantity)
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
        numbers |= {f"elsewhere_{end}": there.get(end) for end in ("low", "high")}
    notes = [f"seeds: {len(runs)} of {len(row.seeds)}"] if len(runs) < len(row.seeds) else []
    notes += [_describe_failure(failure, f" seed {failure.config['seed']}") for failure in found.failures]
    notes += _list_remarks(entry, quantity, runs)
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


def _find_absence(entry: _Entry, quantity: Quantity) -> str:
    """Return the word in a cell that no run measured."""
    found = entry.found[quantity.device]
    if found.failures:
        return "not there" if all(failure.missing for failure in found.failures) else "failed"
    if found.runs:
        return "not timed" if quantity.kind == "rate" else "not run"
    if quantity.device == "cuda" or any(other.runs for other in entry.found.values()) or entry.group.number > 1:
        return "not run"
    return "left out" if entry.is_slow else "unfinished"


def _describe_failure(failure: Failure, seed: str = "") -> str:
    """Return the code of a failure and the first line of its error."""
    line = next(iter(failure.error.strip().splitlines()), "")
    return f"{'missing' if failure.missing else 'failed'}{seed}: {line}"


def _explain_undefined(quantity: Quantity, runs: Sequence[Run]) -> str:
    """Return why a quantity is undefined in all runs of a row."""
    reasons = [run.energy["how"].get(quantity.name) for run in runs if run.energy is not None]
    return next(filter(None, reasons), "no query has a right place")


def _list_remarks(entry: _Entry, quantity: Quantity, runs: Sequence[Run]) -> Iterator[str]:
    """Yield the remark on tuning, the codes `time to build the map` and `ties`, and the runs' notes on a quantity."""
    if tuning := describe_tuning(entry.found[None].runs):
        yield tuning
    if quantity.kind == "training" and entry.row.training == "map":
        yield "time to build the map"
    recalls = (
        [recall for run in runs if (recall := compute_recall(run.outcome, 1))] if quantity.name == RECALL.name else []
    )
    if any(recall.hangs_on_ties for recall in recalls):
        low, high = mean(each.pessimistic for each in recalls), mean(each.optimistic for each in recalls)
        yield f"ties: R@1 {format_percent(low)} to {format_percent(high)} %"
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


def _format_cell(cell: Mapping[str, Any], row: Row, quantity: Quantity) -> dict[str, str]:
    """Return the `TEXTS` of a cell."""
    mark, text, extent, printed = str(cell["mark"]), "", "", ""
    absence = {"measured": "", "quoted": "", "not applicable": NOTHING}.get(mark, mark)
    if mark == "quoted":
        text = _format_published(cell["value"])
    elif cell["seeds"] is not None:
        absence = absence and f"{absence}:"
        text, extent = f"{'~' * cell['disturbed']}{quantity.text(cell['value'])}", _describe_extent(cell, quantity)
    if cell["published_mark"] != "none":
        published, beside = cell["published"], _describe_beside(cell, row.boundary, quantity)
        printed = NOTHING if published is None else f"{_format_published(published)}{beside}"
    return dict(zip(TEXTS, (absence, text, extent, printed), strict=True))


def _describe_extent(cell: Mapping[str, Any], quantity: Quantity) -> str:
    """Return the spread over the seeds, the interval, the total, and the number elsewhere, as far as they are known."""
    value, text = quantity.text(cell["value"]), quantity.text
    parts = [] if cell["spread"] is None else [f"± {format_spread(cell['spread'], value)}"]
    parts += [] if cell["low"] is None else [f"[{text(cell['low'])}, {text(cell['high'])}]"]
    parts += [] if cell["total"] is None else [f"({text(cell['total'])})"]
    parts += [] if cell["elsewhere"] is None else [f"elsewhere {text(cell['elsewhere'])}"]
    if cell["elsewhere_low"] is not None:
        parts.append(f"[{text(cell['elsewhere_low'])}, {text(cell['elsewhere_high'])}]")
    return " ".join(parts)


def _describe_beside(cell: Mapping[str, Any], boundary: str | None, quantity: Quantity) -> str:
    """Return in brackets the rate of the published step alone, and the measured number less the printed."""
    alone, difference = cell["at_boundary"], cell["difference"]
    parts = [] if alone is None else [f"{boundary} alone here: {quantity.text(alone)}"]
    if difference is not None:
        size = quantity.text(abs(difference))
        sign = "" if float(size.replace(",", "")) == 0 else "-" if difference < 0 else "+"
        parts.append(f"{sign}{size}")
    return f" ({'; '.join(parts)})" if parts else ""


def _format_published(value: float) -> str:
    """Return a number as a publication printed it: 48 and 0.5, never 48.0 or 0.50."""
    return f"{value:,}".removesuffix(".0")
