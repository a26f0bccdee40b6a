"""The report in a real browser: it shows the right frames, filters, sorts, and works from the keyboard."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from playwright.sync_api import Page, expect
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
from report_reader import Reader, choose, colours, contrasts, listed, widest

from vprbench.paper.page.page import Section, page
from vprbench.paper.selection import Series

MINUS = "\N{MINUS SIGN}"
ORDERS = {"route": "along the route", "lowest": "by margin, lowest first", "highest": "by margin, highest first"}

pytest_plugins = ["report_browser"]


def test_the_page_loads_without_a_complaint_and_asks_for_nothing_else(reader: Reader) -> None:
    tab = reader.read(made_up_page())
    expect(tab.locator("#queries > li")).to_have_count(len(SAD_WRONG))
    assert [url for url in reader.requests if not url.startswith("data:")] == [tab.url.partition("#")[0]]
    assert tab.url.startswith("file://")


def test_it_opens_with_the_failures_of_the_first_method_the_surest_error_first(tab: Page) -> None:
    assert listed(tab) == sorted(SAD_WRONG, key=lambda query: -SAD_WRONG[query])
    expect(tab.locator("#status")).to_have_text("1 to 5 of 5: A wrong, ties included")
    tied = tab.locator("#queries > li").nth(listed(tab).index(20))
    expect(tied).to_contain_text("tied Query 20")
    expect(tied).to_contain_text("shares ranks 1 to 2 of 60")
    assert colours(tied)[1:] == [place_colour(mistaken_place(20)), place_colour(right_place(20))]
    for order, queries in (("highest", [20, 30, 10, 3, 11]), ("route", [3, 10, 11, 20, 30])):
        choose(tab, order=ORDERS[order])
        assert listed(tab) == queries
    choose(tab, method_a="VPRTempo, seed 1")
    assert listed(tab) == [10]


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
    assert listed(tab) == queries[:10]
    expect(tab.locator("#status")).to_have_text(f"1 to {min(10, len(queries))} of {len(queries)}: {kind}")
    expect(tab.locator("#kind option:checked")).to_have_text(f"{kind} ({len(queries)})")


def test_a_right_b_wrong_shows_exactly_those_queries_with_the_frames_of_both(tab: Page) -> None:
    expect(tab.locator("#kind option[value=a-not-b]")).to_be_disabled()
    choose(tab, method_b="VPRTempo, seed 0", kind="A right, B wrong")
    assert listed(tab) == sorted(set(TEMPO_WRONG) - set(SAD_WRONG)) == [40]
    right, mistaken = place_colour(right_place(40)), place_colour(mistaken_place(40))
    assert colours(tab.locator("#queries > li")) == [query_colour(40), right, mistaken, right]
    choose(tab, kind="A wrong, B right", order=ORDERS["route"])
    assert listed(tab) == [3, 11, 20, 30]
    choose(tab, kind="A and B wrong")
    assert listed(tab) == [10]
    choose(tab, kind="A right, B wrong")
    choose(tab, method_b="nothing")
    expect(tab.locator("#status")).to_have_text("1 to 5 of 5: A wrong, ties included")


def test_comparing_tells_the_score_and_the_rank_of_the_right_place_by_both(tab: Page) -> None:
    choose(tab, method_b="VPRTempo, seed 0")
    row = tab.locator("#queries > li").nth(listed(tab).index(3))
    assert row.locator("figcaption").all_inner_texts()[-1] == (
        "True\nnoon/00008.png\nplace 8\nscore by A 0.5, by B 0.5"
    )
    assert row.locator(".facts li").all_inner_texts() == [
        f"A wrong: margin {MINUS}0.25, the right place ranks 2 of 60, 7 places off",
        "B right: margin 0.375, the right place ranks 1 of 60",
    ]


def test_comparing_methods_that_prefer_different_right_places_names_that_of_the_score(reader: Reader) -> None:
    no = -np.inf
    a = answered([[0.75, 0.5, 0.25, 0.125], [0.5, no, no, 0.25]], [[1, 2], [2]])
    b = answered([[0.75, 0.25, 0.5, 0.125], [0.5, no, 0.25, 0.25]], [[1, 2], [2]])
    series = (Series("SAD", False, (a,)), Series("GCL", False, (b,)))
    tab = reader.read(page("", [], [Section("Journey", series, None)]))
    choose(tab, method_b="GCL", order=ORDERS["route"])
    rows = tab.locator("#queries > li")
    expect(rows.nth(0).locator("figcaption").last).to_contain_text("score by A 0.5, by B 0.5 for place 2")
    expect(rows.nth(1).locator("figcaption").last).to_contain_text("score by A none, by B 0.25")


def test_of_several_reference_images_of_a_place_the_page_says_which_is_shown(reader: Reader) -> None:
    run = journey_run(SAD_WRONG, n_references=120)
    several = Section("Twice", (Series("SAD", False, (run,)),), journey_thumbnails())
    once = Section("Once", (Series("SAD", False, (journey_run(SAD_WRONG, n_references=60),)),), journey_thumbnails())
    tab = reader.read(page("", [], [several, once]))
    expect(tab.locator("#first-references")).to_have_text(
        "The frame of a place is always its first reference image, of the traverse noon; "
        "the methods learnt its other reference images too."
    )
    choose(tab, dataset="Once")
    expect(tab.locator("#first-references")).to_be_hidden()


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
        expect(tab.locator("#controls")).to_be_hidden()
        expect(tab.locator("#queries > li").first).to_be_visible()
    ground = re.findall(r"\d+", tab.evaluate("getComputedStyle(document.body).backgroundColor"))
    assert max(map(int, ground)) < 64 if look == "dark" else min(map(int, ground)) > 200
    found = contrasts(tab)
    assert len(found) > 100
    assert {text: ratio for text, ratio in found.items() if ratio < 4.5} == {}


# Trust


def test_hostile_names_stay_text(reader: Reader) -> None:
    tab = reader.read(made_up_page([hostile_section()]))
    expect(tab.locator("#queries > li")).to_have_count(len(SAD_WRONG))
    tab.locator("#query-11").click()
    expect(tab.locator("#query-11")).to_have_attribute("aria-expanded", "true")
    assert tab.title() == "Visual place recognition, measured"
    assert tab.locator("img:not([src^='data:'])").count() == 0
    assert [url for url in reader.requests if not url.startswith("data:")] == [tab.url.partition("#")[0]]


def test_without_javascript_everything_else_is_there_and_the_page_says_what_is_not(reader: Reader) -> None:
    tab = reader.read(made_up_page(), java_script_enabled=False)
    expect(tab.locator("noscript p")).to_be_visible()
    expect(tab.locator("noscript p")).to_contain_text("frames of single queries, their filters and the strip")
    expect(tab.locator("#browsing")).to_be_hidden()
    expect(tab.locator("#table table")).to_be_visible()
    expect(tab.locator("#figures img")).to_be_visible()
    expect(tab.locator("#protocol")).to_contain_text("60 places")
