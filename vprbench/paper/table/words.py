"""The text of a table before the markup of any format: its cells, its columns and the facts below it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import pandas as pd

from vprbench.paper.published import PAPER, PAPER_CPU, PAPER_GPU, PROTOCOLS
from vprbench.paper.table import best
from vprbench.paper.table.cells import Column, Table
from vprbench.paper.table.quantities import RATES, RECALL, TRAINING, TRAINING_TIME, Quantity
from vprbench.runs.frame import iterate_rows
from vprbench.runs.recall_intervals import METHOD
from vprbench.text import format_spread, plural

INAPPLICABLE = "-"
_ELSEWHERE = "elsewhere"


def describe_cells(table: Table) -> pd.DataFrame:
    """Return the text of each cell, a line each.

    - `row`, `column`; `kind`: "measured", "quoted" or "absent"; `absence`: "failed", "-" ..., empty for a number
    - `value`: empty for none; `extent`: spread, interval, and in brackets with waiting for images
    - `best`; `machine`: its number from 1, 0 if the table has one machine; `notes`: their numbers
    - `in_paper`: the paper has any cell of the row in the column; `published`: never empty; `published_quoted`
    - `beside`: behind the published number: the rate of the same step here, and the difference
    """
    by_name = {quantity.name: quantity for quantity in table.quantities}
    boundaries = {row.name: row.boundary for row in table.rows}
    printed = table.cells[table.cells["published_mark"] != "none"]
    in_paper = {*zip(printed["row"], printed["column"], strict=True)}
    several = len(table.machines) > 1
    lines = []
    for cell in iterate_rows(table.cells):
        quantity = by_name[cell.quantity]
        absence = {"measured": "", "quoted": "", "not applicable": INAPPLICABLE}.get(cell.mark, cell.mark)
        value = _format_published(cell.value) if cell.mark == "quoted" else ""
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
                "extent": "" if cell.seeds is None else _describe_extent(cell, quantity),
                "best": cell.best,
                "machine": cell.machine + 1 if several and cell.machine is not None else 0,
                "notes": cell.notes,
                "in_paper": (cell.row, cell.column) in in_paper,
                "published": nothing if cell.published is None else _format_published(cell.published),
                "published_quoted": cell.published_mark == "quoted",
                "beside": "" if cell.published is None else _describe_beside(cell, boundaries[cell.row], quantity),
            }
        )
    return pd.DataFrame(lines, dtype=object)


def describe_data(column: Column) -> str:
    """Return the places, the queries and the protocol of a column in one line."""
    counts = [(column.n_places, "places"), (column.n_queries, "queries")]
    parts = [f"{count:,} {noun}" for count, noun in counts if count is not None]
    parts += [column.protocol] if column.protocol else []
    parts += [f"stands in for {column.stand_in_for}"] if column.stand_in_for else []
    return "; ".join(parts)


def list_machines(table: Table) -> list[str]:
    """Return the machines, each after the mark of its cells."""
    several = len(table.machines) > 1
    return [f"{f'M{i}' if several else 'Machine'}: {machine}" for i, machine in enumerate(table.machines, 1)]


def list_facts(table: Table) -> list[str]:
    """Return the sentences that explain a table, the first on its units; none about anything that it does not hold."""
    cells = [*iterate_rows(table.cells)]
    measured = [cell for cell in cells if cell.seeds is not None]
    return [
        *_list_sources(table),
        *_list_runs(table, measured),
        *_list_tests(table),
        *_list_terms(table, cells, measured),
    ]


def _list_sources(table: Table) -> Iterator[str]:
    """Yield the units, the publication and what is known of the data."""
    units = ", ".join(f"{quantity.head} in {quantity.unit}" for quantity in table.quantities if quantity.unit)
    if all(table.cells["published_mark"] == "none"):
        yield f"{units}."
    else:
        yield f"{units}; line paper: {PAPER}, measured on {PAPER_CPU} and {PAPER_GPU}."
    for name in dict.fromkeys(column.published for column in table.columns):
        if (paper := PROTOCOLS.get(name or "")) is not None:
            traverses = f"{'+'.join(sorted(paper.references))} against {paper.query}"
            yield f"Paper, {name}: {paper.queries:,} queries of {paper.places:,} places, {traverses}, no tolerance."
    for column in table.columns:
        if column.stand_in_for is not None:
            yield f"{column.title} is rendered and stands in for {column.stand_in_for}."
    yield from dict.fromkeys(column.remark for column in table.columns if column.remark is not None)


def _list_runs(table: Table, measured: Sequence[Any]) -> Iterator[str]:
    """Yield the seeds, the blocks of the intervals, and the number of runs that are not shown."""
    seeds: dict[str, set[int]] = {}
    for cell in measured:
        seeds.setdefault(cell.row, set()).update(cell.seeds)
    if any(len(each) > 1 for each in seeds.values()):
        named = [f"{name} {' '.join(map(str, sorted(each)))}" for name, each in seeds.items() if len(each) > 1]
        yield f"Seeds (mean; of training the median): {', '.join(named)}."
    for column in table.columns:
        blocks = [
            f"{cell.row} {cell.block}{' (Wilson)' if cell.interval == 'independent' else ''}"
            for cell in measured
            if (cell.column, cell.quantity) == (column.name, RECALL.name) and cell.block is not None
        ]
        if blocks:
            yield f"{column.title}, queries in a block of the intervals: {', '.join(blocks)}."
    if table.n_aside:
        yield f"Not shown: {plural(table.n_aside, 'stored run')} of other code, settings, machine or seeds, or older."


def _list_tests(table: Table) -> Iterator[str]:
    """Yield the meaning of bold marks and of tildes."""
    if any(table.cells["best"]):
        if RECALL in table.quantities:
            yield (
                "Bold R@1: every pair of seeds passes the exact McNemar test, ties broken against the bold row, p "
                f"below {best.CHANCE} / number of other rows, and the interval of the difference lies above 0."
            )
        yield (
            f"Bold times: {best.FASTER} times apart in every pair of seeds, timed alike on one undisturbed machine; "
            f"rates also by the Mann-Whitney U test of their laps, p below {best.RATE_CHANCE}."
        )
    else:
        yield "Nothing is bold: no test separates a row of a column from all others."
    if any(table.cells["disturbed"]):
        yield "Tilde: a busy machine or too few laps; no time beside it is bold."


def _list_terms(table: Table, cells: Sequence[Any], measured: Sequence[Any]) -> Iterator[str]:
    """Yield the meaning of quantities, brackets, italics and words."""
    names = {cell.quantity for cell in measured}
    marks = {mark for cell in cells for mark in (cell.mark, cell.published_mark)}
    if RECALL in table.quantities:
        yield "R@1: share of the queries whose best match is a right place."
    if _any_known(measured, "spread"):
        yield "±: standard deviation over the seeds."
    if _any_known(measured, "low"):
        yield f"Square brackets: 95 % interval of R@1 over the queries, of several seeds of their mean: {METHOD}."
    if _any_known(measured, "elsewhere"):
        yield f"{_ELSEWHERE}: on the queries of places that the row was not tuned on, with the same map."
    if names & {quantity.name for quantity in TRAINING} and _any_known(measured, "total"):
        yield f"Training: {TRAINING_TIME[0].lower()}{TRAINING_TIME[1:]}"
    if names & {quantity.name for quantity in RATES}:
        yield "Query rates: one image at a time from memory, encoding and matching together."
    yield from (quantity.metric.explained for quantity in table.quantities if quantity.metric)
    if _any_known(cells, "difference"):
        yield "Brackets of line paper: measured less printed."
    if any(cell.published is not None and cell.at_boundary is not None for cell in cells):
        yield "The paper's query rates are of one step; brackets hold the rate of that step here."
    if "quoted" in marks:
        yield "Italics: quoted from a publication, not measured; in no contest."
    if "left out" in marks:
        yield "left out: too many places for the time of a table; FULL=1 runs it."
    if "not applicable" in marks:
        yield f"Dash ({INAPPLICABLE}): there is no such step or number."


def _any_known(cells: Iterable[Any], fact: str) -> bool:
    return any(getattr(cell, fact) is not None for cell in cells)


def _describe_extent(cell: Any, quantity: Quantity) -> str:
    parts = [_describe_range(cell.value, cell.spread, cell.low, cell.high, quantity)]
    if cell.total is not None:
        parts.append(f"({quantity.text(cell.total)})")
    if (other := cell.elsewhere) is not None:
        parts.append(f"{_ELSEWHERE} {quantity.text(other)}")
        ends = cell.elsewhere_low, cell.elsewhere_high
        parts.append(_describe_range(other, cell.elsewhere_spread, *ends, quantity))
    return " ".join(filter(None, parts))


def _describe_range(
    value: float, spread: float | None, low: float | None, high: float | None, quantity: Quantity
) -> str:
    """Return the spread over the seeds and the interval, as far as they are known."""
    parts = [] if spread is None else [f"± {format_spread(spread, quantity.text(value))}"]
    if low is not None and high is not None:
        parts.append(f"[{quantity.text(low)}, {quantity.text(high)}]")
    return " ".join(parts)


def _describe_beside(cell: Any, boundary: str | None, quantity: Quantity) -> str:
    alone = cell.at_boundary
    parts = [] if alone is None else [f"{boundary} alone here: {quantity.text(alone)}"]
    return "; ".join(parts if cell.difference is None else [*parts, _format_difference(cell.difference, quantity)])


def _format_published(value: float) -> str:
    """Return a number as a publication printed it: 48 and 0.5, never 48.0 or 0.50."""
    return f"{value:,}".removesuffix(".0")


def _format_difference(difference: float, quantity: Quantity) -> str:
    size = quantity.text(abs(difference))
    return size if float(size.replace(",", "")) == 0 else f"{'-' if difference < 0 else '+'}{size}"
