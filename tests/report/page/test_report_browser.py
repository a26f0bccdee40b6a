"""The report in a browser: it shows the right frames, filters, sorts, and works from the keyboard and on a phone."""

import os
import re
import shutil
from dataclasses import replace

import made_table
import numpy as np
import pytest
import report_page as made
from little import answered
from playwright.sync_api import expect, sync_playwright
from report_page import SAD_WRONG, journey_run, journey_section, made_up_page, place_colour, query_colour

from vprbench.report.page.page import Picture, Section, render_page
from vprbench.report.selection import MethodRuns
from vprbench.report.table import formats

PATIENCE = 30_000  # milliseconds, where nothing is slow but the machine may be


class Reader:
    """Someone who opens pages and writes down what goes wrong meanwhile."""

    def __init__(self, browser, folder):
        self.browser, self.folder = browser, folder
        self.contexts, self.complaints, self.requests = [], [], []

    def read(self, text, **options):
        file = self.folder / f"report-{len(self.contexts)}.html"
        file.write_text(text, encoding="utf-8")
        self.contexts.append(self.browser.new_context(**{"viewport": {"width": 1280, "height": 900}, **options}))
        self.contexts[-1].set_default_timeout(PATIENCE)
        tab = self.contexts[-1].new_page()
        tab.on("console", lambda message: self.complaints.append(message.text))
        tab.on("pageerror", lambda error: self.complaints.append(str(error)))
        tab.on("request", lambda request: self.requests.append(request.url))
        tab.goto(file.as_uri())
        return tab


def choose(tab, *, dataset="", **labels):
    if dataset:
        tab.get_by_role("tab", name=dataset, exact=True).click()
    for name, label in labels.items():
        options = tab.locator(f"#{name.replace('_', '-')} option").all_text_contents()
        (chosen,) = [option for option in options if option == label or option.startswith(f"{label} (")]
        tab.locator(f"#{name.replace('_', '-')}").select_option(label=chosen)


def listed(tab):
    """The queries in the list, in its order."""
    return [int(text) for text in tab.locator("#queries > li").evaluate_all("all => all.map(e => e.dataset.query)")]


def current(tab):
    return int(tab.locator("#queries > .current").get_attribute("data-query") or "-1")


def focused(tab):
    return str(tab.evaluate("document.activeElement.id"))


def colours(row):
    """The colour in the middle of each frame of a row, decoded by the browser."""
    decode = """async (images) => Promise.all(images.map(async (image) => {
        await image.decode();
        const canvas = document.createElement("canvas");
        [canvas.width, canvas.height] = [image.naturalWidth, image.naturalHeight];
        const context = canvas.getContext("2d");
        context.drawImage(image, 0, 0);
        return [...context.getImageData(canvas.width >> 1, canvas.height >> 1, 1, 1).data].slice(0, 3);
    }))"""
    return [tuple(colour) for colour in row.locator("img").evaluate_all(decode)]


MINUS = "\N{MINUS SIGN}"
ROUTE, HIGHEST = "along the route", "by margin, highest first"
MISSING = "missing: the weights gcl.pth are missing"
TEMPO = "VPRTempo, seed 0"
FIRST = "1 to 5 of 5: A wrong, ties included"  # what is told of the queries that a page opens with

pytestmark = pytest.mark.extended
ARGUMENTS = ("headless", "no-sandbox", "disable-gpu", "disable-quic", "no-first-run", "disable-background-networking")
ARGUMENTS += ("disable-component-update", "disable-sync")


@pytest.fixture(scope="module")
def browser():
    chromium = shutil.which("chromium")
    if chromium is None:
        leave = pytest.fail if os.environ.get("VPRBENCH_INSIST_ON_CHROMIUM") else pytest.skip
        leave("there is no chromium on this machine: its package brings it")
    expect.set_options(timeout=PATIENCE)
    with sync_playwright() as playwright:
        options = {"args": [f"--{name}" for name in ARGUMENTS], "timeout": 4 * PATIENCE}
        browser = playwright.chromium.launch(executable_path=chromium, **options)
        yield browser
        browser.close()


