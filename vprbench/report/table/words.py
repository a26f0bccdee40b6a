"""The text of a table before the markup of any format: its cells, its columns and the facts below it."""

from __future__ import annotations

from typing import Any

import pandas as pd

from vprbench.report.table.cells import Column, Table
from vprbench.report.table.quantities import RATES, TRAINING, TRAINING_TIME, Quantity
from vprbench.runs.frame import iterate_rows
from vprbench.runs.recall_intervals import METHOD
from vprbench.text import format_count, format_spread

INAPPLICABLE = "-"
_ELSEWHERE = "elsewhere"

_INTERVAL_WORDS = (
    "±: standard deviation over the seeds. The CSV holds the seeds, and of an interval its kind and queries a block.",
    f"Square brackets: 95 % interval over the queries, of several seeds of their mean: {METHOD}.",
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


def describe_cells(table: Table) -> pd.DataFrame:
    """Return the cells with their text in more columns.

    - `absence`: "failed", "-" ..., empty for a number
    - `text`: the number, empty for none; `extent`: its spread, interval, and in brackets with waiting for images
    - `printed`: the published number, in brackets the rate of the same step here and the difference; empty for none
    """
    by_name = {quantity.name: quantity for quantity in table.quantities}
    boundaries = {row.name: row.boundary for row in table.rows}
    lines = []
    for cell in iterate_rows(table.cells):
        quantity = by_name[cell.quantity]
        absence = {"measured": "", "quoted": "", "not applicable": INAPPLICABLE}.get(cell.mark, cell.mark)
        text, extent, printed = "", "", ""
        if cell.mark == "quoted":
            text = _format_published(cell.value)
        elif cell.seeds is not None:
            absence = absence and f"{absence}:"
            text, extent = ("~" if cell.disturbed else "") + quantity.text(cell.value), _describe_extent(cell, quantity)
        if cell.published_mark != "none":
            beside = _describe_beside(cell, boundaries[cell.row], quantity)
            printed = INAPPLICABLE if cell.published is None else f"{_format_published(cell.published)}{beside}"
        lines.append((absence, text, extent, printed))
    texts = pd.DataFrame(lines, columns=["absence", "text", "extent", "printed"], dtype=object)
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
    """Return the legend of a table: units and sources of its numbers, then fixed words on its marks."""
    published = table.published if any(table.cells["published_mark"] != "none") else None
    units = ", ".join(f"{quantity.head} in {quantity.unit}" for quantity in table.quantities if quantity.unit)
    facts = [f"{units}."]
    if published is not None:
        facts = [f"{units}; line paper: {published.source}, measured on {published.cpu} and {published.gpu}."]
        shown = dict.fromkeys(column.published for column in table.columns if column.published in published.protocols)
        facts += [f"Paper, {name}: {published.protocols[str(name)]}." for name in shown]
    facts += [f"{c.title} is rendered and stands in for {c.stand_in_for}." for c in table.columns if c.stand_in_for]
    facts += dict.fromkeys(column.remark for column in table.columns if column.remark is not None)
    if table.n_aside:
        facts.append(f"Not shown: {format_count(table.n_aside, 'stored run')} of other code, settings or seeds.")
    facts += [quantity.metric.explained for quantity in table.quantities if quantity.metric]
    facts += _INTERVAL_WORDS if any(table.cells["low"].notna()) else ()
    if any(quantity in TRAINING for quantity in table.quantities):
        facts.append(f"Training: {TRAINING_TIME[0].lower()}{TRAINING_TIME[1:]}")
    facts += [_RATE_WORDS] if any(quantity in RATES for quantity in table.quantities) else []
    return [*facts, _MARK_WORDS, *(_PAPER_WORDS if published else ())]


def _describe_extent(cell: Any, quantity: Quantity) -> str:
    parts = [_describe_range(cell.value, cell.spread, cell.low, cell.high, quantity)]
    if cell.total is not None:
        parts.append(f"({quantity.text(cell.total)})")
    if (other := cell.elsewhere) is not None:
        ends = cell.elsewhere_spread, cell.elsewhere_low, cell.elsewhere_high
        parts += [f"{_ELSEWHERE} {quantity.text(other)}", _describe_range(other, *ends, quantity)]
    return " ".join(filter(None, parts))


def _describe_range(
    value: float, spread: float | None, low: float | None, high: float | None, quantity: Quantity
) -> str:
    """Return the spread over the seeds and the interval, as far as they are known."""
    parts = [] if spread is None else [f"± {format_spread(spread, quantity.text(value))}"]
    parts += [] if low is None or high is None else [f"[{quantity.text(low)}, {quantity.text(high)}]"]
    return " ".join(parts)


def _describe_beside(cell: Any, boundary: str | None, quantity: Quantity) -> str:
    """Return in brackets the rate of the published step alone, and the measured number less the printed."""
    parts = [] if cell.at_boundary is None else [f"{boundary} alone here: {quantity.text(cell.at_boundary)}"]
    if cell.difference is not None:
        size = quantity.text(abs(cell.difference))
        sign = "" if float(size.replace(",", "")) == 0 else "-" if cell.difference < 0 else "+"
        parts.append(f"{sign}{size}")
    return f" ({'; '.join(parts)})" if parts else ""


def _format_published(value: float) -> str:
    """Return a number as a publication printed it: 48 and 0.5, never 48.0 or 0.50."""
    return f"{value:,}".removesuffix(".0")
