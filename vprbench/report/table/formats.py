"""A table as Markdown, LaTeX, HTML, CSV and text for a terminal: one frame of cells, marked up for each of them."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

import pandas as pd

from vprbench.report.table import words
from vprbench.report.table.cells import FACTS, Column, Table
from vprbench.report.table.quantities import TRAINING
from vprbench.runs.frame import iterate_rows
from vprbench.terminal.console import format_line, format_table

_IN_LATEX = str.maketrans(
    {
        **{sign: f"\\{sign}" for sign in "&%$#{}"},
        **{"_": r"\_\allowbreak{}", "/": r"/\allowbreak{}"},  # names and paths may be long
        **{"~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "\\": r"\textbackslash{}", "`": r"\textasciigrave{}"},
        **{"<": r"\textless{}", ">": r"\textgreater{}", "|": r"\textbar{}", '"': r"\textquotedbl{}", "↳": r"\quad{}"},
    }
)
_SUPERSCRIPTS = str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")
_MACHINE, _NOTE = "table-machine", "table-note"  # ids in HTML


def join_lines(text: str) -> str:
    """Return text on one line, without control characters."""
    return " ".join("".join(sign if sign.isprintable() else " " for sign in text).split())


def escape_latex(text: str) -> str:
    """Return text that LaTeX prints as it is; a sign beyond Latin-1 gives its plain letters or its number."""
    signs = (
        sign if sign <= "ÿ" or sign == "↳" else _spell_out(sign)
        for sign in unicodedata.normalize("NFC", join_lines(text))
    )
    return re.sub(r"([-,'])(?=\1)", r"\1{}", "".join(signs).translate(_IN_LATEX))  # pairs would melt into one sign


def _spell_out(sign: str) -> str:
    plain = unicodedata.normalize("NFKD", sign).encode("ascii", "ignore").decode()
    return plain or f"[U+{ord(sign):04X}]"


def escape_markdown(text: str) -> str:
    """Return text that Markdown shows as it is: no markup, no HTML, no list."""
    text = escape(join_lines(text), quote=False)
    text = re.sub(r"([\\`*#$|])", r"\\\1", text)
    if re.search(r"\][\[(:]|\[\^", text):  # a link or a footnote; an interval is neither
        text = re.sub(r"([\[\]])", r"\\\1", text)
    if text.count("~") > 1:  # one alone strikes nothing out
        text = text.replace("~", r"\~")
    text = re.sub(r"^(\d*)([-+=.)])", r"\1\\\2", text)
    return re.sub(r"(?<!\w)_|_(?!\w)", r"\\_", text)  # inside of words it is no markup


def _mark_in_text(machine: str, notes: Sequence[int]) -> str:
    return " ".join(filter(None, [machine, ",".join(map(str, notes)).translate(_SUPERSCRIPTS)]))


def _mark_in_latex(machine: str, notes: Sequence[int]) -> str:
    return rf"\textsuperscript{{{', '.join(filter(None, [machine, *map(str, notes)]))}}}"


def _mark_in_html(machine: str, notes: Sequence[int]) -> str:
    links = [f'<a href="#{_MACHINE}-{machine[1:]}">{machine}</a>'] if machine else []
    links += [f'<a href="#{_NOTE}-{note}">{note}</a>' for note in notes]
    return f"<sup>{', '.join(links)}</sup>"


@dataclass(frozen=True)
class _Markup:
    """The marks of one format."""

    escape: Callable[[str], str]  # of names
    bold: str = "{}"
    italic: str = "{}"
    mark: Callable[[str, Sequence[int]], str] = _mark_in_text  # the machine, as M1 or empty, and the notes of a cell
    number: Callable[[str], str] = str  # of numbers and of the words in their place
    spiking: str = ""  # behind the name of a spiking row; empty: a line above these rows
    published: str = ""  # below a number in its cell; empty: a line below the row
    absence: str = "{}"  # the word for an absent number


_TEXT = _Markup(join_lines)
_MARKDOWN = _Markup(escape_markdown, "**{}**", "*{}*")
_LATEX = _Markup(escape_latex, r"\textbf{{{}}}", r"\textit{{{}}}", _mark_in_latex, escape_latex)
_HTML = _Markup(
    lambda text: escape(join_lines(text)),
    *('<b class="best">{}</b>', "<i>{}</i>", _mark_in_html),
    spiking=" <small>spiking</small>",
    published='<br><span class="published">paper {}</span>',
    absence='<span class="absent">{}</span>',
)


def lay_out(table: Table, columns: Sequence[Column], markup: _Markup) -> pd.DataFrame:
    """Return the cells of some columns as text, a line for each row, published numbers below measured ones.

    The columns have two levels, the title of the dataset and the heading of the quantity.
    """
    described = words.describe_cells(table)
    several = len(table.machines) > 1
    heads = [(markup.escape(c.title), markup.escape(q.heading)) for c in columns for q in table.quantities]
    lines: list[tuple[str, list[str]]] = []
    apart = table.title is None and not all(row.spiking for row in table.rows)
    for row in table.rows:
        of_row = described[described["row"] == row.name].set_index("column")
        cells = [cell for column in columns for cell in iterate_rows(of_row.loc[[column.name]])]
        if apart and row.spiking and not markup.spiking:
            lines.append((markup.italic.format("spiking"), [""] * len(heads)))
            apart = False
        name = markup.escape(row.name) + (markup.spiking if apart and row.spiking else "")
        lines.append((name, [_write_cell(cell, markup, several) for cell in cells]))
        if any(cell.printed for cell in cells) and not markup.published:
            lines.append((markup.escape("↳ paper"), [markup.number(cell.printed or "none") for cell in cells]))
    labels = pd.MultiIndex.from_tuples(heads, names=["", "method"]) if heads else pd.Index([])
    return pd.DataFrame([texts for _, texts in lines], [name for name, _ in lines], labels, dtype=object)


def _write_cell(cell: Any, markup: _Markup, several_machines: bool) -> str:
    marked = markup.bold if cell.best else markup.italic if cell.mark == "quoted" else "{}"
    text = marked.format(markup.number(cell.text)) if cell.text else ""
    machine = f"M{cell.machine + 1}" if several_machines and cell.machine is not None else ""
    notes = markup.mark(machine, cell.notes) if machine or cell.notes else ""
    absence = markup.absence.format(cell.absence) if cell.absence else ""
    below = markup.published.format(cell.printed) if cell.printed else ""
    return " ".join(filter(None, [absence, text, markup.number(cell.extent), notes])) + below


def to_markdown(table: Table) -> str:
    """Return a table as Markdown: one table for each dataset, published numbers in a line below each row."""
    units, *facts = map(escape_markdown, words.list_facts(table))
    parts = [f"# {escape_markdown(table.heading)}", units]
    for column in table.columns:
        parts += [f"## {escape_markdown(column.title)}"] if column.title != table.heading else []
        frame = lay_out(table, [column], _MARKDOWN).droplevel(0, axis=1)
        text = frame.rename_axis("method").to_markdown(disable_numparse=True) if table.rows else ""
        parts += [escape_markdown(words.describe_data(column)), text]
    parts.append("\n".join(f"{number}. {escape_markdown(note)}" for number, note in enumerate(table.notes, 1)))
    parts.append("\n".join(f"- {escape_markdown(machine)}" for machine in words.list_machines(table)))
    return "\n\n".join(filter(None, [*parts, "\n".join(facts)])) + "\n"


def to_terminal(table: Table, wide: bool = False) -> str:
    """Return a table as text that fits the terminal, unless `wide`, with its notes; the legend is in the files."""
    of_gpu = [quantity.heading for quantity in table.quantities if quantity.device == "cuda"]
    least = [*dict.fromkeys([*of_gpu, *(quantity.heading for quantity in TRAINING)])]
    parts = [format_line(table.heading, "bold")]
    for column in table.columns:
        frame = lay_out(table, [column], _TEXT)
        lines = [[name, *line] for name, line in zip(frame.index, frame.to_numpy().tolist(), strict=True)]
        parts += ["", format_line(column.title, "bold"), format_line(words.describe_data(column), "dim")]
        parts.append(format_table(["method", *frame.columns.get_level_values(1)], lines, wide, least))
    notes = [format_line(f"{number} {note}", "dim") for number, note in enumerate(table.notes, 1)]
    return "\n".join([*parts, "", *notes, *words.list_machines(table), ""])


def to_latex(table: Table) -> str:
    r"""Return a table as LaTeX for \input and booktabs, a tabular for each dataset; any text is escaped.

    The facts about its numbers, its notes and its machines stand in comments.
    """
    notes = [f"{number} {note}" for number, note in enumerate(table.notes, 1)]
    needs = f"{table.heading}. It needs \\usepackage{{booktabs}}."
    data = [f"{column.title}: {words.describe_data(column)}" for column in table.columns]
    comments = [needs, *data, *words.list_facts(table), *notes, *words.list_machines(table)]
    parts = [f"% {join_lines(line)}" for line in comments]
    for column in table.columns if table.rows else ():
        frame = lay_out(table, [column], _LATEX).rename(
            index="{{{}}}".format
        )  # "[" would be an option of the line above
        layout = f"@{{}}l{'l' * len(frame.columns)}@{{}}"
        parts.append(str(frame.to_latex(column_format=layout, multicolumn_format="c")).rstrip())
    return "\n".join(parts)


def to_html(table: Table) -> str:
    """Return a table as a fragment of HTML: the table in a frame that scrolls, then notes, machines and facts.

    All text is escaped. The classes of parts of a cell are best, absent and published. A page has room for
    one such fragment: its notes have fixed anchors.
    """
    units, *facts = (escape(join_lines(fact)) for fact in words.list_facts(table))
    heading = escape(join_lines(table.heading))
    with pd.option_context("display.max_colwidth", None):
        text = lay_out(table, table.columns, _HTML).to_html(escape=False, border=False, classes="results")
    head, found, body = text.replace('halign="left"', 'scope="colgroup"').partition("<tbody>")
    body = head.replace("<th>", '<th scope="col">') + found + body.replace("<th>", '<th scope="row">')
    data = (f"{column.title}: {words.describe_data(column)}" for column in table.columns)
    parts = [
        f'<p class="caption"><b>{heading}.</b> {units}</p>',
        *(f'<p class="legend">{escape(join_lines(line))}</p>' for line in data),
        f'<div class="scroll" tabindex="0" role="region" aria-label="{heading}">\n{body}\n</div>',
        _list_in_html('ol class="notes"', _NOTE, table.notes),
        _list_in_html('ul class="machines legend"', _MACHINE, words.list_machines(table)),
        f'<p class="legend">{" ".join(facts)}</p>',
    ]
    return "\n".join(filter(None, parts)) + "\n"


def _list_in_html(tag: str, anchor: str, lines: Sequence[str]) -> str:
    items = [f'<li id="{anchor}-{number}">{escape(join_lines(line))}</li>' for number, line in enumerate(lines, 1)]
    return "\n".join([f"<{tag}>", *items, f"</{tag[:2]}>"]) if items else ""


def to_csv(table: Table) -> str:
    """Return a table as CSV: one line for each row, dataset and quantity, with unrounded numbers.

    `value` is the quoted one where `mark` says so, `elsewhere` that on places that the row was not tuned on. `total`,
    of training, takes in the reading of the images; `at_boundary`, of rates, is of the step whose rate is published.
    Seeds are separated by spaces, notes by "; ".
    """
    cells = table.cells.copy()
    cells["title"] = cells["column"].map({column.name: join_lines(column.title) for column in table.columns})
    cells["unit"] = cells["quantity"].map({quantity.name: quantity.unit for quantity in table.quantities})
    cells["row"] = cells["row"].map(join_lines)
    cells["seeds"] = [None if seeds is None else " ".join(map(str, seeds)) for seeds in cells["seeds"]]
    cells["machine"] = [None if at is None else join_lines(table.machines[at]) for at in cells["machine"]]
    cells["notes"] = ["; ".join(join_lines(table.notes[n - 1]) for n in notes) for notes in cells["notes"]]
    shown = [name for name in FACTS[3:] if name != "elsewhere_spread"]
    return str(cells[["row", "column", "title", "quantity", "unit", *shown]].to_csv(index=False, lineterminator="\n"))
