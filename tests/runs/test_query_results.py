"""What is told of each query: its best places as a table and a file, and the report's verdict."""

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from little import a_run
from report_page import SAD_WRONG, TEMPO_WRONG, UNANSWERABLE, answered, journey_run, right_place
from textures import textures

import vprbench
from vprbench.cli import main
from vprbench.errors import BadInput
from vprbench.python.result import Result
from vprbench.report.page.columns import list_columns
from vprbench.runs.query_results import judge_answers, order_by_interest

PLACES = 8


def test_a_run_writes_the_best_places_of_each_query_and_a_stored_one_without_running_again(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    for seed, name in enumerate(("a", "b", "queries")):
        textures(Path(name), PLACES, noise=20 * seed)
    asked = ["method=sad", "timing=none", "threads=1", "dataset=folders", "dataset.references=[a,b]"]
    assert main([*asked, "dataset.queries=queries"]) == 0
    assert not list(Path("results").glob("*.csv"))
    capsys.readouterr()
    assert main([*asked, "dataset.queries=queries", "predictions=3", "output=json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["from_store"], len(told["predictions"])) == (True, 1)
    (path,) = Path("results").glob("*-predictions.csv")
    lines = list(csv.DictReader(path.read_text(encoding="utf-8").splitlines()))
    assert [(line["query"], line["rank"]) for line in lines] == [(str(q), str(r)) for q in range(PLACES) for r in "123"]
    assert [line["place"] for line in lines[::3]] == [*map(str, range(PLACES))]
    first = {name: lines[3][name] for name in ("query_image", "reference_image", "right")}
    assert first == {"query_image": "queries/1.png", "reference_image": "a/1.png", "right": "True"}
    assert [line["right"] for line in lines[1::3]] == ["False"] * PLACES
    assert all(float(one["score"]) >= float(two["score"]) for one, two in zip(lines[::3], lines[1::3], strict=True))


def test_in_python_the_table_is_that_of_the_result_and_of_its_sequences():
    frames = np.random.default_rng(0).integers(0, 256, (4, 48, 64), np.uint8)
    seen = frames ^ np.uint8(1)  # no copies
    found = vprbench.run("sad", vprbench.dataset_of(frames, seen, positives=[[0], [1], [3], []]), timing="none")
    table = found.predictions(1)
    assert table["query_image"].tolist() == table["reference_image"].tolist() == [f"image {i}" for i in range(4)]
    assert table["right"].tolist() == [True, True, False, False]
    assert len(found.predictions(2)) == len(found.predictions().groupby("query").head(2)) == 8
    assert found.in_sequences(2).predictions(1)["query"].tolist() == [1, 2, 3]


def test_a_place_that_is_no_candidate_has_no_row_and_more_places_than_are_kept_are_refused():
    scores = a_run().top_scores.copy()
    scores[1, 1] = -np.inf
    result = Result(a_run(top_scores=scores), None, ("a", "b", "c", "d"))
    table = result.predictions(2)
    assert table["place"].tolist() == [0, 4, 1, 9, 8, 7, 6]
    assert table["right"].tolist() == [True, False, True, False, False, False, False]
    assert table["query_image"].isna().all()
    for wrong in (0, 3):
        with pytest.raises(BadInput, match="predictions"):
            result.predictions(wrong)


NO = -np.inf  # the score of a place that is no candidate


def judged_alone(scores, right, depth=None):
    """Judge one query; with a `depth` only so many best places are kept."""
    if depth is None:
        return judge_answers(answered([scores], [right]))
    return judge_answers(replace(answered([scores], [right], depth=depth), scores=None))


def test_a_query_is_judged():
    for scores, right, depth, judgement in (
        ([0.125, 0.875, 0.5, 0.25], [1], None, ("r", 0.375, "=", [1, 2, 3], 1, 1)),
        ([0.875, 0.5, 0.25, 0.125, 0.0], [3], None, ("w", -0.75, "=", [0, 1, 2], 3, 4)),  # beyond those shown
        ([0.75, 0.75, 0.5, 0.0], [0], None, ("t", 0.0, "=", [1, 0, 2], 0, 1)),  # the wrong one is listed first
        ([0.875, 0.0, 0.125, 0.5, 0.25], [2, 3, 4], None, ("w", -0.375, "=", [0, 3, 4], 3, 2)),  # the best right one
        ([0.875, 0.5, 0.5, 0.5, 0.0], [2], None, ("w", -0.375, "=", [0, 1, 3], 2, 2)),
        ([0.875, 0.5, 0.25, 0.0], [], None, ("u", None, "?", [0, 1, 2], -1, 0)),
        ([NO, NO, NO, NO], [2], None, ("w", None, "?", [-1, -1, -1], 2, 0)),
        ([0.875, NO, 0.5, NO], [1], None, ("w", NO, "=", [0, 2, -1], 1, 0)),
        ([0.875, NO, NO, NO], [0], None, ("r", np.inf, "=", [0, -1, -1], 0, 1)),
        ([0.875, 0.75, 0.5, 0.25], [3], 2, ("w", -0.125, "<", [0, 1, -1], 3, 4)),  # known as a bound
        ([0.875, 0.75, 0.5, 0.25], [0, 1], 2, ("r", 0.125, ">", [0, 1, -1], 0, 1)),
        ([0.875, 0.75, 0.5, 0.25], [1], 2, ("w", -0.125, "=", [0, 1, -1], 1, 2)),
        ([0.5, 0.5, 0.5, 0.0], [2], 2, ("t", 0.0, "<", [0, 1, -1], 2, 1)),  # the right place of the tie is not kept
    ):
        answers = judged_alone(scores, right, depth)
        (margin,), places = answers.margins.tolist(), answers.places.tolist()
        found = (answers.verdicts, None if np.isnan(margin) else margin, answers.bounds, *places)
        assert (*found, *answers.right_places.tolist(), *answers.ranks.tolist()) == judgement


def test_scores_stand_beside_their_places_and_wrong_places_of_equal_score_are_counted():
    of_outcome = judge_answers(replace(a_run(), scores=None))  # of a map of its own making
    assert (of_outcome.verdicts, of_outcome.ranks.tolist()) == ("rrww", [1, 1, 3, 8])
    assert judged_alone([0.125, 0.875, 0.5, 0.25], [1]).scores.tolist() == [[0.875, 0.5, 0.25]]
    assert judged_alone([0.875, 0.5, 0.25, 0.125, 0.0], [3]).right_scores.tolist() == [0.125]
    assert judged_alone([0.875, 0.75, 0.5, 0.25], [3], depth=2).right_scores.tolist() == [0.75]
    tied = [judged_alone([0.75, 0.75, 0.5, 0.0], [0]), judged_alone([0.875, 0.5, 0.5, 0.5, 0.0], [2])]
    assert [answers.equals.tolist() for answers in tied] == [[1], [2]]


def test_what_the_page_reads_is_plain_and_holds_every_query():
    scores = [[0.875, NO, 0.5], [0.875, NO, NO], [0.5, 0.25, 0.125], [1 / 3, 2 / 3, 0.0]]
    told = list_columns(judge_answers(answered(scores, [[1], [0], [], [0]])))
    assert json.loads(json.dumps(told, allow_nan=False)) == {
        "verdicts": "wruw",
        "places": [0, 2, -1, 0, -1, -1, 0, 1, 2, 1, 0, 2],
        "scores": [0.875, 0.5, None, 0.875, None, None, 0.5, 0.25, 0.125, 0.66667, 0.33333, 0.0],
        "right": [1, 0, -1, 0],
        "rightScores": [None, 0.875, None, 0.33333],
        "ranks": [0, 1, 0, 2],
        "equals": {},
        "margins": ["-", "+", None, -0.33333],
        "bounds": "==?=",
    }


def test_queries_that_are_not_answered_right_come_first_with_their_places_and_then_all_others_in_one_order():
    run = journey_run(SAD_WRONG)
    listed = dict(order_by_interest(judge_answers(run)))
    assert set([*listed][:6]) == {*SAD_WRONG, UNANSWERABLE}
    assert sorted(listed) == list(range(len(run.outcome)))
    assert all({right_place(query), *run.top_places[query, :3]} == listed[query] for query in (10, 40))
    first, second = (
        [query for query, _ in order_by_interest(judge_answers(journey_run(wrong)))]
        for wrong in (SAD_WRONG, TEMPO_WRONG)
    )
    common = {*first} - {*SAD_WRONG, *TEMPO_WRONG, UNANSWERABLE}
    assert [query for query in first if query in common] == [query for query in second if query in common]
    assert sorted(common) != [query for query in first if query in common]  # from all over the journey
