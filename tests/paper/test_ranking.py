"""A ranking puts the rows of one dataset in order, and says no more than its tests do."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import pytest
from figure_runs import series
from little import unanswerable_run
from stored_runs import run

from vprbench.paper.ranking import ranked
from vprbench.paper.selection import Series


def right_but(*wrong: int, n_queries: int = 60) -> list[int]:
    return [int(query not in wrong) for query in range(n_queries)]


def row(name: str, *wrong: int, **changes: Any) -> Series:
    """Return a row of 60 queries, wrong at some; it takes 12.5 ms a query and 12.34 s to fit unless told otherwise."""
    return series(name, run(hits=right_but(*wrong), **changes))


MANY = range(0, 60, 2)


def test_rows_come_best_first_with_the_numbers_of_all_their_seeds() -> None:
    seeds = [run(seed=0, hits=right_but(0, 1, 2)), run(seed=1, hits=right_but(0), fit_seconds=20.0)]
    first, second = ranked([row("hog", *MANY), series("sad", *seeds)]).rows
    assert (first.name, len(first.runs), second.name) == ("sad", 2, "hog")
    assert first.recall == pytest.approx((57 + 59) / 120)
    assert first.low is not None
    assert first.high is not None
    assert first.low < first.recall < first.high
    assert first.hz == pytest.approx(80)
    assert first.fit_seconds == pytest.approx((12.34 + 20) / 2)


def test_the_first_sentence_gives_the_difference_its_interval_and_how_much_faster() -> None:
    slow = row("hog", encode_seconds=(0.1,) * 30, match_seconds=(0.0,) * 30)
    fast = row("sad", *MANY, encode_seconds=(0.01,) * 30, match_seconds=(0.0,) * 30)
    (sentence, *_) = ranked([fast, slow]).sentences
    assert sentence.startswith("hog is best: 100.0 %, 50.0 points above sad [")
    low, high = map(float, re.findall(r"\[([\d.]+), ([\d.]+)\]", sentence)[0])
    assert 0 < low < 50 < high < 100
    assert "sad is 10 times faster" in sentence


def test_a_difference_that_no_test_sees_is_told_as_such_with_its_interval() -> None:
    (sentence,) = ranked([row("hog"), row("sad", 7)]).sentences
    assert "is best" not in sentence
    assert re.search(r"1\.7 points above sad \[-[\d.]+, [\d.]+\]", sentence)
    assert "faster" not in sentence


def test_a_third_row_that_is_fastest_of_all_is_named() -> None:
    slow, slower = ({"encode_seconds": (s,) * 30, "match_seconds": (0.0,) * 30} for s in (0.02, 0.04))
    quick = {"encode_seconds": (0.005,) * 30, "match_seconds": (0.0,) * 30}
    told = ranked([row("hog", **slower), row("pca", 1, **slow), row("sad", *MANY, **quick)]).sentences
    assert "and" not in told[0]
    assert "sad" in told[1]
    assert "200" in told[1]


def test_a_row_tuned_on_these_places_is_ranked_and_not_called_best() -> None:
    there = run(hits=right_but())
    tuned = series("tuned", replace(there, tuned_on={"dataset": there.dataset, "places": "0-9"}))
    ranking = ranked([row("hog", 7), row("sad", *MANY), tuned])
    assert ranking.rows[0].name == "tuned"
    assert ranking.sentences[0].startswith("hog is best")
    assert "tuned" in ranking.sentences[-1]


def test_where_no_query_has_a_right_place_nothing_is_ranked() -> None:
    ranking = ranked([series("a", unanswerable_run()), series("b", unanswerable_run())])
    assert [one.recall for one in ranking.rows] == [None, None]
    assert len(ranking.sentences) == 1
