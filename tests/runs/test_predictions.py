"""The best places of each query as a table and as a file, whose expected lines are told by how the frames were made.

The frame of place k is a texture of its own; query k shows it with noise, so its best place is k.
"""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from little import a_run
from textures import textures

import vprbench
from vprbench.cli import main
from vprbench.errors import BadInput
from vprbench.python.result import Result

PLACES = 8


def options(*more):
    return ["method=sad", "timing=none", "threads=1", "dataset=folders", "dataset.references=[a,b]", *more]


@pytest.fixture
def drives(tmp_path, monkeypatch):
    """Stand beside two reference traverses and one of queries."""
    monkeypatch.chdir(tmp_path)
    for seed, name in enumerate(("a", "b", "queries")):
        textures(Path(name), PLACES, noise=20 * seed)
    return tmp_path


def written(pattern="*-predictions.csv"):
    (path,) = Path("results").glob(pattern)
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_a_run_writes_the_best_places_of_each_query_and_a_stored_one_without_running_again(drives, capsys):
    assert main(options("dataset.queries=queries")) == 0
    assert not list(Path("results").glob("*.csv"))
    capsys.readouterr()
    assert main(options("dataset.queries=queries", "predictions=3", "output=json")) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["from_store"], len(told["predictions"])) == (True, 1)
    lines = written()
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
