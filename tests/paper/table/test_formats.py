"""Table II as Markdown, CSV, LaTeX and HTML: whole documents are those stored, and any number and text comes out whole.

A stored document is written anew, to be read before it is committed, where VPRBENCH_STORE_DOCUMENTS is set.
"""

from __future__ import annotations

import csv
import io
import os
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import pytest
from made_table import GPU, NAMES, OTHER, cell, found, measured, paper, row, small, table, told

from vprbench.paper.table import formats
from vprbench.paper.table.cells import Cell, Column, Table
from vprbench.paper.table.quantities import quantities

STORED = Path(__file__).parent / "stored"
HOSTILE = "<script>alert(1)</script> a|b *c* _d_ `e` [f](g) \\ &amp; ~h~ $i$ é η"
NO_RUN = Column("rail", "Nordland", None, None, "no run is stored", None)


@pytest.mark.parametrize(("form", "ending"), [("markdown", "md"), ("csv", "csv"), ("latex", "tex"), ("html", "html")])
@pytest.mark.parametrize("name", ["whole", "little"])
def test_a_document_is_the_stored_one(name: str, form: str, ending: str) -> None:
    little = small(
        row("VPRTempo", spiking=True),
        row("HOG", recall_at_1=found(20.0, disturbed=True), query_cpu=found(50.0), query_gpu=found(20.0, machine=1)),
        row("SAD", recall_at_1=cell("unfinished", **paper(48.0), notes=(2, 1)), query_cpu=found(41.0, 37.0)),
        notes=told("first", "second"),
        machines=(OTHER, GPU),
    )
    text = getattr(formats, form)(table() if name == "whole" else little)
    path = STORED / f"{name}.{ending}"
    if "VPRBENCH_STORE_DOCUMENTS" in os.environ:
        path.write_text(text, encoding="utf-8")
    assert text == path.read_text(encoding="utf-8")


def markdown_table(made: Table) -> list[list[str]]:
    """Return the cells of the first Markdown table, without the line under its head: an escaped pipe ends none."""
    lines = [line for line in formats.markdown(made).partition("\n\n|")[2].split("\n\n")[0].splitlines() if line]
    cells = [[part.strip() for part in re.split(r"(?<!\\)\|", line.lstrip("|"))[:-1]] for line in lines]
    return [cells[0], *cells[2:]]


def in_markdown(made: Table, quantity: str = "recall_at_1") -> list[str]:
    """Return the one or two lines of a cell of the only row."""
    return [line[1 + NAMES.index(quantity)] for line in markdown_table(made)[1:]]


def in_csv(made: Table) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(formats.csv(made))))