@pytest.fixture
def reader(browser, tmp_path):
    reader = Reader(browser, tmp_path)
    yield reader
    for context in reader.contexts:
        context.close()
    assert reader.complaints == []


@pytest.fixture
def tab(reader):
    return reader.read(made_up_page())


def one(run, title="Journey"):
    return Section(title, (MethodRuns("SAD", (run,)),), None)


def row(tab, query):
    return tab.locator("#queries > li").nth(listed(tab).index(query))


def test_the_page_asks_for_nothing_else_and_opens_with_the_surest_errors_of_the_first_method(reader):
    tab = reader.read(made_up_page())
    expect(tab.locator("#queries > li")).to_have_count(len(SAD_WRONG))
    assert [url for url in reader.requests if not url.startswith("data:")] == [tab.url.partition("#")[0]]
    assert listed(tab) == sorted(SAD_WRONG, key=lambda query: -SAD_WRONG[query])
    expect(tab.locator("#status")).to_have_text(FIRST)
    tied = row(tab, 20)
    expect(tied).to_contain_text("tied Query 20")
    expect(tied).to_contain_text("shares ranks 1 to 2 of 60")
    assert colours(tied)[1:] == [place_colour(made.mistaken_place(20)), place_colour(made.right_place(20))]
    for order, queries in ((HIGHEST, [20, 30, 10, 3, 11]), (ROUTE, [3, 10, 11, 20, 30])):
        choose(tab, order=order)
        assert listed(tab) == queries
    choose(tab, method_a="VPRTempo, seed 1")
    assert listed(tab) == [10]


def test_a_known_failure_shows_its_query_the_retrieved_and_the_right_frame(tab):
    failure = row(tab, 10)
    assert colours(failure) == [
        query_colour(10),
        place_colour(made.mistaken_place(10)),
        place_colour(made.right_place(10)),
    ]
    told = ["Query\ndusk/00010.png", "Retrieved\nnoon/00022.png\nplace 22\nscore 0.625"]
    assert failure.locator("figcaption").all_inner_texts() == [*told, "True\nnoon/00015.png\nplace 15\nscore 0.5"]
    for text in ("wrong Query 10", f"margin {MINUS}0.125", "ranks 2 of 60", "7 places off"):
        expect(failure).to_contain_text(text)
    alternatives = ["Query: dusk/00010.png", "Retrieved: noon/00022.png", "True: noon/00015.png"]
    assert failure.locator("img").evaluate_all("all => all.map(e => e.alt)") == alternatives
    choose(tab, kind="without a right place")
    unanswerable = tab.locator("#queries > li")
    expect(unanswerable).to_contain_text("no right place Query 49")
    assert colours(unanswerable) == [query_colour(49), place_colour(made.right_place(49))]
    expect(unanswerable.locator(".no-frame")).to_have_text("no right place")


def test_a_filter_keeps_its_queries_and_says_how_many(tab):
    choose(tab, order=ROUTE)
    right = [q for q in range(made.N_QUERIES) if q not in SAD_WRONG and q != made.UNANSWERABLE]
    kinds = {"A right": right, "A tied": [20], "without a right place": [49], "all queries": [*range(50)]}
    for kind, queries in kinds.items():
        choose(tab, kind=kind)
        assert listed(tab) == queries[:10]
        expect(tab.locator("#status")).to_have_text(f"1 to {min(10, len(queries))} of {len(queries)}: {kind}")
        expect(tab.locator("#kind option:checked")).to_have_text(f"{kind} ({len(queries)})")
    choose(tab, method_a=TEMPO, kind="A tied")
    expect(tab.locator("#status")).to_contain_text("No query is left")
    expect(tab.locator("#along")).to_be_disabled()
    tab.locator("#lanes svg").first.click()
    assert listed(tab) == []


