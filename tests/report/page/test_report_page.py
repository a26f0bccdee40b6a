"""The report's page as text: whole, self-contained, small enough, and safe whatever a name holds."""

import base64
import hashlib
import io
from dataclasses import replace

import pytest
import report_page as made
from little import a_run, answered
from parsed_page import Parsed
from PIL import Image
from report_page import SAD_WRONG, TABLE, journey_run, journey_section, made_up_page

from vprbench.report.page import page as report
from vprbench.report.page.page import Picture, Section
from vprbench.report.selection import MethodRuns
from vprbench.runs.notes import Note
from vprbench.runs.query_results import judge_answers

HOSTILE = "</script><img src=x onerror=\"document.title='broken'\">"


def contents(text):
    """Return what a page of one section holds of its runs, and its frames."""
    (told,) = Parsed(text).data("answers")
    return told, Parsed(text).data("frames-0")


def section(*runs, thumbnails=None, title="Journey"):
    """Return a section of one method with a run a seed."""
    return Section(title, (MethodRuns("SAD", runs),), thumbnails)


def test_the_page_holds_its_table_figures_and_sentences_and_allows_nothing_else():
    text = made_up_page()
    parsed = Parsed(text)
    assert TABLE in text
    (image,) = parsed.all("img")
    picture = base64.b64decode(image["src"].removeprefix("data:image/png;base64,"))
    assert Image.open(io.BytesIO(picture)).size == (1200, 500)
    sentences = "How long a query takes, on Abacus 9.", "Made from 3 stored runs.", report.TRAINING_TIME, report.METHOD
    assert [told for told in sentences if told not in parsed.text] == []
    without_runs = report.render_page(TABLE, [], [Section("Journey", (), None)])
    assert (TABLE in without_runs, "query by query" in without_runs) == (True, False)
    addresses = [a[name] for _, a in parsed.elements for name in ("src", "href", "action", "srcset") if name in a]
    assert len(addresses) > 5
    assert all(address.startswith(("#", "data:")) for address in addresses)
    assert not any(word in parsed.inside["style"][0] for word in ("url(", "@import"))
    ids = [attributes["id"] for _, attributes in parsed.elements if "id" in attributes]
    assert len(ids) == len(set(ids))
    assert {link["href"][1:] for link in parsed.all("a")} <= set(ids)
    (policy,) = [meta["content"] for meta in parsed.all("meta") if "http-equiv" in meta]
    rules = dict(rule.strip().split(" ", 1) for rule in policy.split(";"))
    running = [text for a, text in zip(parsed.all("script"), parsed.inside["script"], strict=True) if "type" not in a]
    for kind, texts in (("script", running), ("style", parsed.inside["style"])):
        (digest,) = [base64.b64encode(hashlib.sha256(text.encode()).digest()).decode() for text in texts]
        assert rules[f"{kind}-src"] == f"'sha256-{digest}'"
    assert (rules["default-src"], rules["img-src"]) == ("'none'", "data:")


def test_hostile_names_are_text_everywhere_and_those_that_are_no_text_are_written():
    protocol = {"query": HOSTILE, HOSTILE: HOSTILE}
    run = journey_run(SAD_WRONG, notes=(Note("dataset", HOSTILE),), dataset=HOSTILE, protocol=protocol)
    names = {"query_names": (HOSTILE,) * made.N_QUERIES, "reference_names": (HOSTILE,) * made.N_PLACES}
    spoilt = Section(HOSTILE, (MethodRuns(HOSTILE, (run,)),), made.journey_thumbnails(**names))
    drawn = [Picture(HOSTILE, HOSTILE, b"")]
    text = report.render_page("", drawn, [spoilt], title=HOSTILE, made_from=HOSTILE)
    harmless, parsed = Parsed(made_up_page()), Parsed(text)
    assert HOSTILE not in text
    assert len(parsed.all("script")) == len(harmless.all("script"))
    assert all(image["src"] == "data:image/png;base64," for image in parsed.all("img"))
    told, _ = contents(text)
    assert told["queryNames"][0] == told["title"] == told["runs"][0]["name"] == HOSTILE
    run = journey_run(SAD_WRONG, notes=(Note("dataset", "folder caf\udce9"),))
    text = report.render_page("", [], [section(run, title="caf\udce9")])
    assert "folder caf?" in text
    text.encode()


def test_a_section_of_two_datasets_is_refused():
    with pytest.raises(ValueError, match="Journey are of different images"):
        report.render_page("", [], [section(journey_run({}, 0), journey_run({}, 1, fingerprint="e" * 64))])


