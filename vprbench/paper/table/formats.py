"""Table II as Markdown, CSV, LaTeX and HTML: the same words and numbers in every format."""

from __future__ import annotations

import re
import unicodedata
from html import escape
from typing import Any

import pandas as pd

from vprbench.paper.table import words
from vprbench.paper.table.cells import FACTS, Column, Table
from vprbench.paper.table.quantities import TRAINING
from vprbench.paper.templates import ENVIRONMENT, document, one_line
from vprbench.runs import rows
from vprbench.terminal.console import line_text, table_text

_GREEK = "αβγδεζηθικλμνξπρστυφχψωΓΔΘΛΞΠΣΥΦΨΩ"
_GREEK_NAMES = (
    "alpha beta gamma delta epsilon zeta eta theta iota kappa lambda mu nu xi pi rho sigma tau upsilon phi chi psi "
    "omega Gamma Delta Theta Lambda Xi Pi Sigma Upsilon Phi Psi Omega"
)
_SIGNS = {
    **{sign: f"\\{sign}" for sign in "&%$#{}"},
    **{"_": r"\_\allowbreak{}", "/": r"/\allowbreak{}"},  # names and paths may be long
    **{"~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "\\": r"\textbackslash{}", "`": r"\textasciigrave{}"},
    **{"<": r"\textless{}", ">": r"\textgreater{}", "|": r"\textbar{}", '"': r"\textquotedbl{}"},
    **{"\u2018": r"\textquoteleft{}", "\u2019": r"\textquoteright{}", "€": r"\texteuro{}"},
    **{"\u201c": r"\textquotedblleft{}", "\u201d": r"\textquotedblright{}", "…": "..."},
    **{"\u2013": r"\textendash{}", "\u2014": r"\textemdash{}", "\u2212": "$-$"},
    **{"≤": r"$\leq$", "≥": r"$\geq$", "≈": r"$\approx$", "→": r"$\to$", "∞": r"$\infty$"},
    **{letter: rf"$\{name}$" for letter, name in zip(_GREEK, _GREEK_NAMES.split(), strict=True)},
}
_NOT_IN_T1 = "ĦħĸĿŀŉŦŧſ"  # of the letters up to ž


def tex(text: str) -> str:
    """Return text that LaTeX prints as it is; a sign that its fonts lack gives its plain letters or its number."""
    escaped = "".join(map(_sign, unicodedata.normalize("NFC", one_line(text))))
    return re.sub(r"([-,'])(?=\1)", r"\1{}", escaped)  # pairs of these would melt into one sign


def _sign(sign: str) -> str:
    if sign in _SIGNS:
        return _SIGNS[sign]
    if sign <= "ž" and sign not in _NOT_IN_T1:
        return sign
    plain = [part for part in unicodedata.normalize("NFKD", sign) if not unicodedata.combining(part)]
    return f"[U+{ord(sign):04X}]" if plain in ([], [sign]) else "".join(map(_sign, plain))


_SUPERSCRIPTS = str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")


def markdown(table: Table) -> str:
    """Return a table as Markdown: one table for each dataset, the paper's line below each row."""
    return _without_gaps(document("table/table.md.j2", table=table, words=words))


def for_terminal(table: Table, wide: bool = False) -> str:
    """Return a table as text that fits the terminal, unless `wide`, with its notes; the legend is in the files."""
    of_gpu = [quantity.heading for quantity in table.quantities if quantity.device == "cuda"]
    least = [*dict.fromkeys([*of_gpu, *(quantity.heading for quantity in TRAINING)])]
    parts = [line_text(table.heading, "bold")]
    for column in table.columns:
        heads, lines = _lines(table, column)
        parts += ["", line_text(column.title, "bold"), line_text(words.data(column), "dim")]
        parts += [table_text(heads, [[text.replace("*", "") for text in line] for line in lines], wide, least)]
    notes = [line_text(f"{number} {note.text}", "dim") for number, note in enumerate(table.notes, 1)]
    return "\n".join([*parts, "", *notes, *(f"{mark}: {machine}" for mark, machine in words.machines(table)), ""])


def latex(table: Table, fragment: bool = False) -> str:
    r"""Return a table as a LaTeX document of landscape pages, for booktabs and graphicx; any text is escaped.

    Two datasets stand in one table: more would be too small to read. A cell fills two columns, its value on the right
    of the first and what goes with it on the left of the second; words fill both. A fragment holds these tables alone,
    for \input and booktabs, and tells what their numbers are in comments.
    """
    values = {"table": table, "words": words, "n": len(table.quantities), "fragment": fragment}
    return _without_gaps(document("table/table.tex.j2", **values)).lstrip()


def html(table: Table) -> str:
    """Return a table as a fragment of HTML: the table in a frame that scrolls, then notes, machines and explanations.

    Classes of cells are measured, quoted and absent; inside of them are best, published and difference. All text is
    escaped. A page has room for one such fragment: its notes have fixed anchors.
    """
    return document("table/table.html.j2", table=table, words=words).lstrip()


def csv(table: Table) -> str:
    """Return a table as CSV: one line for each row, dataset and quantity, with unrounded numbers.

    `value` is the quoted one where `mark` says so, `elsewhere` that on places that the row was not tuned on. `total`,
    of training, takes in the reading of the images, `at_boundary`, of rates, is of the step alone that the paper timed.
    Seeds are separated by spaces, notes by "; ".
    """
    titles = {column.name: one_line(column.title) for column in table.columns}
    units = {quantity.name: quantity.unit for quantity in table.quantities}
    texts: dict[str, list[str | None]] = {
        "row": [one_line(name) for name in table.cells["row"]],
        "title": [titles[name] for name in table.cells["column"]],
        "unit": [units[name] for name in table.cells["quantity"]],
        "seeds": [None if seeds is None else " ".join(map(str, seeds)) for seeds in table.cells["seeds"]],
        "machine": [None if at is None else one_line(table.machines[at]) for at in table.cells["machine"]],
        "notes": ["; ".join(one_line(table.notes[n - 1].text) for n in notes) for notes in table.cells["notes"]],
    }
    cells = table.cells.assign(**{name: pd.Series(values, dtype=object) for name, values in texts.items()})
    return str(cells[[*_CSV_COLUMNS]].to_csv(index=False, lineterminator="\n"))


def shown_as_it_is(text: str) -> str:
    """Return text that Markdown shows as it is: no markup, no HTML, no list."""
    text = escape(one_line(text), quote=False)
    text = re.sub(r"([\\`*#$])", r"\\\1", text)
    if re.search(r"\][\[(:]|\[\^", text):  # a link or a footnote; an interval is neither
        text = re.sub(r"([\[\]])", r"\\\1", text)
    if text.count("~") > 1:  # one alone strikes nothing out
        text = text.replace("~", r"\~")
    text = re.sub(r"^(\d*)([-+=.)])", r"\1\\\2", text)
    return re.sub(r"(?<!\w)_|_(?!\w)", r"\\_", text)  # inside of words it is no markup


def _markdown_table(table: Table, column: Column) -> str:
    heads, lines = _lines(table, column)
    return rows.format_markdown([dict(zip(heads, line, strict=True)) for line in lines]) if lines else ""


def _lines(table: Table, column: Column) -> tuple[list[str], list[list[str]]]:
    """Return the heads and the lines of a column's table, the paper's line below each row."""
    heads = ["method", *(quantity.heading for quantity in table.quantities)]
    lines: list[list[str]] = []
    sections = words.sections(table, [column])
    for part in sections:
        if len(sections) > 1 and part[0][0].spiking:
            lines.append([f"*{words.SPIKING}*", *[""] * len(table.quantities)])
        for row, cells in part:
            lines.append([shown_as_it_is(row.name), *map(_markdown_cell, cells)])
            if any(cell.in_paper for cell in cells):
                lines.append([f"↳ {words.PAPER}", *map(_markdown_published, cells)])
    return heads, lines


def _markdown_cell(cell: Any) -> str:
    value = f"**{cell.value}**" if cell.best else f"*{cell.value}*" if cell.kind == "quoted" else cell.value
    machine = words.machine_mark(cell.machine) if cell.machine else ""
    notes = ",".join(map(str, cell.notes)).translate(_SUPERSCRIPTS)
    return " ".join(part for part in (cell.absence, value, cell.extent, machine, notes) if part)


def _markdown_published(cell: Any) -> str:
    value = f"*{cell.published}*" if cell.published_quoted else cell.published
    return f"{value} ({cell.beside})" if cell.beside else value


def _without_gaps(text: str) -> str:
    return re.sub(r"\n{3,}", "\n\n", text)


ENVIRONMENT.filters |= {"shown_as_it_is": shown_as_it_is, "tex": tex, "table_of": _markdown_table}

_CSV_COLUMNS = (
    *("row", "column", "title", "quantity", "unit"),
    *(name for name in FACTS if name not in ("row", "column", "quantity", "elsewhere_spread")),
)
