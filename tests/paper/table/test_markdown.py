"""Table II in Markdown, CSV and HTML: known numbers come out unchanged, and every mark is told apart.

1259 of 2700 queries are 46.6296... %; the paper's 48 is 1.3703... more.
"""

from __future__ import annotations

import csv
import io
import math
import re
from dataclasses import replace
from html.parser import HTMLParser

import pandas as pd
import pytest
from made_table import GPU, OTHER, RECALL, cell, found, measured, paper, row, small, table

from vprbench.paper.plan import QUANTITIES, Quantity
from vprbench.paper.table import markdown as table_formats
from vprbench.paper.table.cells import Cell, Column, Table
from vprbench.paper.table.words import TRAINING_TIME

HEADS = ("R@1 %", "train CPU min", "query CPU Hz", "train GPU min", "query GPU Hz")
HOSTILE = "<script>alert(1)</script> a|b *c* _d_ `e` [f](g) \\ &amp; ~h~ $i$ é η"


def markdown_tables(text: str) -> list[list[list[str]]]:
    """Return the cells of each Markdown table of a text: a pipe that is escaped ends none."""
    tables: list[list[list[str]]] = [[]]
    for line in text.splitlines():
        if line.startswith("|"):
            tables[-1].append([part.strip() for part in re.split(r"(?<!\\)\|", line)[1:-1]])
        elif tables[-1]:
            tables.append([])
    return [[lines[0], *lines[2:]] for lines in tables if lines]


def in_markdown(made: Table, quantity: Quantity = "recall_at_1", name: str = "SAD") -> list[str]:
    """Return the one or two lines of a row's cell in the first table."""
    head, *lines = markdown_tables(table_formats.markdown(made))[0]
    place = 1 + QUANTITIES.index(quantity)
    assert head[place] == HEADS[place - 1]
    start = next(i for i, line in enumerate(lines) if line[0] == name)
    return [lines[start][place], *(line[place] for line in lines[start + 1 : start + 2] if line[0] == "↳ paper")]


def in_csv(made: Table) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(table_formats.csv(made))))


class Grid(HTMLParser):
    """Collects the cells of tables: tag, attributes and text; a break is a line."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.rows: list[list[tuple[str, dict[str, str | None], str]]] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []
        self.text = ""
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag == "br":
            self.text += "\n"
        elif tag != "col":
            self.open.append(tag)
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append((tag, dict(attrs), ""))
            self.text = ""

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag
        if tag in ("td", "th"):
            kind, attrs, _ = self.rows[-1].pop()
            self.rows[-1].append((kind, attrs, self.text))

    def handle_data(self, data: str) -> None:
        self.text += data


def in_html(made: Table, quantity: Quantity = "recall_at_1", name: str = "SAD") -> tuple[str | None, list[str]]:
    """Return the class and the lines of a row's cell of the first dataset."""
    line = next(line for line in Grid(table_formats.html(made)).rows if line[0][2] == name)
    _, attributes, text = line[1 + QUANTITIES.index(quantity)]
    return attributes["class"], text.split("\n")