class Grid(HTMLParser):
    """Collects tags with their attributes, and the text of each cell by row."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.rows: list[list[str]] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in ("br", "col"):
            self.open.append(tag)
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if {"td", "th"} & {*self.open}:
            self.rows[-1][-1] += data


def alone(made: Cell, quantity: str = "recall_at_1") -> Table:
    return small(row("SAD", **{quantity: made}), notes=told("first", "second"))


@pytest.mark.parametrize(
    ("made", "kind", "lines"),
    [
        (found(54.321, 56.0, best=True), "measured", ["**54.3**", "56 (-1.7)"]),
        (cell("quoted", quoted=48.0, **paper(48.0, "quoted")), "quoted", ["*48*", "*48*"]),
        (cell("not applicable", **paper(None)), "absent", ["-", "-"]),
        (cell("not there", **paper(32.0), notes=(2,)), "absent", ["not there ²", "32"]),
        (cell("failed", **paper(53.0), notes=(1, 2)), "absent", ["failed ¹,²", "53"]),
        (cell("left out", **paper(31.0)), "absent", ["left out", "31"]),
        (cell("unfinished", **paper(40.0)), "absent", ["unfinished", "40"]),
        (
            cell("unfinished", measured=measured(38.5, low=33.6, high=43.6), **paper(40.0), difference=-1.5),
            "absent",
            ["unfinished: 38.5 [33.6, 43.6]", "40 (-1.5)"],
        ),
    ],
)
def test_every_mark_is_told_apart(made: Cell, kind: str, lines: list[str]) -> None:
    assert in_markdown(alone(made)) == lines
    assert ("td", {"class": kind}) in Grid(formats.html(alone(made))).tags
    assert in_csv(alone(made))[0]["mark"] == made.mark


@pytest.mark.parametrize(
    ("quantity", "made", "shown"),
    [
        *(
            (quantity, found(value), shown)
            for quantity in ("train_cpu", "query_gpu")
            for value, shown in (
                *((1614.96, "1,615"), (22345.6, "22,346"), (252.3, "252"), (10.4, "10"), (9.96, "10"), (9.94, "9.9")),
                *((1.0, "1.0"), (0.996, "1.0"), (0.3149, "0.31"), (0.005234, "0.0052"), (0.0000123, "0.000012")),
                (0.0, "0"),
            )
        ),
        *(
            ("recall_at_1", found(value), shown)
            for value, shown in ((100.0, "100.0"), (0.0, "0.0"), (37.04, "37.0"), (99.97, "100.0"))
        ),
        *(
            ("recall_at_1", found(46.8, spread=spread), shown)
            for spread, shown in ((1.26, "46.8 ± 1.3"), (0.021, "46.8 ± 0.02"), (0.0, "46.8 ± 0"))
        ),
        *(
            ("query_cpu", found(1615.0, spread=spread), shown)
            for spread, shown in ((9.3, "1,615 ± 9"), (0.04, "1,615 ± 0.04"), (1234.0, "1,615 ± 1,234"))
        ),
        ("recall_at_1", found(46.8, spread=1.26, low=44.93, high=48.68), "46.8 ± 1.3 [44.9, 48.7]"),
        ("train_cpu", found(0.0691, total=0.2512), "0.069 (0.25)"),
        ("train_cpu", found(0.31, disturbed=True), "~0.31"),
    ],
)
def test_a_number_shows_as_many_digits_as_it_has(quantity: str, made: Cell, shown: str) -> None:
    assert in_markdown(alone(made, quantity), quantity) == [shown]


@pytest.mark.parametrize(
    ("quantity", "made", "shown"),
    [
        *(
            ("query_cpu", cell("not run", **paper(value)), shown)
            for value, shown in ((0.5, "0.5"), (1.0, "1"), (1634.0, "1,634"), (15120.0, "15,120"))
        ),
        *(
            ("recall_at_1", found(value, 48.0), f"48 ({shown})")
            for value, shown in ((47.97, "0.0"), (48.03, "0.0"), (48.06, "+0.1"), (40.0, "-8.0"))
        ),
        ("query_cpu", found(1368.4, 353.0, at_boundary=1614.96), "353 (match alone here: 1,615; +1,262)"),
        ("query_cpu", replace(found(1.0, 2.0, at_boundary=3.0), difference=None), "2 (match alone here: 3.0)"),
        ("query_cpu", replace(found(41.0, at_boundary=50.0), published_mark="not applicable"), "-"),
        ("recall_at_1", replace(found(46.6, 48.0), difference=None), "48"),
    ],
)
def test_what_the_paper_printed_stands_below_with_the_difference(quantity: str, made: Cell, shown: str) -> None:
    assert in_markdown(alone(made, quantity), quantity)[1] == shown


@pytest.mark.parametrize(
    ("made", "words"),
    [
        (alone(found(41.0)), set()),
        (alone(found(41.0, 37.0)), {"Line paper", "printed; in brackets", "none:"}),
        (alone(found(41.0, spread=1.0)), {"±"}),
        (alone(found(41.0, low=1.0, high=2.0)), {"queries: the wider"}),
        (alone(found(41.0, low=1.0, high=2.0, seeds=(0, 1))), {"of their mean: the wider"}),
        (alone(cell("quoted", quoted=4.0)), {"Italics"}),
        (alone(found(41.0, total=50.0), "train_cpu"), {"Training:"}),
        (alone(found(41.0, at_boundary=50.0), "query_cpu"), {"memory, encoding and"}),
        (
            alone(found(41.0, 37.0, at_boundary=50.0), "query_cpu"),
            {"memory, encoding and", "of one step", "Line paper", "printed; in brackets", "none:"},
        ),
    ],
)
def test_only_what_a_table_shows_is_explained(made: Table, words: set[str]) -> None:
    known = {"Line paper", "printed; in brackets", "none:", "±", "queries: the wider", "of their mean: the wider"}
    known |= {"Italics", "Training:", "memory, encoding and", "of one step"}
    text = formats.markdown(made)
    assert {word for word in known if word in text} == words


def test_a_comparison_keeps_its_order_and_says_nothing_of_a_paper() -> None:
    rows = row("VPRTempo", spiking=True, recall_at_1=found(54.3, notes=(1,))), row("SAD", recall_at_1=found(40.0))
    made = small(*rows, title="Corridor_1", quantities=quantities([], ("cpu",)), notes=told("a note"))
    assert [line[0] for line in markdown_table(made)] == ["method", "VPRTempo", "SAD"]
    assert [line["quantity"] for line in in_csv(made)][:3] == ["recall_at_1", "train_cpu", "query_cpu"]
    texts = [getattr(formats, form)(made) for form in ("markdown", "csv", "latex", "html")]
    fragment = formats.latex(made, fragment=True)
    for text in (*texts, fragment):
        assert not any(word in text for word in ("Table II", "aper line", "ICRA", "GPU", "Line paper"))
    assert [line for line in fragment.splitlines() if line.startswith("{")] == [
        r"{VPRTempo} & 54.3 &  & \multicolumn{2}{c}{not run} & \multicolumn{2}{c}{not run} \\",
        r"{SAD} & 40.0 &  & \multicolumn{2}{c}{not run} & \multicolumn{2}{c}{not run} \\",
    ]
    assert "documentclass" not in fragment


def test_a_terminal_shows_each_row_and_note_in_100_columns() -> None:
    made = table()
    lines = formats.for_terminal(made).splitlines()
    assert max(map(len, lines)) <= 100
    assert {row.name for row in made.rows} <= {line.split("  ")[0] for line in lines}
    assert sum(line.startswith(f"{number} ") for number in range(1, len(made.notes) + 1) for line in lines) >= 1


def test_a_table_of_no_runs_is_one_of_words() -> None:
    made = small(row("SAD", recall_at_1=cell("unfinished", **paper(48.0))), columns=(NO_RUN,), machines=())
    assert in_markdown(made) == ["unfinished", "48"]
    assert "\nno run is stored\n" in formats.markdown(made)
    assert {line["value"] for line in in_csv(made)} == {""}


def test_links_of_notes_lead_to_their_anchors_and_no_style_is_in_the_html() -> None:
    tags = Grid(formats.html(table())).tags
    anchors = {attributes["id"] for _, attributes in tags if "id" in attributes}
    links = {str(attributes["href"]).removeprefix("#") for tag, attributes in tags if tag == "a"}
    assert {f"table-note-{n}" for n in range(1, 9)} <= links <= anchors
    assert not any("style" in attributes or tag == "style" for tag, attributes in tags)


def named(text: str) -> Table:
    """Return a table that holds a text wherever it holds any."""
    column = Column("rail", text, 1, 1, text, text)
    made = small(row(text, recall_at_1=found(41.0, notes=(1,))), row("second"), columns=(column,))
    return replace(made, notes=told(text), machines=(text, text), caption=(text, text))


def test_hostile_text_is_only_text() -> None:
    harmless, hostile = (Grid(formats.html(named(text))) for text in ("harmless", HOSTILE))
    assert (hostile.tags, hostile.rows[2][0]) == (harmless.tags, HOSTILE)
    lines = markdown_table(named(HOSTILE))
    assert [len(line) for line in lines] == [6, 6, 6]
    assert lines[1][0] == (
        r"&lt;script&gt;alert(1)&lt;/script&gt; a\|b \*c\* \_d\_ \`e\` \[f\](g) \\ &amp;amp; \~h\~ \$i\$ é η"
    )
    assert "<" not in formats.markdown(named(HOSTILE))


@pytest.mark.parametrize("text", ["vprtempo_ensemble", "SAD [43.3, 50.1], weights not in ~/.cache"])
def test_harmless_text_stands_in_markdown_as_it_is(text: str) -> None:
    assert text in formats.markdown(small(caption=("first", text)))


@pytest.mark.parametrize("name", ["- a", "+ a", "1. a", "23) a", "= a", "# a"])
def test_no_text_begins_a_list_or_a_head_of_markdown(name: str) -> None:
    made = formats.markdown(small(row("SAD"), caption=("first", name)))
    assert any(line.replace("\\", "") == name and "\\" in line for line in made.splitlines())


def test_lines_within_text_end_neither_a_row_nor_a_line_of_csv() -> None:
    made = small(row("a\nb\r\n\tc\x00d", recall_at_1=found(41.0, notes=(1,))), notes=told("Error:\n  at line 3\n"))
    assert markdown_table(made)[1][:2] == ["a b c d", "41.0 ¹"]
    assert len(formats.csv(made).splitlines()) == 6
    assert in_csv(made)[0]["notes"] == "Error: at line 3"
    assert Grid(formats.html(made)).rows[2][0] == "a b c d"
