"""Table II as a LaTeX document."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Sequence

from vprbench.paper.table import words
from vprbench.paper.table.cells import Column, Table, TableRow

_ABREAST = 2  # datasets in one table: more would be too small to read
_DOCUMENT = r"""\documentclass{article}
\usepackage[landscape,a4paper,margin=12mm]{geometry}
\usepackage[T1]{fontenc}
\usepackage[utf8]{inputenc}
\usepackage{lmodern,textcomp}
\usepackage{booktabs,graphicx} % these two are all that the tables need
\pagestyle{empty}
\setlength{\parindent}{0pt}
\setlength{\parskip}{4pt}
\raggedright
\begin{document}
BODY
\end{document}
"""
_SHRUNK = r"\resizebox{\ifdim\width>\linewidth\linewidth\else\width\fi}{!}{%"  # to the page, where it is wider
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


def latex(table: Table) -> str:
    """Return a table as a LaTeX document of landscape pages, for booktabs and graphicx; any text is escaped."""
    first, *more = table.caption or ("",)
    starts = range(0, len(table.columns), _ABREAST)
    parts = [
        rf"\textbf{{{words.TITLE}.}} {_text(first)}",
        *(_table(table, table.columns[start : start + _ABREAST]) for start in starts),
        r"\footnotesize",
        _text(" ".join(more)),
        "\n".join(rf"\textsuperscript{{{i}}} {_text(note.text)}\quad" for i, note in enumerate(table.notes, 1)),
        r"\\ ".join(_text(f"{mark}: {machine}") for mark, machine in words.machines(table)),
        _text(" ".join(words.legend(table))),
    ]
    return _DOCUMENT.replace("BODY", "\n\n".join(part for part in parts if part))


def _text(text: str) -> str:
    """Return text that LaTeX prints as it is; a sign that its fonts lack gives its plain letters or its number."""
    escaped = "".join(map(_sign, unicodedata.normalize("NFC", words.one_line(text))))
    return re.sub(r"([-,'])(?=\1)", r"\1{}", escaped)  # pairs of these would melt into one sign


def _sign(sign: str) -> str:
    if sign in _SIGNS:
        return _SIGNS[sign]
    if sign <= "ž" and sign not in _NOT_IN_T1:
        return sign
    plain = [part for part in unicodedata.normalize("NFKD", sign) if not unicodedata.combining(part)]
    return f"[U+{ord(sign):04X}]" if plain in ([], [sign]) else "".join(map(_sign, plain))


def _table(table: Table, columns: Sequence[Column]) -> str:
    n = len(table.quantities)
    titles = " & ".join(rf"\multicolumn{{{n}}}{{c}}{{{_text(column.title)}}}" for column in columns)
    under = "".join(rf"\cmidrule(lr){{{2 + n * i}-{1 + n * (i + 1)}}}" for i in range(len(columns)))
    heads = "".join(f" & {_text(quantity.head)}" for _ in columns for quantity in table.quantities)
    units = "".join(f" & {_text(quantity.unit)}" for _ in columns for quantity in table.quantities)
    body = "\n\\midrule\n".join(
        "\n\\addlinespace\n".join(_row(table, row, columns) for row in rows) for rows in words.sections(table)
    )
    lines = [
        _SHRUNK,
        rf"\setlength{{\tabcolsep}}{{4pt}}\begin{{tabular}}{{@{{}}l{'l' * n * len(columns)}@{{}}}}",
        rf"\toprule & {titles} \\ {under}",
        rf"method{heads} \\",
        rf"{units} \\ \midrule",
        *([body] if body else []),
        r"\bottomrule",
        r"\end{tabular}}",
    ]
    about = [
        rf"{{\footnotesize \textbf{{{_text(column.title)}:}} {_text(words.data(column))}\par}}"
        for column in columns
        if words.data(column)
    ]
    return "\n\n".join([*about, "\n".join(lines)])


def _row(table: Table, row: TableRow, columns: Sequence[Column]) -> str:
    cells = [words.of_cell(table, row.cells[column.name, q.name], q) for column in columns for q in table.quantities]
    measured = " & ".join([f"{{{_text(row.name)}}}", *map(_cell, cells)])
    if not any(words.in_paper(row, column) for column in columns):
        return rf"{measured} \\"
    printed = " & ".join(rf"\small {text}" for text in (rf"\quad {words.PAPER}", *map(_published, cells)))
    return f"{measured} \\\\\n{printed} \\\\"


def _cell(cell: words.Words) -> str:
    value = _text(cell.value)
    value = rf"\textbf{{{value}}}" if cell.best else rf"\textit{{{value}}}" if cell.kind == "quoted" else value
    absence = "--" if cell.absence == words.INAPPLICABLE else _text(cell.absence)
    marks = ", ".join([*([words.machine_mark(cell.machine)] if cell.machine else []), *map(str, cell.notes)])
    text = " ".join(part for part in (absence, value, _text(cell.extent)) if part)
    return rf"{text}\textsuperscript{{{marks}}}" if marks else text


def _published(cell: words.Words) -> str:
    value = "--" if cell.published == words.INAPPLICABLE else _text(cell.published)
    value = rf"\textit{{{value}}}" if cell.published_quoted else value
    return f"{value} ({cell.difference.replace('-', '$-$')})" if cell.difference else value