def bare(text: str) -> str:
    """Return what is left without emphasis, raising, spaces and commas."""
    return re.sub(r"[*, ]", "", text).translate(str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹", "0123456789"))


def alone(made: Cell, quantity: Quantity = "recall_at_1") -> Table:
    return small(row("SAD", **{quantity: made}), notes=("first", "second"))


# Known answers


def test_a_known_share_is_the_same_in_every_format() -> None:
    made = alone(found(RECALL, 48.0, (1,), low=44.7531, high=48.5153))
    assert in_markdown(made) == ["46.6 [44.8, 48.5] ¹", "48 (-1.4)"]
    assert in_html(made) == ("measured", ["46.6 [44.8, 48.5]1", "paper 48 (-1.4)"])
    assert r"46.6 [44.8, 48.5]\textsuperscript{1} &" in table_formats.latex(made)
    assert in_csv(made)[0]["value"] == "46.62962962962963"


def test_csv_has_one_line_for_each_row_dataset_and_quantity() -> None:
    lines = in_csv(table())
    assert len({(line["row"], line["column"], line["quantity"]) for line in lines}) == len(lines) == 5 * 2 * 5


def test_a_line_of_csv_holds_all_that_is_known_of_a_cell() -> None:
    line = in_csv(table())[4 * 10 + 4]
    assert line == {
        "row": "VPRTempo",
        "column": "rail",
        "title": "Railway (rendered)",
        "quantity": "query_gpu",
        "unit": "Hz",
        "mark": "measured",
        "value": "22345.6",
        "low": "",
        "high": "",
        "interval": "",
        "block": "",
        "spread": "100.0",
        "seeds": "0 1 2",
        "total": "20999.5",
        "best": "False",
        "disturbed": "False",
        "machine": GPU,
        "published": "1634.0",
        "published_mark": "measured",
        "difference": "20711.6",
        "notes": "other hardware and other data",
    }


def test_csv_joins_notes_and_tells_marks() -> None:
    lines = {(line["row"], line["column"], line["quantity"]): line for line in in_csv(table())}
    unfinished = lines["VPRSNN", "street", "recall_at_1"]
    assert (unfinished["mark"], unfinished["value"]) == ("unfinished", "38.5")
    assert unfinished["notes"] == "other data: rendered frames stand in for the paper's; 1 of 3 seeds is stored"
    quoted = lines["NetVLAD", "rail", "train_cpu"]
    assert (quoted["mark"], quoted["value"], quoted["machine"]) == ("quoted", "15120.0", "")
    assert (quoted["published"], quoted["published_mark"]) == ("15120.0", "quoted")
    assert lines["SAD", "street", "query_cpu"]["disturbed"] == lines["SAD", "street", "recall_at_1"]["best"] == "True"


def test_pandas_reads_the_numbers_back() -> None:
    made = table()
    read = pd.read_csv(io.StringIO(table_formats.csv(made)))
    assert read["best"].sum() == 3
    for line in read.to_dict("records"):
        known = next(r for r in made.rows if r.name == line["row"]).cells[line["column"], line["quantity"]]
        for name in ("value", "low", "high", "spread", "total"):
            number = getattr(known.measured, name) if known.measured else known.quoted if name == "value" else None
            assert line[name] == pytest.approx(math.nan if number is None else number, rel=1e-15, nan_ok=True)


def test_markdown_and_html_hold_the_same_words_in_all_cells() -> None:
    tables = markdown_tables(table_formats.markdown(table()))
    grid = [[text for _, _, text in line] for line in Grid(table_formats.html(table())).rows[2:]]
    for d in range(2):
        lines = [line for line in tables[d][1:] if line[0] != "*spiking*"]
        for upper, lower, cells in zip(lines[::2], lines[1::2], grid, strict=True):
            assert upper[0] == cells[0]
            for q in range(1, 6):
                mine = bare(f"{upper[q]}\npaper {lower[q]}")
                assert mine == bare(cells[5 * d + q])


# Marks


@pytest.mark.parametrize(
    ("made", "kind", "markdown", "html"),
    [
        (found(54.321, 56.0, best=True), "measured", ["**54.3**", "56 (-1.7)"], ["54.3", "paper 56 (-1.7)"]),
        (cell("quoted", quoted=48.0, **paper(48.0, "quoted")), "quoted", ["*48*", "*48*"], ["48", "paper 48"]),
        (cell("not applicable", **paper(None)), "absent", ["-", "-"], ["-", "paper -"]),
        (cell("not there", **paper(32.0), notes=(2,)), "absent", ["not there ²", "32"], ["not there2", "paper 32"]),
        (cell("failed", **paper(53.0), notes=(1, 2)), "absent", ["failed ¹,²", "53"], ["failed1, 2", "paper 53"]),
        (cell("left out", **paper(31.0)), "absent", ["left out", "31"], ["left out", "paper 31"]),
        (cell("not run", **paper(17.0)), "absent", ["not run", "17"], ["not run", "paper 17"]),
        (cell("unfinished", **paper(40.0)), "absent", ["unfinished", "40"], ["unfinished", "paper 40"]),
        (
            cell("unfinished", measured=measured(38.5, low=33.6, high=43.6), **paper(40.0), difference=-1.5),
            "absent",
            ["unfinished: 38.5 [33.6, 43.6]", "40 (-1.5)"],
            ["unfinished: 38.5 [33.6, 43.6]", "paper 40 (-1.5)"],
        ),
    ],
)
def test_every_mark_is_told_apart(made: Cell, kind: str, markdown: list[str], html: list[str]) -> None:
    assert in_markdown(alone(made)) == markdown
    assert in_html(alone(made)) == (kind, html)
    assert in_csv(alone(made))[0]["mark"] == made.mark


def test_best_and_quoted_are_elements_of_html_that_need_no_style() -> None:
    assert '<b class="best">54.3</b>' in table_formats.html(alone(found(54.321, best=True)))
    assert table_formats.html(alone(cell("quoted", quoted=48.0, **paper(48.0, "quoted")))).count("<i>48</i>") == 2


def test_no_cell_of_the_whole_table_is_blank() -> None:
    for lines in markdown_tables(table_formats.markdown(table())):
        assert all(all(line) for line in lines if line[0] != "*spiking*")
    for line in Grid(table_formats.html(table())).rows:
        assert all(text.strip() for _, _, text in line)
    assert all(line["mark"] and line["published_mark"] for line in in_csv(table()))


def test_a_row_that_the_paper_lacks_has_no_line_of_the_paper() -> None:
    made = small(row("HOG", recall_at_1=found(20.0)), row("SAD", recall_at_1=found(41.0, 37.0)))
    assert in_markdown(made, name="HOG") == ["20.0"]
    assert in_html(made, name="HOG") == ("measured", ["20.0"])


def test_a_cell_that_the_paper_lacks_beside_others_says_so() -> None:
    made = small(row("SAD", recall_at_1=found(20.0), query_cpu=found(41.0, 37.0)))
    assert in_markdown(made) == ["20.0", "none"]
    assert "; none: it has no such number." in table_formats.markdown(made)


# Numbers


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        (1614.96, "1,615"),
        (22345.6, "22,346"),
        (15120.0, "15,120"),
        (252.3, "252"),
        (10.4, "10"),
        (9.96, "10"),
        (9.94, "9.9"),
        (1.0, "1.0"),
        (0.996, "1.0"),
        (0.3149, "0.31"),
        (0.005234, "0.0052"),
        (0.0000123, "0.000012"),
        (0.0, "0"),
    ],
)
@pytest.mark.parametrize("quantity", ["train_cpu", "query_gpu"])
def test_minutes_and_rates_keep_two_digits_and_never_vanish(quantity: Quantity, value: float, shown: str) -> None:
    assert in_markdown(alone(found(value), quantity), quantity) == [shown]


