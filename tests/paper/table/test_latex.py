"""Table II in LaTeX: it compiles with few packages, fits on its page, and holds the known numbers and any text."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest
from made_table import OTHER, found, row, small, table, told

from vprbench.paper.table.cells import Column
from vprbench.paper.table.formats import latex

LINE = r"(?<!\\)&"


def needs(*programs: str) -> None:
    """Skip without these programs, unless the surroundings insist on them."""
    missing = [program for program in programs if shutil.which(program) is None]
    if missing:
        reason = f"{' and '.join(missing)} not installed"
        if "VPRBENCH_INSIST_ON_LATEX" in os.environ:
            pytest.fail(reason)
        pytest.skip(reason)


def compiled(source: str, folder: Path) -> str:
    """Return what pdflatex says of a document."""
    (folder / "table.tex").write_text(source, encoding="utf-8")
    command = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "-no-shell-escape", "table.tex"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, errors="replace", timeout=120)
    assert done.returncode == 0, done.stdout[-2000:]
    return done.stdout


def text_of(folder: Path) -> str:
    """Return the text of the document as it is laid out."""
    command = ["pdftotext", "-layout", "-enc", "UTF-8", "table.pdf", "-"]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True, encoding="utf-8").stdout


def lines_of(source: str) -> list[list[str]]:
    """Return the cells of the lines of a document's tables, without size and space."""
    body = source[source.index(r"\midrule") :]
    lines = re.findall(r"^(.*&.*) \\\\$", body, re.MULTILINE)
    return [[re.sub(r"\\small |\\quad ", "", part).strip() for part in re.split(LINE, line)] for line in lines]


# In the source


def test_four_datasets_are_two_tables() -> None:
    columns = tuple(Column(name, name.upper(), None, None, "", None) for name in "abcd")
    source = latex(small(row("SAD", columns=("a", "b", "c", "d")), columns=columns))
    assert source.count(r"\begin{tabular}") == 2
    assert [len(line) for line in lines_of(source) if line[0] == "{SAD}"] == [11, 11]


def test_a_name_in_brackets_is_no_argument_of_the_line_above() -> None:
    source = latex(small(row("SAD"), row("[2cm]")))
    assert not re.search(r"\\\\(\\addlinespace|\s)*\[", source)


# On the page


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, str, str]:
    """What pdflatex says of the whole table, its text, and its pages."""
    needs("pdflatex", "pdftotext", "pdfinfo")
    folder = tmp_path_factory.mktemp("latex")
    said = compiled(latex(table()), folder)
    pages = subprocess.run(["pdfinfo", folder / "table.pdf"], capture_output=True, text=True, check=True).stdout
    return said, text_of(folder), pages


def test_five_rows_and_two_datasets_fit_on_one_landscape_page(whole: tuple[str, str, str]) -> None:
    said, _, pages = whole
    assert not re.search(r"Overfull|Warning", said)
    assert re.search(r"Pages: +1\n", pages)
    assert re.search(r"Page size: +841.89 x 595.276", pages)


def test_known_numbers_stand_on_the_page(whole: tuple[str, str, str]) -> None:
    _, text, _ = whole
    assert "54.3 ± 1.3 [52.4, 56.2]" in text
    for number in ("46.6 [44.8, 48.5]", "48 (\u22121.4)", "0.31 ± 0.01 (1.1)", "0.0052 ± 0.0001 (0.77)"):
        assert number in text
    assert "21,000 ± 100" in text
    assert "1,634 (match alone here: 22,346; +20,712)" in text
    assert f"M1: {OTHER}" in text


def test_what_is_wider_than_the_page_shrinks_and_what_is_narrower_does_not_grow(tmp_path: Path) -> None:
    needs("pdflatex", "pdftotext")
    compiled(latex(small(row("SAD", recall_at_1=found(41.0)))), tmp_path)
    command = ["pdftotext", "-bbox", "table.pdf", "-"]
    boxes = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True).stdout
    left = [float(x) for x in re.findall(r'xMin="([\d.]+)".*>Hz<', boxes)]
    assert 0 < max(left) < 600  # of 842


HOSTILE = 'A&B %c $d #e _f {g} ~h ^i \\j <k> |l "m" n\'s `o` --p ,,q é ± η µ ß \u2212 \u2013 “r” Ł'
COMMANDS = r"\input{/etc/hostname} \end{document} ^^5cbye %"
LACKING = "Ť ŧ 地 e\u0301 ﬁ ℃ \u0301 🙂 a\ud800b"  # in the fonts; the last is half of a pair
LETTERS = " ".join(map(chr, [*range(0x20, 0x7F), *range(0xA1, 0x180), *range(0x391, 0x3CA)]))


def test_any_text_is_printed_as_it_is_or_by_plain_letters_or_numbers(tmp_path: Path) -> None:
    needs("pdflatex", "pdftotext")
    column = Column("rail", HOSTILE, 1, 1, HOSTILE, None)
    rows = (row(HOSTILE, recall_at_1=found(41.0, notes=(1,))), *map(row, ("[x]", "*", COMMANDS, LACKING)))
    made = small(*rows, columns=(column,), notes=told(HOSTILE, LETTERS), machines=(HOSTILE,))
    assert "Missing character" not in compiled(latex(replace(made, caption=(HOSTILE, HOSTILE))), tmp_path)
    text = " ".join(text_of(tmp_path).split())
    assert text.count(HOSTILE.replace("'", "\u2019")) == 8  # a straight apostrophe is set as a curved one
    assert COMMANDS in text
    assert "Ť [U+0167] [U+5730] é fi °C" in text
    assert "[U+1F642] a b" in text


def test_a_table_of_no_rows_or_no_datasets_is_still_a_document(tmp_path: Path) -> None:
    needs("pdflatex")
    for made in (small(), small(row("SAD", columns=()), columns=())):
        compiled(latex(made), tmp_path)
