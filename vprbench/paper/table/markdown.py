"""Table II as Markdown, CSV, LaTeX and HTML: the same words and numbers in every format."""

from __future__ import annotations

import re
from html import escape

import pandas as pd

from vprbench.paper.table import words
from vprbench.paper.table.cells import Column, Table, TableRow
from vprbench.paper.table.html import html
from vprbench.paper.table.latex import latex
from vprbench.paper.table.quantities import Quantity
from vprbench.run import rows

__all__ = ["csv", "html", "latex", "markdown", "shown_as_it_is"]

_SUPERSCRIPTS = str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")


def markdown(table: Table) -> str:
    """Return a table as Markdown: one table for each dataset, the paper's line below each row."""
    first, *more = table.caption or ("",)
    parts = [f"# {words.TITLE}", shown_as_it_is(first)]
    for column in table.columns:
        parts += [
            f"## {shown_as_it_is(column.title)}",
            shown_as_it_is(words.data(column)),
            _markdown_table(table, column),
        ]
    parts += [
        "\n".join(map(shown_as_it_is, more)),
        "\n".join(f"{i}. {shown_as_it_is(note.text)}" for i, note in enumerate(table.notes, 1)),
        "\n".join(f"- {mark}: {shown_as_it_is(machine)}" for mark, machine in words.machines(table)),
        "\n".join(words.legend(table)),
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


def csv(table: Table) -> str:
    """Return a table as CSV: one line for each row, dataset and quantity, with unrounded numbers.

    `value` is the quoted one where `mark` says so. `total`, in the same unit, takes in more steps: the reading of the
    images in training, encoding and matching both in rates. Seeds are separated by spaces, notes by "; ".
    """
    lines = [
        _csv_line(table, row, column, quantity)
        for row in table.rows
        for column in table.columns
        for quantity in table.quantities
    ]
    return str(pd.DataFrame(lines, columns=_CSV_COLUMNS, dtype=object).to_csv(index=False, lineterminator="\n"))


def shown_as_it_is(text: str) -> str:
    """Return text that Markdown shows as it is: no markup, no HTML, no list."""
    text = escape(words.one_line(text), quote=False)
    text = re.sub(r"([\\`*#$])", r"\\\1", text)
    if re.search(r"\][\[(:]|\[\^", text):  # a link or a footnote; an interval is neither
        text = re.sub(r"([\[\]])", r"\\\1", text)
    if text.count("~") > 1:  # one alone strikes nothing out
        text = text.replace("~", r"\~")
    text = re.sub(r"^(\d*)([-+=.)])", r"\1\\\2", text)
    return re.sub(r"(?<!\w)_|_(?!\w)", r"\\_", text)  # inside of words it is no markup


def _markdown_table(table: Table, column: Column) -> str:
    heads = ["method", *(f"{quantity.head} {quantity.unit}".rstrip() for quantity in table.quantities)]
    lines: list[list[str]] = []
    several = len(words.sections(table)) > 1
    for part in words.sections(table):
        if several and part[0].spiking:
            lines.append([f"*{words.SPIKING}*", *[""] * len(table.quantities)])
        for row in part:
            cells = [words.of_cell(table, row.cells[column.name, q.name], q) for q in table.quantities]
            lines.append([shown_as_it_is(row.name), *map(_markdown_cell, cells)])
            if words.in_paper(row, column):
                lines.append([f"↳ {words.PAPER}", *map(_markdown_published, cells)])
    return rows.markdown([dict(zip(heads, line, strict=True)) for line in lines]) if lines else ""


def _markdown_cell(cell: words.Words) -> str:
    value = f"**{cell.value}**" if cell.best else f"*{cell.value}*" if cell.kind == "quoted" else cell.value
    machine = words.machine_mark(cell.machine) if cell.machine else ""
    notes = ",".join(map(str, cell.notes)).translate(_SUPERSCRIPTS)
    return " ".join(part for part in (cell.absence, value, cell.extent, machine, notes) if part)


def _markdown_published(cell: words.Words) -> str:
    value = f"*{cell.published}*" if cell.published_quoted else cell.published
    return f"{value} ({cell.difference})" if cell.difference else value


_CSV_COLUMNS = (
    *("row", "column", "title", "quantity", "unit", "mark", "value", "low", "high", "interval", "block"),
    *("spread", "seeds", "total", "best", "disturbed", "machine", "published", "published_mark", "difference", "notes"),
)


def _csv_line(table: Table, row: TableRow, column: Column, quantity: Quantity) -> dict[str, object]:
    cell = row.cells[column.name, quantity.name]
    line: dict[str, object] = {
        "row": words.one_line(row.name),
        "column": column.name,
        "title": words.one_line(column.title),
        "quantity": quantity.name,
        "unit": quantity.unit,
        "mark": cell.mark,
        "value": cell.quoted,
        "best": False,
        "disturbed": False,
        "published": cell.published,
        "published_mark": cell.published_mark,
        "difference": cell.difference,
        "notes": "; ".join(words.one_line(table.notes[number - 1].text) for number in cell.notes),
    }
    if cell.measured is not None:
        copied = ("value", "low", "high", "interval", "block", "spread", "best", "disturbed")
        line |= {name: getattr(cell.measured, name) for name in copied}
        line["seeds"] = " ".join(map(str, cell.measured.seeds))
        line["total"] = cell.measured.total
        line["machine"] = words.one_line(table.machines[cell.measured.machine])
    return line