@pytest.mark.parametrize(("value", "shown"), [(100.0, "100.0"), (0.0, "0.0"), (37.04, "37.0"), (99.97, "100.0")])
def test_recall_has_one_decimal(value: float, shown: str) -> None:
    assert in_markdown(alone(found(value))) == [shown]


@pytest.mark.parametrize(
    ("value", "spread", "shown"),
    [
        (46.8, 1.26, "46.8 ± 1.3"),
        (46.8, 0.021, "46.8 ± 0.02"),
        (46.8, 0.0, "46.8 ± 0"),
    ],
)
def test_several_seeds_show_their_spread(value: float, spread: float, shown: str) -> None:
    assert in_markdown(alone(found(value, seeds=(0, 1, 2), spread=spread))) == [shown]


@pytest.mark.parametrize(("spread", "shown"), [(9.3, "1,615 ± 9"), (0.04, "1,615 ± 0.04"), (1234.0, "1,615 ± 1,234")])
def test_a_spread_has_the_decimals_of_its_number(spread: float, shown: str) -> None:
    assert in_markdown(alone(found(1615.0, spread=spread), "query_cpu"), "query_cpu") == [shown]


def test_recall_of_several_seeds_shows_its_spread_and_the_interval_of_its_mean() -> None:
    made = alone(found(46.8, seeds=(0, 1, 2), spread=1.26, low=44.93, high=48.68))
    assert in_markdown(made) == ["46.8 ± 1.3 [44.9, 48.7]"]
    assert in_html(made) == ("measured", ["46.8 ± 1.3 [44.9, 48.7]"])
    assert r" & 46.8 ± 1.3 [44.9, 48.7] &" in table_formats.latex(made)
    said = "95 % interval of R@1 over the queries"
    assert f"{said}; of several seeds, of their mean: the wider" in table_formats.markdown(made)
    assert f"{said}: the wider" in table_formats.markdown(alone(found(RECALL, low=44.7531, high=48.5153)))


def test_a_rate_of_one_step_shows_that_of_both_in_brackets() -> None:
    made = alone(found(1614.96, 353.0, total=1368.4, spread=20.3), "query_cpu")
    assert in_markdown(made, "query_cpu") == ["1,615 ± 20 (1,368)", "353 (+1,262)"]
    text = table_formats.markdown(made)
    assert "matching for the others); in brackets encoding and matching together" in text
    assert "without brackets" not in text


def test_a_rate_of_both_steps_has_no_brackets_and_is_told_from_that_of_one() -> None:
    own = row("HOG", query_cpu=found(50.0))
    assert in_markdown(small(own), "query_cpu", "HOG") == ["50"]
    assert "from memory, encoding and matching together." in table_formats.markdown(small(own))
    both = table_formats.markdown(small(own, row("SAD", query_cpu=found(12.5, total=11.25))))
    assert "Query rates without brackets, of rows that are not the paper's: both together." in both