def test_two_methods_show_the_queries_of_one_or_both_with_their_frames_scores_ranks_and_best_places(tab):
    expect(tab.locator("#kind option[value=a-not-b]")).to_be_disabled()
    choose(tab, method_b=TEMPO)
    button = row(tab, 11).locator("button")
    for expanded in ("true", "false"):
        button.click()
        expect(button).to_have_attribute("aria-expanded", expanded)
        more = row(tab, 11).locator(".more")
        expect(more).to_have_count(int(expanded == "true"))
        if expanded == "true":
            assert more.locator("h4").all_text_contents() == [f"Best places of {m}" for m in ("A, SAD", f"B, {TEMPO}")]
            roles = more.locator(".frames").first.locator(".role").all_text_contents()
            assert roles == ["1. wrong", "2. right", "3. wrong"]
            assert colours(more.locator(".frames").nth(1))[0] == place_colour(made.right_place(11))
    last = row(tab, 3).locator("figcaption").all_inner_texts()[-1]
    assert last == "True\nnoon/00008.png\nplace 8\nscore by A 0.5, by B 0.5"
    assert row(tab, 3).locator(".facts li").all_inner_texts() == [
        f"A wrong: margin {MINUS}0.25, the right place ranks 2 of 60, 7 places off",
        "B right: margin 0.375, the right place ranks 1 of 60",
    ]
    for kind, queries in (("A wrong, B right", [3, 11, 20, 30]), ("A and B wrong", [10]), ("A right, B wrong", [40])):
        choose(tab, kind=kind, order=ROUTE)
        assert listed(tab) == queries
    assert colours(row(tab, 40)) == [
        query_colour(40),
        place_colour(made.right_place(40)),
        place_colour(made.mistaken_place(40)),
        place_colour(made.right_place(40)),
    ]
    choose(tab, method_b="nothing")
    expect(tab.locator("#status")).to_have_text(FIRST)


def test_margins_that_are_infinite_missing_or_bounded_say_so_and_sort_to_their_ends(reader):
    no = -np.inf
    scores = [[0.5, 0.25, 0.125], [0.5, no, 0.25], [0.5, no, no], [0.5, 0.25, 0.0], [no, no, no], [0.5, 0.25, 0.0]]
    bounded = replace(answered([[0.875, 0.75, 0.5, 0.25]], [[3]], depth=2), scores=None)
    sections = [one(answered(scores, [[0], [1], [0], [1], [0], []])), one(bounded, "Bounded")]
    tab = reader.read(render_page("", [], sections))
    choose(tab, kind="all queries")
    assert listed(tab) == [1, 3, 0, 2, 4, 5]
    choose(tab, order=HIGHEST)
    assert listed(tab) == [2, 0, 3, 1, 4, 5]
    told = {2: "no wrong place is a candidate", 1: "the right place is no candidate", 4: "no place was retrieved"}
    for query, text in told.items():
        expect(row(tab, query)).to_contain_text(text)
    choose(tab, dataset="Bounded")
    for text in (f"margin at most {MINUS}0.125", "score at most 0.75"):
        expect(tab.locator("#queries > li")).to_contain_text(text)