def test_a_frame_stands_in_the_page_once_if_a_query_shows_it_and_the_page_names_those_that_are_not_kept():
    text = made_up_page()
    frame = base64.b64encode(made.drawn_frame(made.place_colour(15))).decode()  # right for query 10
    assert text.count(frame) == 1
    assert contents(text)[1]["places"]["15"] == frame
    first_two = answered([[0.5, 0.25, 0.125, 0, 0, 0], [0.25, 0.5, 0.125, 0, 0, 0]], [[4], [1]])
    _, kept = contents(report.render_page("", [], [section(first_two, thumbnails=made.journey_thumbnails())]))
    assert ({*kept["places"]}, len(kept["queries"])) == ({"0", "1", "2", "4"}, 2)
    told, kept = contents(made_up_page([section(journey_run({}, n_references=120))]))
    assert told["framesMissing"].startswith("The frames of this dataset are not stored")
    assert (told["queryNames"], told["placeNames"]) == (None, None)
    assert kept == {"queries": [], "places": {}}
    whole = made.journey_thumbnails()
    queries = tuple(frame if query == 10 else b"" for query, frame in enumerate(whole.queries))
    places = tuple(frame if place == 15 else b"" for place, frame in enumerate(whole.references))
    fewer = journey_section(thumbnails=made.journey_thumbnails(queries=queries, references=places))
    told, kept = contents(made_up_page([fewer]))
    assert told["framesMissing"].startswith("2 of ")
    assert told["placeNames"]["22"] == "noon/00022.png"
    assert list(kept["places"]) == ["15"]
    assert [query for query, frame in enumerate(kept["queries"]) if frame] == [10]


def test_a_page_shows_so_many_frames_at_most_and_those_of_wrong_answers_first(monkeypatch):
    sections = [journey_section(title=title, thumbnails=made.journey_thumbnails()) for title in ("one", "other")]
    monkeypatch.setattr(report, "MOST_FRAMES", 24)
    parsed = Parsed(report.render_page("", [], sections))
    for number, told in enumerate(parsed.data("answers")):
        kept = parsed.data(f"frames-{number}")
        queries = {query for query, frame in enumerate(kept["queries"]) if frame}
        assert 6 < len(queries) + len(kept["places"]) <= 12
        assert all({run["verdicts"][query] for run in told["runs"]} != {"r"} for query in queries)
        assert told["framesMissing"].startswith(f"{len(queries) + len(kept['places'])} of ")


@pytest.mark.parametrize(
    ("wrong", "seeds", "sentence"),
    [
        ([SAD_WRONG, {10: 0.125, 40: 0.25}], 1, "Of 49 queries all 2 runs miss 1, some runs miss 5 more."),
        ([{}, {}], 1, "Of 49 queries all 2 runs miss 0, some runs miss 0 more."),
        ([SAD_WRONG, SAD_WRONG], 2, "Of 49 queries all 2 runs miss 5, some runs miss 0 more."),
        ([SAD_WRONG], 1, None),
    ],
)
def test_the_last_finding_counts_what_all_and_what_some_missed(wrong, seeds, sentence):
    """Query 20 is tied, and query 49 has no right place."""
    runs = [journey_run(one, seed) for seed, one in enumerate(wrong)]
    alone = [MethodRuns(f"method {number}", (run,)) for number, run in enumerate(runs)]
    each = [MethodRuns("VPRTempo", tuple(runs))] if seeds > 1 else alone
    found = report.list_findings(each, [judge_answers(run) for run in runs])
    assert len(found) <= 3
    assert (found[-1] == sentence) is (sentence is not None)


def test_the_page_lists_the_protocol_each_machine_once_with_versions_and_runs_and_the_notes_of_all_runs():
    def on(run, **changes):
        return replace(run, environment={**run.environment, **changes})

    first = on(a_run(), python="3.11.2", git={"commit": "0123456789abcdef0123", "changed": True})
    given = {"SAD": first, "GCL": first, "HOG": on(first, processor="Difference Engine", accelerator="Mill")}
    found = report.list_machines([MethodRuns(name, (run,)) for name, run in given.items()])
    versions = "commit 0123456789ab with changes, Python 3.11.2, torch 2.6.0"
    machines = "Abacus 9, 1 of 2 cores, torch 2.6.0", "Difference Engine, 1 of 2 cores, Mill, torch 2.6.0"
    runs = "SAD (journey), GCL (journey)", "HOG (journey)"
    assert found == [(machine, f"{versions}\n{of}") for machine, of in zip(machines, runs, strict=True)]
    run = journey_run({}, notes=(Note("dataset", "the clock was not locked"),))
    on_gpu = on(replace(run, config={**run.config, "device": "cuda"}), processor="Difference Engine")
    browsed = journey_section()
    seeds = (journey_run({}, 0, notes=(Note("answers", "other answers"),)), journey_run({}, 1))
    measured = [("Journey", MethodRuns("VPRTempo", runs)) for runs in ((on_gpu,), seeds)]
    text = Parsed(report.render_page(TABLE, [], [browsed], measured=[("Journey", browsed.series[0]), *measured])).text
    notes = "VPRTempo, on cuda", "the clock was not locked", "two carts passed", "VPRTempo, seed 0", "other answers"
    protocol = "journey: 50 queries, 60 places"
    assert [shown for shown in (machines[0], "Difference Engine", *notes, protocol) if shown not in text] == []
    assert "Difference Engine" not in Parsed(report.render_page(TABLE, [], [browsed])).text