def test_training_shows_the_time_with_the_images_in_brackets() -> None:
    made = alone(found(0.0691, total=0.2512), "train_cpu")
    assert in_markdown(made, "train_cpu") == ["0.069 (0.25)"]
    assert in_html(made, "train_cpu") == ("measured", ["0.069 (0.25)"])
    text = table_formats.markdown(made)
    assert f"Training: {TRAINING_TIME[0].lower()}{TRAINING_TIME[1:]}" in text
    assert "Query rates" not in text
    assert "Training:" not in table_formats.markdown(alone(found(0.0691), "train_cpu"))


@pytest.mark.parametrize(("compared", "told"), [(True, True), (False, False)])
def test_the_brackets_of_the_papers_line_are_explained_where_there_are_any(compared: bool, told: bool) -> None:
    one = found(46.6, 48.0) if compared else replace(found(46.6, 48.0), difference=None)
    texts = (table_formats.markdown(alone(one)), table_formats.html(alone(one)), table_formats.latex(alone(one)))
    assert ["measured less printed" in text for text in texts] == [told] * 3
    assert ["(-1.4)" in text or "($-$1.4)" in text for text in texts] == [told] * 3


def test_a_disturbed_measurement_has_a_tilde() -> None:
    assert in_markdown(alone(found(0.31, disturbed=True), "train_cpu"), "train_cpu") == ["~0.31"]


@pytest.mark.parametrize(("published", "shown"), [(0.5, "0.5"), (1.0, "1"), (1634.0, "1,634"), (15120.0, "15,120")])
def test_what_the_paper_printed_gains_and_loses_no_digit(published: float, shown: str) -> None:
    assert in_markdown(alone(cell("not run", **paper(published)), "query_cpu"), "query_cpu")[1] == shown


@pytest.mark.parametrize(
    ("value", "published", "shown"),
    [(47.97, 48.0, "0.0"), (48.03, 48.0, "0.0"), (48.06, 48.0, "+0.1"), (40.0, 48.0, "-8.0")],
)
def test_a_difference_has_a_sign_unless_it_vanishes(value: float, published: float, shown: str) -> None:
    assert in_markdown(alone(found(value, published)))[1] == f"48 ({shown})"


# Notes, machines, explanations


def test_machines_are_marked_where_there_are_several() -> None:
    made = small(
        row("SAD", recall_at_1=found(41.0), query_cpu=found(10.0), query_gpu=found(20.0, machine=1)),
        machines=(OTHER, GPU),
    )
    assert [in_markdown(made, quantity)[0] for quantity in QUANTITIES] == [
        "41.0 M1",
        "not run",
        "10 M1",
        "not run",
        "20 M2",
    ]
    assert in_html(made, "query_gpu") == ("measured", ["20M2"])
    for text in (table_formats.markdown(made), table_formats.html(made)):
        assert f"M1: {OTHER}" in text
        assert f"M2: {GPU}" in text
    assert "Machine: Abacus 9" in table_formats.markdown(alone(found(41.0)))


def test_notes_stand_below_under_the_numbers_of_their_cells() -> None:
    many = tuple(f"reason {n}" for n in range(1, 13))
    made = small(row("SAD", recall_at_1=found(41.0, notes=(2, 12))), notes=many)
    assert in_markdown(made) == ["41.0 ²,¹²"]
    assert "\n2. reason 2\n" in table_formats.markdown(made)
    assert "\n12. reason 12\n" in table_formats.markdown(made)
    tags = Grid(table_formats.html(made)).tags
    anchors = {attributes["id"] for _, attributes in tags if "id" in attributes}
    links = {str(attributes["href"]).removeprefix("#") for tag, attributes in tags if tag == "a"}
    assert links == {"table-note-2", "table-note-12"} <= anchors


def test_only_what_a_table_shows_is_explained() -> None:
    plain = table_formats.markdown(alone(found(41.0)))
    assert not any(word in plain for word in ("Italics", "±", "interval", "Line paper", "brackets"))
    whole = table_formats.markdown(table())
    assert "none:" not in whole
    assert all(
        whole.count(word) == 1
        for word in ("Italics:", "±: ", "[low, high]:", "Line paper:", "Training:", "Query rates:")
    )


def test_spiking_rows_stand_below_the_others_in_a_part_of_their_own() -> None:
    made = small(row("VPRTempo", spiking=True), row("SAD"), row("VPRSNN", spiking=True))
    names = [line[0] for line in markdown_tables(table_formats.markdown(made))[0][1:]]
    assert names == ["SAD", "*spiking*", "VPRTempo", "VPRSNN"]
    bodies = re.findall(r"<tbody.*?</tbody>", table_formats.html(made), re.DOTALL)
    assert [re.findall(r'scope="row">(\w+)', body) for body in bodies] == [["SAD"], ["VPRTempo", "VPRSNN"]]
    assert bodies[1].startswith('<tbody class="spiking">')


