"""How a reader finds their way through a report: findings, tabs, links, the table, its footnotes and the figures."""

from __future__ import annotations

import re
from collections.abc import Iterator

import pytest
from made_table import table
from playwright.sync_api import Page, expect
from report_page import SAD_WRONG, drawn_figure, journey_run, journey_section, journey_thumbnails
from report_reader import Reader, choose, current, focused, listed, widest

from vprbench.paper.page.page import Picture, Section, page
from vprbench.paper.selection import Series
from vprbench.paper.table import formats

LEFT_OUT = re.compile(f"^{1 + [note.code for note in table().notes].index('left out')}$")
OTHER_WRONG = dict.fromkeys(range(30), 0.25)

pytest_plugins = ["report_browser"]


@pytest.fixture(scope="module")
def text() -> str:
    """A report of two datasets, with a real table and two figures."""
    other = Section("Other", (Series("SAD", False, (journey_run(OTHER_WRONG),)),), None)
    pictures = [Picture(name, "What is drawn.", drawn_figure()) for name in ("speed", "recall")]
    return page(formats.html(table()), pictures, [journey_section(thumbnails=journey_thumbnails()), other])


@pytest.fixture(params=[1280, 360])
def tab(request: pytest.FixtureRequest, text: str, reader: Reader) -> Iterator[Page]:
    """The report on a screen so many pixels wide, which never scrolls sideways."""
    tab = reader.read(text, viewport={"width": request.param, "height": 740})
    yield tab
    assert widest(tab) <= request.param


def test_the_findings_of_the_chosen_dataset_come_first_and_the_failures_next(tab: Page) -> None:
    heads = tab.locator("h2").all_text_contents()
    assert heads[:4] == ["Findings", "Failures, query by query", "Table", "Figures"]
    found = tab.locator("#findings p:visible")
    assert 2 <= found.count() <= 3
    expect(found.first).to_contain_text("VPRTempo")
    choose(tab, dataset="Other")
    expect(found).to_have_count(1)
    expect(found).to_contain_text("SAD")


def test_tabs_are_walked_by_arrow_keys_over_their_ends(tab: Page) -> None:
    tabs = tab.get_by_role("tablist", name="Datasets").get_by_role("tab")
    tabs.first.focus()
    for key, chosen in [("ArrowRight", 1), ("ArrowRight", 0), ("ArrowLeft", 1), ("Home", 0), ("End", 1)]:
        tab.keyboard.press(key)
        assert focused(tab) == f"dataset-{chosen}"
        selected = tabs.evaluate_all("all => all.map(e => [e.ariaSelected, e.tabIndex])")
        assert selected == [["true", 0] if i == chosen else ["false", -1] for i in range(2)]
        expect(tab.get_by_role("tabpanel")).to_have_accessible_name(["Journey", "Other"][chosen])
        assert len(listed(tab)) == [len(SAD_WRONG), 10][chosen]


def test_a_copied_link_shows_what_was_seen(tab: Page) -> None:
    assert "#" not in tab.url
    choose(tab, dataset="Other", order="along the route")
    choose(tab, kind="A right")
    tab.locator("#next-page").click()
    tab.locator("#queries button").nth(4).click()
    seen = current(tab), listed(tab)
    expect(tab).to_have_url(re.compile(f"query={seen[0]}"))
    other = tab.context.new_page()
    other.goto(tab.url)
    assert (current(other), listed(other)) == seen
    expect(other.locator("#query-44")).to_be_in_viewport()
    expect(other.locator("#kind option:checked")).to_contain_text("A right")
    choose(other, dataset="Journey", method_b="VPRTempo, seed 0", kind="A wrong, B right")
    expect(other).to_have_url(re.compile("b=VPRTempo"))
    tab.goto(other.url)
    assert listed(tab) == listed(other) == [3, 11, 20, 30]


def test_a_link_to_what_is_not_there_shows_what_is(tab: Page) -> None:
    tab.goto(f"{tab.url}#dataset=No&a=No&b=No&show=a-not-b&sort=No&query=No")
    expect(tab.locator("#status")).to_have_text("1 to 5 of 5: A wrong, ties included")


def names(tab: Page) -> list[str]:
    """The rows that are seen, in their order."""
    return tab.locator("#table tbody tr:visible th").all_text_contents()


def test_the_table_is_sorted_by_any_column_and_back(tab: Page) -> None:
    before = names(tab)
    recall = tab.locator("#table th[aria-sort]").nth(1)
    orders = [
        ("descending", ["VPRTempo", "SAD"]),
        ("ascending", ["SAD", "VPRTempo"]),
        ("none", before),
    ]
    for order, first in orders:
        recall.get_by_role("button").press("Enter")
        expect(recall).to_have_attribute("aria-sort", order)
        assert names(tab)[: len(first)] == first
    assert sorted(names(tab)) == sorted(before)
    tab.locator("#table th[aria-sort]").nth(3).get_by_role("button").click()
    assert names(tab)[:2] == ["VPRTempo", "SAD"]
    tab.locator("#table th[aria-sort]").first.get_by_role("button").click()
    assert names(tab) == sorted(before)


def test_the_table_is_filtered_by_a_word(tab: Page) -> None:
    before = names(tab)
    for word, left in [("vpr", ["VPRSNN", "VPRTempo"]), ("spiking", ["VPRSNN", "VPRTempo"]), ("gcl ", ["GCL"])]:
        tab.get_by_label("Rows with the word").fill(word)
        assert names(tab) == left
        expect(tab.locator("#rows")).to_have_text(f"{len(left)} of {len(before)} rows")
    tab.get_by_label("Rows with the word").fill("")
    assert names(tab) == before


def test_a_footnote_is_shown_on_hover_and_on_focus_until_escape(tab: Page) -> None:
    mark = tab.locator("#table sup a", has_text=LEFT_OUT).first
    note = tab.get_by_role("tooltip")
    expect(note).to_be_hidden()
    for show in (mark.hover, mark.focus):
        tab.mouse.move(0, 0)
        show()
        expect(note).to_contain_text("set FULL=1")
        box = note.bounding_box()
        size = tab.viewport_size
        assert box is not None
        assert size is not None
        assert box["x"] >= 0
        assert box["x"] + box["width"] <= size["width"]
        tab.keyboard.press("Escape")
        expect(note).to_be_hidden()


def test_a_tap_shows_a_footnote_and_stays_at_the_cell(text: str, reader: Reader) -> None:
    tab = reader.read(text, viewport={"width": 360, "height": 740}, has_touch=True)
    tab.locator("#table sup a", has_text=LEFT_OUT).first.tap()
    expect(tab.get_by_role("tooltip")).to_contain_text("set FULL=1")
    assert "#" not in tab.url


def test_a_figure_is_enlarged_by_click_or_enter_and_closed_again(tab: Page) -> None:
    image, button = tab.locator("#large-recall img"), tab.get_by_role("button", name="Enlarge figure recall")
    button.scroll_into_view_if_needed()
    small = image.bounding_box()
    assert small is not None
    for enlarge, close in [
        (button.click, lambda: tab.keyboard.press("Escape")),
        (lambda: button.press("Enter"), lambda: tab.locator("#large-recall .close").click()),
    ]:
        enlarge()
        expect(tab.locator("#large-recall .close")).to_be_visible()
        large = image.bounding_box()
        assert large is not None
        assert large["width"] > 1.5 * small["width"]
        close()
        assert image.bounding_box() == small
