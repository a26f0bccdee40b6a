"""A table as Markdown, LaTeX, HTML, CSV and text for a terminal: one frame of cells, marked up for each of them."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING, Any

import pandas as pd

from vprbench.report.selection import DatasetRuns
from vprbench.report.table.cells import FACTS
from vprbench.report.table.quantities import RATES, RECALL, TRAINING, TRAINING_TIME
from vprbench.runs.frame import iterate_rows
from vprbench.runs.recall_intervals import METHOD
from vprbench.terminal.console import format_line, format_table
from vprbench.text import NOTHING, format_count

if TYPE_CHECKING:
    from vprbench.report.report import Report

_IN_LATEX = str.maketrans(
    {
        **{sign: f"\\{sign}" for sign in "&%$#{}_"},
        **{"~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "\\": r"\textbackslash{}", "`": r"\textasciigrave{}"},
        **{"<": r"\textless{}", ">": r"\textgreater{}", "|": r"\textbar{}", '"': r"\textquotedbl{}", "↳": r"\quad{}"},
    }
)
_INTERVAL_WORDS = (
    "±: standard deviation over the seeds. The CSV holds the seeds, and of an interval its kind and queries a block.",
    f"Square brackets: 95 % interval over the queries, of several seeds of their mean: {METHOD}.",
    "elsewhere: on the queries of places that the row was not tuned on, with the same map.",
)
_RATE_WORDS = "Query rates: one image at a time from memory, encoding and matching together."
_MARK_WORDS = (
    "Bold: a paired test separates the row from every other one (docs/numbers.md, Who is best). Tilde: a busy machine "
    f"or too few laps, never bold. Dash ({NOTHING}): there is no such step or number."
)
_PAPER_WORDS = (
    "Brackets of line paper: measured less printed, of the step alone that the paper timed.",
    "Italics: quoted from a publication, not measured. left out: too many places; full=true runs it.",
)
_SUPERSCRIPTS = str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")
_LEAST = (TRAINING[0].heading, "peak MB", "AUC-PR (A)", "R@5 %")  # columns that a narrow terminal lacks first
_MACHINE, _NOTE = "table-machine", "table-note"  # ids in HTML


def join_lines(text: str) -> str:
    """Return text on one line, without control characters."""
    return " ".join("".join(sign if sign.isprintable() else " " for sign in text).split())


def escape_latex(text: str) -> str:
    """Return text that LaTeX prints as it is; a sign beyond Latin-1 gives its plain letters or its number."""
    signs = unicodedata.normalize("NFC", join_lines(text))
    return "".join(sign if sign <= "ÿ" or sign == "↳" else _spell_out(sign) for sign in signs).translate(_IN_LATEX)


def _spell_out(sign: str) -> str:
    plain = unicodedata.normalize("NFKD", sign).encode("ascii", "ignore").decode()
    return plain or f"[U+{ord(sign):04X}]"


def escape_markdown(text: str) -> str:
    """Return text that Markdown shows as it is: no markup, no HTML, no list."""
    text = escape(join_lines(text), quote=False)
    text = re.sub(r"[\\`*#$|\[\]~]|(?<!\w)_|_(?!\w)", r"\\\g<0>", text)  # inside of words an underline is no markup
    return re.sub(r"^(\d*)([-+=.)])", r"\1\\\2", text)


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


def list_machines(table: Report) -> list[str]:
    """Return the machines, each after the mark of its cells."""
    several = len(table.machines) > 1
    return [f"{f'M{i}' if several else 'Machine'}: {machine}" for i, machine in enumerate(table.machines, 1)]


def list_facts(table: Report) -> list[str]:
    """Return the legend of a table: units and sources of its numbers, then fixed words on its marks."""
    published = table.plan.published if any(table.cells["published_mark"] != "none") else None
    columns = [group.column for group in table.groups]
    units = ", ".join(f"{quantity.head} in {quantity.unit}" for quantity in table.quantities if quantity.unit)
    facts = [f"{units}."]
    if published is not None:
        facts = [f"{units}; line paper: {published.source}, measured on {published.cpu} and {published.gpu}."]
        shown = dict.fromkeys(column.published for column in columns if column.published in published.protocols)
        facts += [f"Paper, {name}: {published.protocols[str(name)]}." for name in shown]
    stand_ins = [(group.title, group.column.stand_in_for) for group in table.groups if group.column.stand_in_for]
    facts += [f"{title} is rendered and stands in for {real}." for title, real in stand_ins]
    facts += dict.fromkeys(column.remark for column in columns if column.remark is not None)
    if table.n_aside:
        facts.append(f"Not shown: {format_count(table.n_aside, 'stored run')} of other code, settings or seeds.")
    facts += [quantity.metric.explained for quantity in table.quantities if quantity.metric]
    facts += _INTERVAL_WORDS if any(table.cells["low"].notna()) else ()
    if any(quantity in TRAINING for quantity in table.quantities):
        facts.append(f"Training: {TRAINING_TIME[0].lower()}{TRAINING_TIME[1:]}")
    facts += [_RATE_WORDS] if any(quantity in RATES for quantity in table.quantities) else []
    return [*facts, _MARK_WORDS, *(_PAPER_WORDS if published else ())]


def lay_out(table: Report, groups: Sequence[DatasetRuns], markup: _Markup) -> pd.DataFrame:
    """Return the cells of some groups as text, a line for each row, published numbers below measured ones.

    The columns have two levels, the title of the dataset and the heading of the quantity.
    """
    several, rows = len(table.machines) > 1, table.plan.rows
    heads = [(markup.escape(g.title), markup.escape(q.heading)) for g in groups for q in table.quantities]
    lines: list[tuple[str, list[str]]] = []
    apart = table.plan.title is None and not all(row.spiking for row in rows)
    for row in rows:
        of_row = table.cells[table.cells["row"] == row.name].set_index("column")
        cells = [cell for group in groups for cell in iterate_rows(of_row.loc[[group.name]])]
        if apart and row.spiking and not markup.spiking:
            lines.append((markup.italic.format("spiking"), [""] * len(heads)))
            apart = False
        name = markup.escape(row.name) + (markup.spiking if apart and row.spiking else "")
        lines.append((name, [_write_cell(cell, markup, several) for cell in cells]))
        if any(cell.printed for cell in cells) and not markup.published:
            lines.append((markup.escape("↳ paper"), [markup.number(cell.printed or "none") for cell in cells]))
    labels = pd.MultiIndex.from_tuples(heads, names=["", "method"])
    return pd.DataFrame([texts for _, texts in lines], [name for name, _ in lines], labels, dtype=object)


def _write_cell(cell: Any, markup: _Markup, several_machines: bool) -> str:
    marked = markup.bold if cell.best else markup.italic if cell.mark == "quoted" else "{}"
    text = marked.format(markup.number(cell.text)) if cell.text else ""
    machine = f"M{cell.machine + 1}" if several_machines and cell.machine is not None else ""
    notes = markup.mark(machine, cell.notes) if machine or cell.notes else ""
    absence = markup.absence.format(cell.absence) if cell.absence else ""
    below = markup.published.format(cell.printed) if cell.printed else ""
    return " ".join(filter(None, [absence, text, markup.number(cell.extent), notes])) + below


def to_markdown(table: Report) -> str:
    """Return a table as Markdown: one table for each dataset, published numbers in a line below each row."""
    units, *facts = map(escape_markdown, list_facts(table))
    parts = [f"# {escape_markdown(table.plan.heading)}", units]
    for group in table.groups:
        parts += [f"## {escape_markdown(group.title)}"] if group.title != table.plan.heading else []
        frame = lay_out(table, [group], _MARKDOWN).droplevel(0, axis=1)
        text = frame.rename_axis("method").to_markdown(disable_numparse=True)
        parts += [escape_markdown(group.data), text]
    parts.append("\n".join(f"{number}. {escape_markdown(note)}" for number, note in enumerate(table.notes, 1)))
    parts.append("\n".join(f"- {escape_markdown(machine)}" for machine in list_machines(table)))
    return "\n\n".join(filter(None, [*parts, "\n".join(facts)])) + "\n"


def to_terminal(table: Report, wide: bool = False) -> str:
    """Return a table as text that fits the terminal, unless `wide`, with its notes; the legend is in the files.

    Several views stand side by side, with R@1 alone. Under a title of its own the results of tests follow.
    """
    usual = [one.heading for one in table.quantities if one.metric is None or one.name not in table.plan.metrics]
    of_gpu = [quantity.heading for quantity in table.quantities if quantity.device == "cuda"]
    least = [*dict.fromkeys([*of_gpu, *_LEAST, *usual[:0:-1]])]  # left out first where room is short
    parts = [format_line(table.plan.heading, "bold")]
    together = len(table.plan.views) > 1 and RECALL in table.quantities
    for groups in [table.groups] if together else [(group,) for group in table.groups]:
        frame = lay_out(table, groups, _TEXT)
        heads, titles = ["method", *frame.columns.get_level_values(1)], [group.title for group in groups]
        if together:
            frame = frame.loc[:, frame.columns.get_level_values(1) == RECALL.heading]
            heads = [RECALL.heading, *(title.partition(", ")[2] for title in titles)]
        elif titles != [table.plan.heading]:
            parts += ["", format_line(titles[0], "bold")]
        parts += [format_line(group.data, "dim", fits=True) for group in groups]
        lines = [[name, *line] for name, line in zip(frame.index, frame.to_numpy().tolist(), strict=True)]
        parts += (
            ["", format_table(heads, lines, wide, least)] if together else [format_table(heads, lines, wide, least)]
        )
    if table.plan.title is not None:
        tested = [group for group in table.groups if group.runs]
        for group, ranking in zip(tested, table.rankings, strict=True):
            above = f"{group.title}: " if len(tested) > 1 else ""
            parts += ["", *(format_line(f"{above}{sentence}", "bold") for sentence in ranking.sentences)]
    notes = [format_line(f"{number} {note}", "dim") for number, note in enumerate(table.notes, 1)]
    busy = [format_line("~ a busy machine or too few laps", "dim")] if any(table.cells["disturbed"]) else []
    return "\n".join([*parts, "", *notes, *busy, *list_machines(table), ""])


def to_latex(table: Report) -> str:
    r"""Return a table as LaTeX for \input and booktabs, a tabular for each dataset; any text is escaped.

    The facts about its numbers, its notes and its machines stand in comments.
    """
    notes = [f"{number} {note}" for number, note in enumerate(table.notes, 1)]
    needs = f"{table.plan.heading}. It needs \\usepackage{{booktabs}}."
    data = [f"{group.title}: {group.data}" for group in table.groups]
    comments = [needs, *data, *list_facts(table), *notes, *list_machines(table)]
    parts = [f"% {join_lines(line)}" for line in comments]
    for group in table.groups:
        frame = lay_out(table, [group], _LATEX)
        frame = frame.rename(index="{{{}}}".format)  # "[" would be an option of the line above
        layout = f"@{{}}l{'l' * len(frame.columns)}@{{}}"
        parts.append(str(frame.to_latex(column_format=layout, multicolumn_format="c")).rstrip())
    return "\n".join(parts)


def to_html(table: Report) -> str:
    """Return a table as a fragment of HTML: the table in a frame that scrolls, then notes, machines and facts.

    All text is escaped. The classes of parts of a cell are best, absent and published. A page has room for
    one such fragment: its notes have fixed anchors.
    """
    units, *facts = (escape(join_lines(fact)) for fact in list_facts(table))
    heading = escape(join_lines(table.plan.heading))
    with pd.option_context("display.max_colwidth", None):
        text = lay_out(table, table.groups, _HTML).to_html(escape=False, border=False, classes="results")
    head, found, body = text.replace('halign="left"', 'scope="colgroup"').partition("<tbody>")
    body = head.replace("<th>", '<th scope="col">') + found + body.replace("<th>", '<th scope="row">')
    data = (f"{group.title}: {group.data}" for group in table.groups)
    parts = [
        f'<p class="caption"><b>{heading}.</b> {units}</p>',
        *(f'<p class="legend">{escape(join_lines(line))}</p>' for line in data),
        f'<div class="scroll" tabindex="0" role="region" aria-label="{heading}">\n{body}\n</div>',
        _list_in_html('ol class="notes"', _NOTE, table.notes),
        _list_in_html('ul class="machines legend"', _MACHINE, list_machines(table)),
        f'<p class="legend">{" ".join(facts)}</p>',
    ]
    return "\n".join(filter(None, parts)) + "\n"


def _list_in_html(tag: str, anchor: str, lines: Sequence[str]) -> str:
    items = [f'<li id="{anchor}-{number}">{escape(join_lines(line))}</li>' for number, line in enumerate(lines, 1)]
    return "\n".join([f"<{tag}>", *items, f"</{tag[:2]}>"]) if items else ""


def to_csv(table: Report) -> str:
    """Return a table as CSV: one line for each row, dataset and quantity, with unrounded numbers.

    `value` is the quoted one where `mark` says so, `elsewhere` that on places that the row was not tuned on. `total`,
    of training, takes in the reading of the images; `at_boundary`, of rates, is of the step whose rate is published.
    Seeds are separated by spaces, notes by "; ".
    """
    cells = table.cells.copy()
    cells["title"] = cells["column"].map({group.name: join_lines(group.title) for group in table.groups})
    cells["unit"] = cells["quantity"].map({quantity.name: quantity.unit for quantity in table.quantities})
    cells["row"] = cells["row"].map(join_lines)
    cells["seeds"] = [None if seeds is None else " ".join(map(str, seeds)) for seeds in cells["seeds"]]
    cells["machine"] = [None if at is None else join_lines(table.machines[at]) for at in cells["machine"]]
    cells["notes"] = ["; ".join(join_lines(table.notes[n - 1]) for n in notes) for notes in cells["notes"]]
    return str(
        cells[["row", "column", "title", "quantity", "unit", *FACTS[3:]]].to_csv(index=False, lineterminator="\n")
    )