def test_a_dataset_without_runs_is_a_table_of_words() -> None:
    nothing = Column("rail", "Nordland", None, None, "no run is stored", None)
    made = small(row("SAD", recall_at_1=cell("unfinished", **paper(48.0))), columns=(nothing,), machines=())
    assert in_markdown(made) == ["unfinished", "48"]
    assert "\nno run is stored\n" in table_formats.markdown(made)
    assert in_html(made) == ("absent", ["unfinished", "paper 48"])
    assert {line["value"] for line in in_csv(made)} == {""}


def test_a_stand_in_says_so_at_its_table() -> None:
    line = "3,300 places; 2,700 queries; summer against spring and fall; stands in for Nordland"
    assert f"## Railway (rendered)\n\n{line}\n\n|" in table_formats.markdown(table())
    assert line in Grid(table_formats.html(table())).rows[0][1][2]


# Structure and hostile text


def test_html_heads_span_their_cells() -> None:
    titles, heads, *lines = Grid(table_formats.html(table())).rows
    assert [(a["scope"], a.get("colspan"), a.get("rowspan")) for _, a, _ in titles] == [
        ("col", None, "2"),
        ("colgroup", "5", None),
        ("colgroup", "5", None),
    ]
    assert [text for _, _, text in heads] == [*HEADS, *HEADS]
    assert all([tag for tag, _, _ in line] == ["th"] + ["td"] * 10 and line[0][1]["scope"] == "row" for line in lines)


def test_html_has_no_style_of_its_own_and_scrolls_in_a_frame_that_the_keyboard_reaches() -> None:
    tags = Grid(table_formats.html(table())).tags
    assert not any("style" in attributes or tag == "style" for tag, attributes in tags)
    assert tags[0] == ("div", {"class": "scroll", "tabindex": "0", "role": "region", "aria-label": "Table II"})
    assert [tag for tag, _ in tags].count("caption") == 1


def named(text: str) -> Table:
    """Return a table that holds a text wherever it holds any."""
    column = Column("rail", text, 1, 1, text, text)
    made = small(row(text, recall_at_1=found(41.0, notes=(1,))), row("second"), columns=(column,))
    return replace(made, notes=(text,), machines=(text, text), caption=(text, text))


def test_hostile_text_is_only_text_in_html() -> None:
    harmless, hostile = (Grid(table_formats.html(named(text))) for text in ("harmless", HOSTILE))
    assert hostile.tags == harmless.tags
    assert hostile.rows[2][0][2] == HOSTILE


def test_hostile_text_breaks_no_cell_of_markdown_and_holds_no_markup() -> None:
    text = table_formats.markdown(named(HOSTILE))
    lines = markdown_tables(text)[0]
    assert [len(line) for line in lines] == [6, 6, 6]
    assert lines[1][0] == (
        r"&lt;script&gt;alert(1)&lt;/script&gt; a\|b \*c\* \_d\_ \`e\` \[f\](g) \\ &amp;amp; \~h\~ \$i\$ é η"
    )
    assert "<" not in text


def test_names_with_underscores_stay_readable_in_markdown() -> None:
    assert "vprtempo_ensemble" in table_formats.markdown(small(row("vprtempo_ensemble")))


@pytest.mark.parametrize("name", ["- a", "+ a", "1. a", "23) a", "= a", "# a"])
def test_no_text_begins_a_list_or_a_head_of_markdown(name: str) -> None:
    made = small(row("SAD"), caption=("first", name))
    assert any(line.replace("\\", "") == name and "\\" in line for line in table_formats.markdown(made).splitlines())


def test_lines_within_text_end_neither_a_row_nor_a_line_of_csv() -> None:
    made = small(row("a\nb\r\n\tc\x00d", recall_at_1=found(41.0, notes=(1,))), notes=("Error:\n  at line 3\n",))
    assert in_markdown(made, name="a b c d") == ["41.0 ¹"]
    assert "\n1. Error: at line 3\n" in table_formats.markdown(made)
    assert len(table_formats.csv(made).splitlines()) == 6
    assert in_csv(made)[0]["notes"] == "Error: at line 3"
    assert in_html(made, name="a b c d")[1] == ["41.01"]


def test_an_interval_and_a_home_folder_stand_in_markdown_as_they_are() -> None:
    text = "SAD [43.3, 50.1], weights not in ~/.cache"
    assert text in table_formats.markdown(replace(table(), caption=("first", text)))
