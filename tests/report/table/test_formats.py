"""A table as Markdown, CSV, LaTeX and HTML: whole documents are those stored, and any number and text comes out whole.

A stored document is written anew, to be read before it is committed, where VPRBENCH_STORE_DOCUMENTS is set.
"""

import csv
import io
import os
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest
from made_table import table as whole
from parsed_page import Parsed
from stored_runs import ABACUS, NAMES, NORDLAND, RAILWAY, SAD, STREET, failure, run, table

from vprbench.report.plan import Column, Row
from vprbench.report.table import formats
from vprbench.report.table.quantities import list_quantities
from vprbench.runs.notes import Note
from vprbench.terminal import console

STORED = Path(__file__).parent / "stored"
HOSTILE = "<script>alert(1)</script> a|b *c* _d_ `e` [f](g) \\ &amp; ~h~ $i$ é η"


def comparison():
    """Return a table with a title of its own, a column for another metric, and rows that stay in their order."""
    asked = [replace(Column("mine", "Corridor_1", ("dataset=street",)), dataset=STREET)]
    rows = [Row("VPRTempo", "vprtempo", spiking=True), Row("SAD", "sad", training="none")]
    runs = [run("vprtempo", dataset=STREET, timing=None), run(dataset=STREET, hits=[1, 0, 0, 0], timing=None)]
    more = {"quantities": list_quantities(["recall_at_5"]), "title": "Corridor_1"}
    return table(runs, [failure("vprtempo", dataset=STREET)], rows, asked, **more)


WRITERS = {"md": formats.to_markdown, "csv": formats.to_csv, "tex": formats.to_latex, "html": formats.to_html}


@pytest.mark.parametrize(
    ("made", "name", "ending"),
    [
        *((whole, "whole", ending) for ending in WRITERS),
        *((comparison, "comparison", ending) for ending in ("md", "tex")),
    ],
)
def test_a_document_is_the_stored_one(made, name, ending):
    stored, text = STORED / f"{name}.{ending}", WRITERS[ending](made())
    if "VPRBENCH_STORE_DOCUMENTS" in os.environ:
        stored.write_text(text, encoding="utf-8")
    assert text == stored.read_text(encoding="utf-8")


def markdown_table(made):
    """Return the cells of the first Markdown table, without the line under its head: an escaped pipe ends none."""
    lines = [line for line in formats.to_markdown(made).partition("\n\n|")[2].split("\n\n")[0].splitlines() if line]
    cells = [[part.strip() for part in re.split(r"(?<!\\)\|", line.lstrip("|"))[:-1]] for line in lines]
    return [cells[0], *cells[2:]]


def minutes(value, spread=0, **changes):
    """Return runs of two seeds, or one of no spread, whose trainings take so long, twice as long with the images."""
    each = [value - spread / 2**0.5, value + spread / 2**0.5] if spread else [value]
    return [run("new", seed, fit_compute_seconds=60 * m, fit_seconds=120 * m, **changes) for seed, m in enumerate(each)]


@pytest.mark.parametrize(
    ("runs", "told"),
    [
        (minutes(1614.96), "1,615 (3,230)"),
        (minutes(10.4), "10 (21)"),
        (minutes(9.96), "10 (20)"),
        (minutes(9.94), "9.9 (20)"),
        (minutes(0.996), "1.0 (2.0)"),
        (minutes(0.3149), "0.31 (0.63)"),
        (minutes(0.0000123), "0.000012 (0.000025)"),
        (minutes(0.0), "0 (0)"),
        (minutes(1615.0, 9.3), "1,615 ± 9 (3,230)"),
        (minutes(1615.0, 0.04), "1,615 ± 0.04 (3,230)"),
        (minutes(1615.0, 1234.0), "1,615 ± 1,234 (3,230)"),
        (minutes(0.31, notes=(Note("noisy", "noisy: carts"),)), "~0.31 (0.62)"),
    ],
)
def test_a_time_shows_as_many_digits_as_it_has(runs, told):
    row = Row("new", "new", seeds=tuple(range(len(runs))))
    (cells,) = markdown_table(table(runs, rows=[row], asked=[replace(NORDLAND, dataset=RAILWAY)]))[1:]
    assert re.sub(" [⁰¹²³⁴⁵⁶⁷⁸⁹,]+$", "", cells[1 + NAMES.index("train_cpu")]) == told


@pytest.mark.parametrize("columns", [100, 30])
def test_a_terminal_shows_each_row_and_note_in_its_columns(columns, monkeypatch):
    monkeypatch.setattr(console, "LEAST_WIDTH", columns)
    monkeypatch.delenv("COLUMNS", raising=False)
    made = replace(whole(), groups=whole().groups[:1])
    lines = formats.to_terminal(made).splitlines()
    table = [line for line in lines if "  " in line]
    assert max(map(len, table)) <= columns
    if columns == 100:
        assert {row.name for row in made.plan.rows} <= {line.split("  ")[0] for line in lines}
    assert {*map(str, range(1, 1 + len(made.notes)))} <= {line.split(" ")[0] for line in lines}
    assert max(map(len, formats.to_terminal(made, wide=True).splitlines())) > 100


