"""A ranking puts the rows of one dataset in order, and says no more than its tests do."""

import re
from dataclasses import replace

import pytest
from figure_runs import series
from little import unanswerable_run
from stored_runs import run

from vprbench.report.ranking import rank_rows
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
