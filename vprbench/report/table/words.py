"""The text of a table before the markup of any format: its cells, its columns and the facts below it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pandas as pd

from vprbench.report.published import PAPER, PAPER_CPU, PAPER_GPU, PROTOCOLS
from vprbench.report.table.cells import Column, Table
from vprbench.report.table.quantities import RATES, RECALL, TRAINING, TRAINING_TIME, Quantity
from vprbench.runs.frame import iterate_rows
from vprbench.runs.recall_intervals import METHOD
from vprbench.text import format_spread, plural

INAPPLICABLE = "-"
_ELSEWHERE = "elsewhere"


def describe_cells(table: Table) -> pd.DataFrame:
    """Return the cells with their text in more columns.

    - `absence`: "failed", "-" ..., empty for a number
    - `text`: the number, empty for none; `extent`: its spread, interval, and in brackets with waiting for images
    - `printed`: the paper's number, "none" for none; `beside`: the rate of the same step here, and the difference
    """
    by_name = {quantity.name: quantity for quantity in table.quantities}
    boundaries = {row.name: row.boundary for row in table.rows}
    lines = []
    for cell in iterate_rows(table.cells):
        quantity = by_name[cell.quantity]
        absence = {"measured": "", "quoted": "", "not applicable": INAPPLICABLE}.get(cell.mark, cell.mark)
        text, extent, beside = _format_published(cell.value) if cell.mark == "quoted" else "", "", ""
        printed = "none" if cell.published_mark == "none" else INAPPLICABLE
        if cell.seeds is not None:
            text, extent = ("~" if cell.disturbed else "") + quantity.text(cell.value), _describe_extent(cell, quantity)
        if cell.published is not None:
            printed = _format_published(cell.published)
            beside = _describe_beside(cell, boundaries[cell.row], quantity)
        lines.append((f"{absence}:" if absence and text else absence, text, extent, printed, beside))
    texts = pd.DataFrame(lines, columns=["absence", "text", "extent", "printed", "beside"], dtype=object)
    return table.cells.join(texts)


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
    """Return the legend of a table: units, sources, seeds and blocks of its numbers, then fixed words on its marks."""
    names = {quantity.name for quantity in table.quantities}
    is_papers = any(table.cells["published_mark"] != "none")
    units = ", ".join(f"{quantity.head} in {quantity.unit}" for quantity in table.quantities if quantity.unit)
    published = dict.fromkeys(column.published for column in table.columns if column.published is not None)
    return [
        f"{units}; line paper: {PAPER}, measured on {PAPER_CPU} and {PAPER_GPU}." if is_papers else f"{units}.",
        *(f"Paper, {name}: {PROTOCOLS[name]}." for name in published if is_papers and name in PROTOCOLS),
        *(f"{c.title} is rendered and stands in for {c.stand_in_for}." for c in table.columns if c.stand_in_for),
        *dict.fromkeys(column.remark for column in table.columns if column.remark is not None),
        *_list_seeds_and_blocks(table),
        *(
            [f"Not shown: {plural(table.n_aside, 'stored run')} of other code, settings or seeds."]
            * bool(table.n_aside)
        ),
        *(_RECALL_WORDS if RECALL.name in names else ()),
        *(quantity.metric.explained for quantity in table.quantities if quantity.metric),
        *(
            [f"Training: {TRAINING_TIME[0].lower()}{TRAINING_TIME[1:]}"]
            if any(q in TRAINING for q in table.quantities)
            else []
        ),
        *([_RATE_WORDS] if any(quantity in RATES for quantity in table.quantities) else []),
        _MARK_WORDS,
        *(_PAPER_WORDS if is_papers else ()),
    ]


_RECALL_WORDS = (
    "R@1: share of the queries whose best match is a right place; ± is the standard deviation over the seeds.",
    f"Square brackets: 95 % interval of R@1 over the queries, of several seeds of their mean: {METHOD}.",
    f"{_ELSEWHERE}: on the queries of places that the row was not tuned on, with the same map.",
)
_RATE_WORDS = "Query rates: one image at a time from memory, encoding and matching together."
_MARK_WORDS = (
    "Bold: a paired test separates the row from every other one (docs/numbers.md, Who is best). Tilde: a busy machine "
    f"or too few laps, never bold. Dash ({INAPPLICABLE}): there is no such step or number."
)
_PAPER_WORDS = (
    "Brackets of line paper: measured less printed, of the step alone that the paper timed.",
    "Italics: quoted from a publication, not measured. left out: too many places; full=true runs it.",
)


def _list_seeds_and_blocks(table: Table) -> Iterator[str]:
    """Yield the seeds of rows with several, and for each column the queries in a block of the intervals."""
    measured = [cell for cell in iterate_rows(table.cells) if cell.seeds is not None]
    seeds: dict[str, set[int]] = {}
    for cell in measured:
        seeds.setdefault(cell.row, set()).update(cell.seeds)
    named = [f"{name} {' '.join(map(str, sorted(each)))}" for name, each in seeds.items() if len(each) > 1]
    if named:
        yield f"Seeds (mean; of training the median): {', '.join(named)}."
    for column in table.columns:
        blocks = [
            f"{cell.row} {cell.block}{' (Wilson)' if cell.interval == 'independent' else ''}"
            for cell in measured
            if cell.column == column.name and cell.block is not None
        ]
        if blocks:
            yield f"{column.title}, queries in a block of the intervals: {', '.join(blocks)}."


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
