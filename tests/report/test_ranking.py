"""Rows in order, on clean frames and under corruptions: numbers, texts and figures say no more than their tests do."""

import csv
import re
from dataclasses import replace
from io import StringIO

import figure_runs
import numpy as np
import pytest
from figure_runs import series
from little import unanswerable_run
from stored_runs import run

from vprbench.errors import BadInput
from vprbench.report import robustness as text
from vprbench.report.figures.accuracy import draw_robustness
from vprbench.report.ranking import rank_rows
from vprbench.report.robustness import measure_robustness
from vprbench.runs.corruption import Corruption
from vprbench.runs.frame import iterate_rows

MANY = range(0, 60, 2)


def row(name, *wrong, seconds=None, **changes):
    """Return a row of 60 queries, wrong at some; it takes 12.5 ms a query unless told otherwise."""
    times = {} if seconds is None else {"encode_seconds": (seconds,) * 30, "match_seconds": (0.0,) * 30}
    return series(name, run(hits=[int(query not in wrong) for query in range(60)], **times, **changes))


def test_rows_come_best_first_with_the_numbers_of_all_their_seeds():
    (one,), (other,) = (row("sad", *wrong, **more).runs for wrong, more in (((0, 1, 2), {}), ((0,), {"seed": 1})))
    seeds = [one, replace(other, fit_seconds=20.0)]
    first, second = iterate_rows(rank_rows([row("hog", *MANY), series("sad", *seeds)]).table)
    assert (first.method, first.seeds, second.method) == ("sad", 2, "hog")
    assert first.recall_at_1 == pytest.approx((57 + 59) / 120)
    assert first.low < first.recall_at_1 < first.high
    assert (first.hz, first.fit_seconds) == (pytest.approx(80), pytest.approx((12.34 + 20) / 2))


def test_the_first_sentence_gives_the_difference_with_its_interval_and_whether_a_test_sees_it():
    sentence, fastest, _ = rank_rows([row("sad", *MANY, seconds=0.01), row("hog", seconds=0.1)]).sentences
    assert sentence.startswith("hog is best: 100.0 %, 50.0 points above sad [")
    low, high = map(float, re.findall(r"\[([\d.]+), ([\d.]+)\]", sentence)[0])
    assert 0 < low < 50 < high < 100
    assert fastest == "sad is fastest: 100 queries a second."

    sentence, seeds = rank_rows([row("hog"), row("sad", 7)]).sentences  # a difference that no test sees
    assert ("hog, sad" in seeds, "seeds=3" in seeds) == (True, True)
    assert re.search(r"1\.7 points above sad \[-[\d.]+, [\d.]+\]", sentence)
    assert "is best" not in sentence


def test_the_fastest_row_is_named_and_one_tuned_on_these_places_or_without_right_places_is_not_called_best():
    rows = [row("hog", seconds=0.04), row("pca", 1, seconds=0.02), row("sad", *MANY, seconds=0.005)]
    told = rank_rows(rows).sentences
    assert ("sad" in told[1], "200" in told[1]) == (True, True)
    tuned = row("tuned", tuned_on={"dataset": "railway", "places": "0-9"})
    ranking = rank_rows([row("hog", 7), row("sad", *MANY), tuned])
    assert ranking.table["method"][0] == "tuned"
    assert ranking.sentences[0].startswith("hog is best")
    assert "tuned" in ranking.sentences[-1]
    ranking = rank_rows([series("a", unanswerable_run()), series("b", unanswerable_run())])
    assert [*ranking.table["recall_at_1"]] == [None, None]
    assert len(ranking.sentences) == 1


WEAK, STRONG, BLUR = Corruption("shift", 1), Corruption("shift", 3), Corruption("blur", 2)


def sharing(name, *shares):
    """Return a row of 40 queries with a share of hits for each of its seeds."""
    return series(name, *(figure_runs.run(name, share, seed=seed) for seed, share in enumerate(shares)))


@pytest.fixture(scope="module")
def found():
    spoilt = {
        WEAK: [sharing("sad", 0.475), sharing("tempo", 0.7, 0.9)],
        STRONG: [sharing("sad", 0.1), sharing("tempo", 0.2, 0.3)],
        BLUR: [sharing("tempo", 0.8, 0.9), sharing("other", 0.3)],
    }
    return measure_robustness([sharing("sad", 0.5), sharing("tempo", 0.8, 0.9)], spoilt)


def test_a_drop_is_the_clean_mean_over_the_seeds_less_that_under_the_corruption(found):
    points = {(p.method, p.kind, p.strength): p for p in iterate_rows(found.points)}
    wanted = {
        ("sad", "clean", 0): (1, 0.5, 0),
        ("tempo", "clean", 0): (2, 0.85, 0),
        ("sad", "shift", 1): (1, 0.475, 0.025),
        ("tempo", "shift", 1): (2, 0.8, 0.05),
        ("sad", "shift", 3): (1, 0.1, 0.4),
        ("tempo", "shift", 3): (2, 0.25, 0.6),
        ("tempo", "blur", 2): (2, 0.85, 0),
    }
    assert {key: pytest.approx((p.seeds, p.recall_at_1, p.drop)) for key, p in points.items()} == wanted
    strong = points["sad", "shift", 3]
    assert strong.low < 0.1 < strong.high
    assert 0 < (strong.drop_low or 0) < 0.4 < (strong.drop_high or 0)
    with pytest.raises(BadInput, match="right place"):
        measure_robustness([series("little", unanswerable_run())], {})


def test_the_table_brackets_what_no_test_separates_from_clean_frames_and_dashes_what_was_not_run(found):
    assert [[*line.values()] for line in text.list_lines(found)] == [
        ["clean", "50.0", "85.0"],
        ["shift 1/8 px", "(2.5)/40.0", "(5.0)/60.0"],
        ["blur 2 %", "-", "(0.0)"],
    ]
    document = text.format_markdown(found, "a_route")
    assert re.search(r"^\| shift 1/8 px +\| \(2.5\)/40.0 +\| \(5.0\)/60.0 +\|$", document, re.MULTILINE)
    assert "- shift: queries moved left or right by 1, 8 px" in document
    rows = list(csv.DictReader(StringIO(found.points.to_csv(index=False))))
    assert [(line["method"], line["kind"], line["amount"]) for line in rows][2] == ("sad", "shift", "1 px")


def test_the_figure_has_a_panel_for_each_kind_begins_on_clean_frames_and_has_few_bands(found):
    figure = draw_robustness(found)
    panels = [axes for axes in figure.figure.axes if axes.get_visible()]
    assert [axes.get_title(loc="left") for axes in panels] == ["Shift", "Blur"]
    curves = [{line.get_label(): np.round(line.get_xydata(), 6).tolist() for line in axes.lines} for axes in panels]
    assert curves == [
        {"sad": [[0, 50], [1, 47.5], [3, 10]], "tempo": [[0, 85], [1, 80], [3, 25]]},
        {"sad": [[0, 50]], "tempo": [[0, 85], [2, 85]]},
    ]
    assert [tick.get_text() for tick in panels[0].get_xticklabels()] == ["clean", "1 px", "8 px"]
    assert "Shift: queries moved left or right by 1, 8 px, borders repeated." in figure.caption
    many = measure_robustness([sharing(name, 0.5) for name in "abcde"], {WEAK: [sharing("a", 0.4)]})
    for each, n_bands in ((many, 0), (found, 2)):
        told = len(draw_robustness(each).figure.axes[0].collections), "interval" in draw_robustness(each).caption
        assert told == (n_bands, n_bands > 0)