def test_without_a_ground_truth_each_query_shows_its_best_five_places_by_score_and_margin_and_no_verdict(reader):
    scores = np.full((3, 8), 0.125, np.float32)
    for query, (first, second) in enumerate([(0.875, 0.75), (0.75, 0.25), (1.0, 0.625)]):
        scores[query, [query, query + 1]] = first, second
    of_a, of_b = (answered(table, [[]] * 3, protocol={"ground_truth": "none"}) for table in (scores, scores[:, ::-1]))
    both = Section("Journey", (MethodRuns("SAD", (of_a,)), MethodRuns("HOG", (of_b,))), None)
    tab = reader.read(render_page("<table></table>", [], [both]))
    orders = {"by margin, lowest first": [0, 2, 1], HIGHEST: [1, 2, 0], ROUTE: [0, 1, 2]}
    orders |= {"by score, lowest first": [1, 0, 2], "by score, highest first": [2, 0, 1]}
    for order, queries in orders.items():
        choose(tab, order=order)
        assert listed(tab) == queries
    second = row(tab, 1)
    expect(second).to_contain_text("best score 0.75")
    expect(second).to_contain_text("margin 0.5 to the second")
    assert second.locator(".role").all_inner_texts() == ["Query", "1.", "2.", "3.", "4.", "5."]
    choose(tab, method_b="HOG")
    assert row(tab, 1).locator(".more .no-frame").first.inner_text() == "place 6"
    assert tab.locator("#kind option").count() == 1
    assert not re.search(r"wrong|failure|R@1|recall|tied|hits", tab.locator("body").inner_text(), re.IGNORECASE)
    tab.locator("#queries").press("End")


def test_the_strip_shows_hits_and_misses_and_leads_to_the_nearest_query_that_is_shown(tab):
    choose(tab, method_b=TEMPO)
    lanes = tab.locator("#lanes .lane")
    tempo = {*made.TEMPO_WRONG}
    bars = [(0, "wrong", {*SAD_WRONG} - {20}), (1, "wrong", tempo), (0, "tied", {20}), (2, "shown", {*SAD_WRONG})]
    for lane, kind, queries in bars:
        path = lanes.nth(lane).locator(f".bars.{kind}").get_attribute("d") or ""
        runs = [(int(first), int(length)) for first, length in re.findall(r"M(\d+) 100h(\d+)v", path)]
        assert {query for first, length in runs for query in range(first, first + length)} == queries
    expect(lanes.nth(0)).to_contain_text("A, SAD: 44 right, 4 wrong, 1 tied, 1 no right place")
    strip = tab.locator("#lanes svg").first
    box = strip.bounding_box()
    strip.click(position={"x": box["width"] * 32.5 / made.N_QUERIES, "y": box["height"] / 2})
    assert (current(tab), focused(tab)) == (30, "query-30")


def test_arrow_keys_walk_the_list_over_the_ends_of_its_pages_which_buttons_turn(tab):
    choose(tab, kind="all queries", order=ROUTE)
    tab.locator("#query-0").focus()
    for key, query in [("ArrowDown", 1), ("ArrowRight", 2), ("ArrowUp", 1), ("End", 49), ("Home", 0), ("ArrowUp", 0)]:
        tab.keyboard.press(key)
        assert (current(tab), focused(tab)) == (query, f"query-{query}")
    for _ in range(10):
        tab.keyboard.press("ArrowDown")
    assert (focused(tab), listed(tab)) == ("query-10", [*range(10, 20)])
    tab.keyboard.press("ArrowLeft")
    assert listed(tab) == [*range(10)]
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
    for name, query in [("next-page", 40), ("previous-page", 0)]:  # the focus stays at the ends
        tab.locator(f"#{name}").focus()
        for _ in range(5):
            tab.keyboard.press("Enter")
        assert (focused(tab), current(tab)) == (name, query)


@pytest.fixture(scope="module")
def text():
    """A report of two datasets, with a real table and two figures."""
    other = one(journey_run(dict.fromkeys(range(30), 0.25)), "Other")
    pictures = [Picture(name, "What is drawn.", made.FIGURE) for name in ("speed", "recall")]
    sections = [journey_section(thumbnails=made.journey_thumbnails()), other]
    return render_page(formats.to_html(made_table.table()), pictures, sections)


@pytest.fixture
def report(text, reader):
    """The report on a phone, which never scrolls sideways."""
    tab = reader.read(text, viewport={"width": 360, "height": 740})
    yield tab
    assert tab.evaluate("Math.max(document.documentElement.scrollWidth, document.body.scrollWidth)") <= 360