def named(text, *more):
    """Return a table that holds a text wherever it holds any, and more rows."""
    column = Column("rail", text, (), remark=text)
    note = Note("dataset", text)
    rows = [Row(name, f"m{i}", rate_remark=text) for i, name in enumerate((text, "second", *more))]
    runs = [run(row.method, notes=(note,), machine={**ABACUS, "processor": text}) for row in rows]
    return table(runs, [failure("m0", error=text, day="2025-04-01")], rows, [replace(column, dataset=RAILWAY)])


def test_hostile_text_is_only_text():
    harmless, hostile = (Parsed(formats.to_html(named(text))) for text in ("harmless", HOSTILE))
    assert (hostile.elements, hostile.rows[2][0]) == (harmless.elements, HOSTILE)
    lines = markdown_table(named(HOSTILE))
    assert [len(line) for line in lines] == [6, 6, 6]
    assert lines[1][0] == (
        r"&lt;script&gt;alert(1)&lt;/script&gt; a\|b \*c\* \_d\_ \`e\` \[f\](g) \\ &amp;amp; \~h\~ \$i\$ é η"
    )
    assert "<" not in formats.to_markdown(named(HOSTILE))


def test_harmless_text_stands_in_markdown_as_it_is_and_none_begins_a_list_or_a_head():
    assert "vprtempo_ensemble" in formats.to_markdown(named("vprtempo_ensemble")).split("\n\n|")[0]
    for text in ("- a", "+ a", "1. a", "23) a", "= a", "# a"):
        lines = formats.to_markdown(named(text)).splitlines()
        assert any(line.replace("\\", "") == text and "\\" in line for line in lines)


def test_lines_within_text_end_neither_a_row_nor_a_line_of_csv():
    made = named("a\nb\r\n\tc\x00d")
    assert markdown_table(made)[1][0] == "a b c d"
    assert len(formats.to_csv(made).splitlines()) == 1 + 2 * len(NAMES)
    assert "a b c d" in next(csv.DictReader(io.StringIO(formats.to_csv(made))))["notes"]
    assert Parsed(formats.to_html(made)).rows[2][0] == "a b c d"


DOCUMENT = r"""\documentclass{{article}} \usepackage[landscape,a4paper,margin=12mm]{{geometry}}
\usepackage[T1]{{fontenc}} \usepackage{{lmodern,textcomp,booktabs}}
\begin{{document}} \tiny
{}
\end{{document}}
"""


def compiled(source, folder):
    """Return the log of pdflatex for a document of some tables; skips where a program is missing."""
    if missing := [program for program in ("pdflatex", "pdftotext") if shutil.which(program) is None]:
        leave = pytest.fail if "VPRBENCH_INSIST_ON_LATEX" in os.environ else pytest.skip
        leave(f"{' and '.join(missing)} not installed")
    (folder / "table.tex").write_text(DOCUMENT.format(source), encoding="utf-8")
    command = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "-no-shell-escape", "table.tex"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, errors="replace", timeout=120)
    assert done.returncode == 0, done.stdout[-2000:]
    return done.stdout


def test_a_dataset_is_a_table_and_a_name_in_brackets_is_no_argument_of_the_line_above():
    asked = [replace(Column(name, name.upper(), ()), dataset=STREET) for name in "abcd"]
    source = formats.to_latex(table(rows=[SAD, Row("[2cm]", "other")], asked=asked))
    assert source.count(r"\begin{tabular}") == 4
    lines = re.findall(r"^\{SAD\}.*", source, re.MULTILINE)
    assert [line.count(" & ") for line in lines] == [5, 5, 5, 5]
    assert not re.search(r"\\\\(\\addlinespace|\s)*\[", source)
    assert r"{\{x\} 50\% \& \#1 \$2}" in formats.to_latex(named("{x} 50% & #1 $2"))


PRINTED = 'A&B %c $d #e _f {g} ~h ^i \\j <k> |l "m" n\'s `o` é ± µ ß'
COMMANDS = r"\input{/etc/hostname} \end{document} ^^5cbye %"
LACKING = "η ŧ 地 e\u0301 ﬁ ℃  🙂 a\ud800b"  # in the fonts; the last is half of a pair


@pytest.mark.extended
def test_any_text_is_printed_as_it_is_or_by_plain_letters_or_numbers(tmp_path):
    source = formats.to_latex(named(PRINTED, "[x]", "*", COMMANDS, LACKING))
    assert "Missing character" not in compiled(source, tmp_path)
    shown = ["pdftotext", "-layout", "-enc", "UTF-8", "table.pdf", "-"]
    text = " ".join(subprocess.check_output(shown, cwd=tmp_path, encoding="utf-8").split())
    assert text.count(PRINTED.replace("'", "\u2019")) >= 2  # a straight apostrophe is set as a curved one
    assert COMMANDS in text
    assert "[U+03B7] [U+0167] [U+5730] é fi C" in text
    assert "[U+1F642] a b" in text
    compiled(formats.to_latex(whole()), tmp_path)
