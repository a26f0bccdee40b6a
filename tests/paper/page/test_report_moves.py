"""How a reader moves through a report's queries in a real browser: by strip, slider, keys and pages."""

from __future__ import annotations

import numpy as np
from playwright.sync_api import Page, expect
from report_page import N_QUERIES, SAD_WRONG, TEMPO_WRONG, answered
from report_reader import Reader, choose, current, focused, listed, queries_of

from vprbench.paper.page.page import Section, page
from vprbench.paper.selection import Series

ROUTE = "along the route"

pytest_plugins = ["report_browser"]


def test_the_strip_shows_hits_and_misses_where_they_are(tab: Page) -> None:
    choose(tab, method_b="VPRTempo, seed 0")
    lanes = tab.locator("#lanes .lane")
    wrong = [queries_of(lanes.nth(i).locator(".bars.wrong").get_attribute("d") or "") for i in (0, 1)]
    assert wrong == [set(SAD_WRONG) - {20}, set(TEMPO_WRONG)]
    assert queries_of(lanes.nth(0).locator(".bars.tied").get_attribute("d") or "") == {20}
    assert queries_of(lanes.nth(2).locator(".bars.shown").get_attribute("d") or "") == set(SAD_WRONG)
    expect(lanes.nth(0)).to_contain_text("A, SAD: 44 right, 4 wrong, 1 tied, 1 no right place")


def test_a_click_into_the_strip_goes_to_the_nearest_query_that_is_shown(tab: Page) -> None:
    strip = tab.locator("#lanes svg").first
    box = strip.bounding_box()
    assert box is not None
    strip.click(position={"x": box["width"] * 32.5 / N_QUERIES, "y": box["height"] / 2})
    assert current(tab) == 30
    assert focused(tab) == "query-30"


def test_the_slider_steps_from_one_shown_query_to_the_next_along_the_route(tab: Page) -> None:
    slider = tab.locator("#along")
    slider.focus()
    assert current(tab) == 11
    keys = ("ArrowRight", 20), ("ArrowLeft", 11), ("ArrowLeft", 10), ("End", 30), ("End", 30), ("Home", 3)
    for key, query in keys:
        slider.press(key)
        assert (current(tab), slider.input_value()) == (query, str(query))
    expect(slider).to_have_attribute("aria-valuetext", "query 3: wrong")
    box = slider.bounding_box()
    assert box is not None
    for x, query in [(box["width"] - 3, 30), (3, 3)]:
        slider.click(position={"x": x, "y": box["height"] / 2})
        assert current(tab) == query


# Keyboard and paging


def test_tab_goes_from_the_controls_over_the_slider_to_one_query_and_on(tab: Page) -> None:
    tab.locator("#method-a").focus()
    visited = []
    for _ in range(6):
        visited.append(focused(tab))
        tab.keyboard.press("Tab")
        outline = tab.evaluate("getComputedStyle(document.activeElement).outline")
        assert "solid" in outline
        assert "3px" in outline
    assert visited == ["method-a", "method-b", "kind", "order", "along", "query-11"]
    assert not focused(tab).startswith("query-")
    tab.locator("#query-11").focus()
    tab.keyboard.press("ArrowDown")
    for expanded in ("true", "false"):
        tab.keyboard.press("Enter")
        expect(tab.locator("#query-3")).to_have_attribute("aria-expanded", expanded)


def test_arrow_keys_walk_the_list_over_the_ends_of_its_pages(tab: Page) -> None:
    choose(tab, kind="all queries", order=ROUTE)
    tab.locator("#query-0").focus()
    for key, query in [("ArrowDown", 1), ("ArrowRight", 2), ("ArrowUp", 1), ("End", 49), ("Home", 0), ("ArrowUp", 0)]:
        tab.keyboard.press(key)
        assert (current(tab), focused(tab)) == (query, f"query-{query}")
    for _ in range(10):
        tab.keyboard.press("ArrowDown")
    assert focused(tab) == "query-10"
    assert listed(tab) == [*range(10, 20)]
    tab.keyboard.press("ArrowLeft")
    assert listed(tab) == [*range(10)]


def test_pages_turn_by_their_buttons_which_do_nothing_at_the_ends(tab: Page) -> None:
    choose(tab, kind="all queries", order=ROUTE)
    back, on = tab.locator("#previous-page"), tab.locator("#next-page")
    expect(back).to_have_attribute("aria-disabled", "true")
    expect(on).to_have_attribute("aria-disabled", "false")
    for _ in range(4):
        on.click()
    assert (listed(tab), current(tab)) == ([*range(40, 50)], 40)
    expect(tab.locator("#page-number")).to_have_text("Page 5 of 5")
    expect(on).to_have_attribute("aria-disabled", "true")
    on.dispatch_event("click")
    assert current(tab) == 40
    back.click()
    assert listed(tab) == [*range(30, 40)]


def test_turning_pages_by_the_keyboard_keeps_the_focus_at_the_ends(tab: Page) -> None:
    choose(tab, kind="all queries", order=ROUTE)
    for name, query in [("next-page", 40), ("previous-page", 0)]:
        tab.locator(f"#{name}").focus()
        for _ in range(5):
            tab.keyboard.press("Enter")
        assert (focused(tab), current(tab)) == (name, query)


def test_an_empty_selection_says_what_to_do(tab: Page) -> None:
    choose(tab, method_a="VPRTempo, seed 0", kind="A tied")
    expect(tab.locator("#status")).to_contain_text("No query is left")
    expect(tab.locator("#along")).to_be_disabled()
    tab.locator("#lanes svg").first.click()
    assert listed(tab) == []


def test_of_thousands_of_queries_ten_are_in_the_page_at_a_time(reader: Reader) -> None:
    scores = np.eye(2700, 30, dtype=np.float32)
    run = answered(scores, [[query % 30] for query in range(2700)], scores=None)
    tab = reader.read(page("", [], [Section("Railway", (Series("SAD", False, (run,)),), None)]))
    choose(tab, kind="all queries")
    expect(tab.locator("#queries > li")).to_have_count(10)
    expect(tab.locator("#page-number")).to_have_text("Page 1 of 270")
