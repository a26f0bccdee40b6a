"""`vprbench.compare`: names and objects on one dataset, ranked; nothing runs before all are built."""

from dataclasses import replace

import numpy as np
import pytest
from little import Lookup, Prototypes, journey

import vprbench
from vprbench.api import BadInput, MissingData
from vprbench.python.comparison import report_results


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def answering(right, n=30):
    """Return a method that answers the first `right` of `n` queries right."""
    table = np.eye(n, dtype=np.float32)
    table[right:] = np.roll(table[right:], 1, axis=1)
    return Lookup(table)


def test_methods_are_ranked_and_shown_and_written_as_the_command_line_does(tmp_path):
    given = vprbench.compare(
        [answering(3), Prototypes(noise=0.0), answering(24)], journey(30, 30), metrics=["r100p"], timing="none"
    )
    table = given.table
    assert (table["recall_at_1"].tolist(), table["r100p"].tolist()[0]) == ([1.0, 0.8, 0.1], 1.0)
    assert (table["low"] <= table["recall_at_1"]).all()
    assert table["hz"].isna().all()
    assert "Prototypes" in given.sentence
    for text, word in ((given.to_latex(), "\\toprule"), (given.to_markdown(), "|:--"), (given._repr_html_(), "<table")):
        assert [each in text for each in (word, "not timed", "80.0")] == [True] * 3
    assert (repr(given).count("\n"), len(repr(given)) <= 100) == (0, True)
    assert [line in str(given) for line in ("100.0", given.sentence)] == [True, True]
    assert {"similarity-journey", "recall-at-n-journey"} <= given.figures().keys()
    pairs = given.in_sequences(2)
    assert (len(pairs.results[0].queries), pairs.table["recall_at_1"].tolist()[0]) == (29, 1.0)
    written = pairs.write(tmp_path / "out", "pairs")
    names = "pairs.md pairs.csv pairs.tex pairs-runs.csv pairs-predictions.csv captions.md pairs.html"
    assert [path.name for path in written if path.is_file()] == names.split()


def test_corruptions_are_set_beside_clean_frames_and_a_method_is_fitted_once_for_all(tmp_path):
    fits = []

    class Counted(Prototypes):
        def fit(self, references, places=None):
            fits.append(len(references))
            return super().fit(references, places)

    options = {"timing": "none", "results": None, "corruptions": ["noise", "shift-1"]}
    given = vprbench.compare([Counted()], journey(30, 30), **options)
    points = given.robustness.points
    names = [f"{point.kind}-{point.strength}" for point in points.itertuples()]
    assert names == ["clean-0", "shift-1", "noise-1", "noise-2", "noise-3"]
    clean = given.results[0].recall()
    assert points["recall_at_1"].iloc[0] == clean
    assert (points["recall_at_1"] + points["drop"]).tolist() == pytest.approx([clean] * 5)
    assert fits == [30]
    names = {path.name for path in given.write(tmp_path / "out")}
    assert {"journey-robustness.md", "journey-robustness.csv"} <= names
    assert len(given.in_sequences(2).corrupted) == 4


def test_a_method_that_was_tuned_on_places_of_the_dataset_has_its_recall_on_the_others_beside_it():
    given = vprbench.compare([answering(3), answering(24)], journey(30, 30), timing="none")
    assert given.table["elsewhere"].isna().all()
    other, best = (replace(result.run, dataset="synthetic") for result in given.results)
    tuned = replace(best, tuned_on={"dataset": "synthetic", "places": "0-9"})  # 14 of 24 hits are on 20 other places
    shown = report_results([replace(one, run=run) for one, run in zip(given.results, (other, tuned), strict=True)])
    assert shown.table["elsewhere"].tolist() == [pytest.approx(0.7), pytest.approx(np.nan, nan_ok=True)]
    assert shown.table["elsewhere_low"][0] < 0.7 < shown.table["elsewhere_high"][0]
    assert "elsewhere 70.0 [" in shown.to_markdown()


def test_each_seed_runs_where_there_is_one():
    given = vprbench.compare([Prototypes(noise=4.0), answering(10)], journey(30, 30), seeds=3, timing="none")
    assert [result.run.config["seed"] for result in given.results] == [0, 1, 2, 0]
    recalls = [result.recall() for result in given.results[:3]]
    assert len(set(recalls)) > 1
    row = given.table.set_index("method").loc["Prototypes noise=4.0"]
    assert (row["seeds"], row["recall_at_1"]) == (3, pytest.approx(np.mean(recalls)))


def test_a_method_without_weights_stands_last_with_the_reason(caplog):
    given = vprbench.compare(["netvlad", Prototypes()], journey(4, 4), timing="none")
    assert given.table[["method", "seeds"]].to_numpy().tolist() == [["Prototypes", 1], ["netvlad", 0]]
    with pytest.raises(MissingData) as alone:
        vprbench.run("netvlad", journey(4, 4), timing="none")
    assert given.table["left_out"].tolist() == ["", str(alone.value)]
    assert [word in given.to_markdown() for word in ("| netvlad", "not there", "missing: ")] == [True] * 3
    assert [record.levelname for record in caplog.records if str(alone.value) in record.getMessage()] == ["WARNING"]


def test_all_errors_come_at_once():
    methods = ["nobody", Prototypes(), vprbench.method("sad", patch="wide"), "netvlad", Prototypes()]
    with pytest.raises(BadInput) as raised:
        vprbench.compare(methods, journey(4, 4), timing="none")
    lines = str(raised.value).splitlines()
    assert [line.partition("(")[0].partition(":")[0] for line in lines] == ["nobody", "method", "Prototypes"]


METHODS = [["netvlad"], [Prototypes(), "nobody"], [Prototypes(), Prototypes()], [], "sad"]
OPTIONS = [{"metrics": ["r200p"]}, {"seeds": 0}, {"seeds": [0, 0]}, {"seeds": [0, -1]}, {"seed": 3}, {"timing": "quik"}]


@pytest.mark.parametrize(
    ("methods", "more"), [*((each, {}) for each in METHODS), *(([Prototypes()], each) for each in OPTIONS)]
)
def test_an_argument_that_does_not_fit_is_an_error_before_anything_runs(tmp_path, methods, more):
    with pytest.raises(MissingData if methods == ["netvlad"] else BadInput):
        vprbench.compare(methods, journey(4, 4), **{"timing": "none", **more})
    assert list(tmp_path.rglob("run.json")) == []