def test_tabs_are_walked_by_arrow_keys_over_their_ends_and_change_findings_and_failures(report):
    heads = report.locator("h2").all_text_contents()
    assert heads[:4] == ["Findings", "Failures, query by query", "Table", "Figures"]
    found = report.locator("#findings p:visible")
    assert 2 <= found.count() <= 3
    expect(found.first).to_contain_text("VPRTempo")
    tabs = report.get_by_role("tablist", name="Datasets").get_by_role("tab")
    tabs.first.focus()
    for key, chosen in [("ArrowRight", 1), ("ArrowRight", 0), ("ArrowLeft", 1), ("Home", 0), ("End", 1)]:
        report.keyboard.press(key)
        assert focused(report) == f"dataset-{chosen}"
        selected = tabs.evaluate_all("all => all.map(e => [e.ariaSelected, e.tabIndex])")
        assert selected == [["true", 0] if i == chosen else ["false", -1] for i in range(2)]
        expect(report.get_by_role("tabpanel")).to_have_accessible_name(["Journey", "Other"][chosen])
        assert len(listed(report)) == [len(SAD_WRONG), 10][chosen]
    expect(found).to_have_count(1)
    expect(found).to_contain_text("SAD")


def test_a_copied_link_shows_what_was_seen_and_one_to_what_is_not_there_what_is(report):
    assert "#" not in report.url
    start = report.url
    choose(report, dataset="Other", order=ROUTE)
    choose(report, kind="A right")
    report.locator("#next-page").click()
    report.locator("#queries button").nth(4).click()
    seen = current(report), listed(report)
    expect(report).to_have_url(re.compile(f"query={seen[0]}"))
    other = report.context.new_page()
    other.goto(report.url)
    assert (current(other), listed(other)) == seen
    expect(other.locator("#query-44")).to_be_in_viewport()
    expect(other.locator("#kind option:checked")).to_contain_text("A right")
    choose(other, dataset="Journey", method_b=TEMPO, kind="A wrong, B right")
    expect(other).to_have_url(re.compile("b=VPRTempo"))
    report.goto(other.url)
    assert listed(report) == listed(other) == [3, 11, 20, 30]
    report.goto("about:blank")
    report.goto(f"{start}#dataset=No&a=No&b=No&show=a-not-b&sort=No&query=No")
    expect(report.locator("#status")).to_have_text(FIRST)


def names(tab):
    """The rows that are seen, in their order."""
    return [text.removesuffix(" spiking") for text in tab.locator("#table tbody tr:visible th").all_text_contents()]


def test_the_table_is_sorted_by_any_column_and_back_and_filtered_by_a_word_and_a_mark_has_its_footnote_as_title(report):
    mark = re.compile(f"^{1 + made_table.table().notes.index(MISSING)}$")
    assert MISSING in report.locator("#table sup a", has_text=mark).first.get_attribute("title")
    before = names(report)
    heads = report.locator("#table th[aria-sort]")
    for order, first in (("descending", ["VPRTempo", "SAD"]), ("ascending", ["SAD", "VPRTempo"]), ("none", before)):
        heads.nth(1).get_by_role("button").press("Enter")
        expect(heads.nth(1)).to_have_attribute("aria-sort", order)
        assert names(report)[: len(first)] == first
    assert sorted(names(report)) == sorted(before)
    heads.nth(3).get_by_role("button").click()
    assert names(report)[:2] == ["VPRTempo", "SAD"]
    heads.first.get_by_role("button").click()
    assert names(report) == sorted(before)
    word = report.get_by_label("Rows with the word")
    for text, left in (("vpr", ["VPRSNN", "VPRTempo"]), ("spiking", ["VPRSNN", "VPRTempo"]), ("gcl ", ["GCL"])):
        word.fill(text)
        assert names(report) == left
        expect(report.locator("#rows")).to_have_text(f"{len(left)} of {len(before)} rows")
    word.fill("")
    assert names(report) == sorted(before)
