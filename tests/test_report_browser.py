"""The report in a real browser: it shows the right frames, filters, sorts, and works from the keyboard."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Browser, Page, expect, sync_playwright
from report_page import (
    N_QUERIES,
    SAD_WRONG,
    TABLE,
    TEMPO_WRONG,
    UNANSWERABLE,
    answered,
    hostile_section,
    journey_run,
    journey_section,
    journey_thumbnails,
    made_up_page,
    mistaken_place,
    place_colour,
    query_colour,
    right_place,
)
from report_reader import PATIENCE, Reader, choose, colours, contrasts, current, focused, listed, queries_of, widest

from vprbench.report.page import Section, page
from vprbench.series import Series

MINUS = "\N{MINUS SIGN}"
ARGUMENTS = (
    "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking "
    "--disable-component-update --disable-sync"
)
ORDERS = {"route": "along the route", "lowest": "by margin, lowest first", "highest": "by margin, highest first"}


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    chromium = shutil.which("chromium")
    if chromium is None:
        reason = "there is no chromium on this machine: its package brings it"
        if os.environ.get("VPRBENCH_INSIST_ON_CHROMIUM"):
            pytest.fail(reason)
        pytest.skip(reason)
    expect.set_options(timeout=PATIENCE)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=ARGUMENTS.split(), timeout=4 * PATIENCE)
        yield browser
        browser.close()


@pytest.fixture
def reader(browser: Browser, tmp_path: Path) -> Iterator[Reader]:
    reader = Reader(browser, tmp_path)
    yield reader
    for context in reader.contexts:
        context.close()
    assert reader.complaints == []


@pytest.fixture
def tab(reader: Reader) -> Page:
    return reader.read(made_up_page())


def test_the_page_loads_without_a_complaint_and_asks_for_nothing_else(reader: Reader) -> None:
    tab = reader.read(made_up_page())
    expect(tab.locator("#queries > li")).to_have_count(len(SAD_WRONG))
    assert [url for url in reader.requests if not url.startswith("data:")] == [tab.url]
    assert tab.url.startswith("file://")


def test_it_opens_with_the_failures_of_the_first_method_the_surest_error_first(tab: Page) -> None:
    assert listed(tab) == sorted(SAD_WRONG, key=lambda query: -SAD_WRONG[query])
    expect(tab.locator("#status")).to_have_text("1 to 5 of 5: A wrong, ties included")


def test_a_known_failure_shows_its_query_the_retrieved_and_the_right_frame(tab: Page) -> None:
    row = tab.locator("#queries > li").nth(listed(tab).index(10))
    assert colours(row) == [query_colour(10), place_colour(mistaken_place(10)), place_colour(right_place(10))]
    assert row.locator("figcaption").all_inner_texts() == [
        "Query\ndusk/00010.png",
        "Retrieved\nnoon/00022.png\nplace 22\nscore 0.625",
        "True\nnoon/00015.png\nplace 15\nscore 0.5",
    ]
    expect(row).to_contain_text("wrong Query 10")
    expect(row).to_contain_text(f"margin {MINUS}0.125")
    expect(row).to_contain_text("ranks 2 of 60")
    expect(row).to_contain_text("7 places off")
    assert row.locator("img").evaluate_all("all => all.map(e => e.alt)") == [
        "Query: dusk/00010.png",
        "Retrieved: noon/00022.png",
        "True: noon/00015.png",
    ]


def test_another_method_has_failures_of_its_own(tab: Page) -> None:
    choose(tab, method_a="VPRTempo, seed 0")
    assert listed(tab) == [40, 10]
    choose(tab, method_a="VPRTempo, seed 1")
    assert listed(tab) == [10]


@pytest.mark.parametrize(
    ("kind", "queries"),
    [
        ("A right", [q for q in range(N_QUERIES) if q not in SAD_WRONG and q != UNANSWERABLE]),
        ("A tied", [20]),
        ("without a right place", [UNANSWERABLE]),
        ("all queries", [*range(N_QUERIES)]),
    ],
)
def test_a_filter_keeps_its_queries_and_says_how_many(tab: Page, kind: str, queries: list[int]) -> None:
    choose(tab, kind=kind, order=ORDERS["route"])
    assert listed(tab) == queries[:20]
    expect(tab.locator("#status")).to_have_text(f"1 to {min(20, len(queries))} of {len(queries)}: {kind}")
    expect(tab.locator("#kind option:checked")).to_have_text(f"{kind} ({len(queries)})")


def test_a_right_b_wrong_shows_exactly_those_queries_with_the_frames_of_both(tab: Page) -> None:
    choose(tab, method_b="VPRTempo, seed 0", kind="A right, B wrong")
    assert listed(tab) == sorted(set(TEMPO_WRONG) - set(SAD_WRONG)) == [40]
    row = tab.locator("#queries > li")
    assert colours(row) == [
        query_colour(40),
        place_colour(right_place(40)),
        place_colour(mistaken_place(40)),
        place_colour(right_place(40)),
    ]
    choose(tab, kind="A wrong, B right", order=ORDERS["route"])
    assert listed(tab) == [3, 11, 20, 30]
    choose(tab, kind="A and B wrong")
    assert listed(tab) == [10]


def test_comparing_needs_a_second_method(tab: Page) -> None:
    expect(tab.locator("#kind option[value=a-not-b]")).to_be_disabled()
    choose(tab, method_b="VPRTempo, seed 0", kind="A right, B wrong")
    choose(tab, method_b="nothing")
    expect(tab.locator("#status")).to_have_text("1 to 5 of 5: A wrong, ties included")


def test_sorting_by_margin_and_along_the_route(tab: Page) -> None:
    choose(tab, order=ORDERS["highest"])
    assert listed(tab) == [20, 30, 10, 3, 11]
    choose(tab, order=ORDERS["route"])
    assert listed(tab) == [3, 10, 11, 20, 30]


def test_margins_that_are_infinite_or_missing_sort_to_their_ends(reader: Reader) -> None:
    no = -np.inf
    scores = [[0.5, 0.25, 0.125], [0.5, no, 0.25], [0.5, no, no], [0.5, 0.25, 0.0], [no, no, no], [0.5, 0.25, 0.0]]
    run = answered(scores, [[0], [1], [0], [1], [0], []])
    tab = reader.read(page("", [], [Section("Journey", (Series("SAD", False, (run,)),), None)]))
    choose(tab, kind="all queries")
    assert listed(tab) == [1, 3, 0, 2, 4, 5]
    choose(tab, order=ORDERS["highest"])
    assert listed(tab) == [2, 0, 3, 1, 4, 5]
    rows = tab.locator("#queries > li")
    expect(rows.nth(0)).to_contain_text("no wrong place is a candidate")
    expect(rows.nth(3)).to_contain_text("the right place is no candidate")
    expect(rows.nth(4)).to_contain_text("no place was retrieved")


def test_a_tie_is_called_one_and_shows_the_wrong_place_that_shares_the_score(tab: Page) -> None:
    row = tab.locator("#queries > li").nth(listed(tab).index(20))
    expect(row).to_contain_text("tied Query 20")
    expect(row).to_contain_text("shares ranks 1 to 2 of 60")
    assert colours(row)[1:] == [place_colour(mistaken_place(20)), place_colour(right_place(20))]


def test_a_query_without_a_right_place_shows_none(tab: Page) -> None:
    choose(tab, kind="without a right place")
    row = tab.locator("#queries > li")
    expect(row).to_contain_text("no right place Query 49")
    assert colours(row) == [query_colour(49), place_colour(right_place(49))]
    expect(row.locator(".no-frame")).to_have_text("no right place")


def test_a_margin_that_is_only_bounded_says_so(reader: Reader) -> None:
    run = replace(answered([[0.875, 0.75, 0.5, 0.25]], [[3]], depth=2), scores=None)
    tab = reader.read(page("", [], [Section("Journey", (Series("SAD", False, (run,)),), None)]))
    expect(tab.locator("#queries > li")).to_contain_text(f"margin at most {MINUS}0.125")
    expect(tab.locator("#queries > li")).to_contain_text("score at most 0.75")


def test_without_frames_their_names_stand_in_their_places(reader: Reader) -> None:
    tab = reader.read(made_up_page([journey_section()]))
    expect(tab.locator("#frames-missing")).to_contain_text("The frames of this dataset are not stored")
    row = tab.locator("#queries > li").nth(listed(tab).index(10))
    assert row.locator(".no-frame").all_text_contents() == ["query 10", "place 22", "place 15"]


def test_several_datasets_are_chosen_between_and_their_frames_kept_apart(reader: Reader) -> None:
    swapped = journey_thumbnails(queries=tuple(reversed(journey_thumbnails().queries)))
    other = Section("Other", (Series("GCL", False, (journey_run({4: 0.25}),)),), swapped)
    tab = reader.read(made_up_page([journey_section(thumbnails=journey_thumbnails()), other]))
    choose(tab, dataset="Other")
    assert listed(tab) == [4]
    assert colours(tab.locator("#queries > li"))[0] == query_colour(N_QUERIES - 1 - 4)
    choose(tab, dataset="Journey")
    assert colours(tab.locator("#queries > li").first)[0] == query_colour(11)


def test_opening_a_query_shows_its_best_three_places(tab: Page) -> None:
    choose(tab, method_b="VPRTempo, seed 0")
    row = tab.locator("#queries > li").first
    button = row.locator("button")
    expect(button).to_have_attribute("aria-expanded", "false")
    button.click()
    expect(button).to_have_attribute("aria-expanded", "true")
    assert row.locator(".more h4").all_text_contents() == [
        "Best places of A, SAD",
        "Best places of B, VPRTempo, seed 0",
    ]
    roles = row.locator(".more .frames").first.locator(".role").all_text_contents()
    assert roles == ["1. wrong", "2. right", "3. wrong"]
    assert colours(row.locator(".more .frames").nth(1))[0] == place_colour(right_place(11))
    button.click()
    expect(row.locator(".more")).to_have_count(0)


# The strip along the route


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
    slider.press("ArrowRight")
    assert current(tab) == 20
    slider.press("ArrowLeft")
    slider.press("ArrowLeft")
    assert current(tab) == 10
    slider.press("ArrowRight")
    assert current(tab) == 11
    slider.press("ArrowLeft")
    expect(slider).to_have_attribute("aria-valuetext", "query 10: wrong")


# Keyboard and paging


def test_tab_goes_from_the_controls_over_the_slider_to_one_query_and_on(tab: Page) -> None:
    tab.locator("#method-a").focus()
    visited = []
    for _ in range(6):
        visited.append(focused(tab))
        tab.keyboard.press("Tab")
    assert visited == ["method-a", "method-b", "kind", "order", "along", "query-11"]
    assert not focused(tab).startswith("query-")


def test_arrow_keys_walk_the_list_over_the_ends_of_its_pages(tab: Page) -> None:
    choose(tab, kind="all queries", order=ORDERS["route"])
    tab.locator("#query-0").focus()
    for key, query in [("ArrowDown", 1), ("ArrowRight", 2), ("ArrowUp", 1), ("End", 49), ("Home", 0), ("ArrowUp", 0)]:
        tab.keyboard.press(key)
        assert (current(tab), focused(tab)) == (query, f"query-{query}")
    for _ in range(20):
        tab.keyboard.press("ArrowDown")
    assert focused(tab) == "query-20"
    assert listed(tab) == [*range(20, 40)]
    tab.keyboard.press("ArrowLeft")
    assert listed(tab) == [*range(20)]


def test_enter_opens_and_closes_the_query_in_focus(tab: Page) -> None:
    tab.locator("#query-11").focus()
    tab.keyboard.press("ArrowDown")
    tab.keyboard.press("Enter")
    expect(tab.locator("#query-3")).to_have_attribute("aria-expanded", "true")
    tab.keyboard.press("Enter")
    expect(tab.locator("#query-3")).to_have_attribute("aria-expanded", "false")


def test_what_has_the_focus_is_outlined(tab: Page) -> None:
    tab.locator("#order").focus()
    for _ in range(2):
        tab.keyboard.press("Tab")
        outline = tab.evaluate("getComputedStyle(document.activeElement).outline")
        assert "solid" in outline
        assert "3px" in outline


def test_pages_turn_by_their_buttons(tab: Page) -> None:
    choose(tab, kind="all queries", order=ORDERS["route"])
    expect(tab.locator("#previous-page")).to_be_disabled()
    tab.locator("#next-page").click()
    tab.locator("#next-page").click()
    assert listed(tab) == [*range(40, 50)]
    expect(tab.locator("#page-number")).to_have_text("Page 3 of 3")
    expect(tab.locator("#next-page")).to_be_disabled()
    tab.locator("#previous-page").click()
    assert listed(tab) == [*range(20, 40)]


def test_an_empty_selection_says_what_to_do(tab: Page) -> None:
    choose(tab, method_a="VPRTempo, seed 0", kind="A tied")
    expect(tab.locator("#status")).to_contain_text("No query is left")
    expect(tab.locator("#along")).to_be_disabled()
    tab.locator("#lanes svg").first.click()
    assert listed(tab) == []


def test_of_thousands_of_queries_twenty_are_in_the_page_at_a_time(reader: Reader) -> None:
    scores = np.eye(2700, 30, dtype=np.float32)
    run = answered(scores, [[query % 30] for query in range(2700)], scores=None)
    tab = reader.read(page("", [], [Section("Railway", (Series("SAD", False, (run,)),), None)]))
    choose(tab, kind="all queries")
    expect(tab.locator("#queries > li")).to_have_count(20)
    expect(tab.locator("#page-number")).to_have_text("Page 1 of 135")


# Looks

WIDE = "unbroken" * 40


def test_a_phone_of_360_pixels_never_scrolls_sideways(reader: Reader) -> None:
    table = TABLE.replace("<td>none</td>", "<td>none</td>" * 20).replace("Measured here", WIDE)
    names = journey_thumbnails(query_names=(WIDE,) * N_QUERIES)
    given = replace(
        journey_section(WIDE, names), series=(*journey_section().series, Series(WIDE, False, (journey_run({}),)))
    )
    tab = reader.read(page(table, [], [given, journey_section("Other")], WIDE), viewport={"width": 360, "height": 740})
    assert widest(tab) <= 360
    tab.locator("#queries button").first.click()
    assert widest(tab) <= 360
    choose(tab, method_b=WIDE, kind="all queries")
    assert widest(tab) <= 360
    choose(tab, dataset="Other")
    assert widest(tab) <= 360


@pytest.mark.parametrize("look", ["light", "dark", "print"])
def test_every_text_stands_out_from_its_ground(reader: Reader, look: str) -> None:
    tab = reader.read(made_up_page([journey_section()]), color_scheme="light" if look == "light" else "dark")
    choose(tab, method_b="VPRTempo, seed 0", kind="all queries", order=ORDERS["route"])
    tab.locator("#query-3").click()
    if look == "print":
        tab.emulate_media(media="print")
    found = contrasts(tab)
    assert len(found) > 100
    assert {text: ratio for text, ratio in found.items() if ratio < 4.5} == {}


def test_dark_is_dark_and_print_is_light(reader: Reader) -> None:
    tab = reader.read(made_up_page(), color_scheme="dark")
    ground = "getComputedStyle(document.body).backgroundColor"
    assert max(map(int, re.findall(r"\d+", tab.evaluate(ground)))) < 64
    tab.emulate_media(media="print")
    assert tab.evaluate(ground) == "rgb(255, 255, 255)"
    expect(tab.locator("#controls")).to_be_hidden()
    expect(tab.locator("#queries > li").first).to_be_visible()


# Trust


def test_hostile_names_stay_text(reader: Reader) -> None:
    tab = reader.read(made_up_page([hostile_section()]))
    expect(tab.locator("#queries > li")).to_have_count(len(SAD_WRONG))
    tab.locator("#query-11").click()
    expect(tab.locator("#query-11")).to_have_attribute("aria-expanded", "true")
    assert tab.title() == "Visual place recognition, measured"
    assert tab.locator("img:not([src^='data:'])").count() == 0
    assert [url for url in reader.requests if not url.startswith("data:")] == [tab.url]


def test_without_javascript_everything_else_is_there_and_the_page_says_what_is_not(reader: Reader) -> None:
    tab = reader.read(made_up_page(), java_script_enabled=False)
    expect(tab.locator("noscript p")).to_be_visible()
    expect(tab.locator("noscript p")).to_contain_text("frames of single queries, their filters and the strip")
    expect(tab.locator("#browsing")).to_be_hidden()
    expect(tab.locator("#table table")).to_be_visible()
    expect(tab.locator("#figures img")).to_be_visible()
    expect(tab.locator("#protocol")).to_contain_text("60 places")
