"""`vprbench.compare`: names and objects on one dataset, ranked; nothing runs before all are built."""

from dataclasses import replace

import numpy as np
import pytest
from little import Lookup, Prototypes, journey

import vprbench
from vprbench.api import BadInput, MissingData


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def answering(right, n=30):
    """Return a method that answers the first `right` of `n` queries right."""
    table = np.eye(n, dtype=np.float32)
    table[right:] = np.roll(table[right:], 1, axis=1)
    return Lookup(table)


def test_methods_are_ranked_with_their_metrics_and_a_sentence():
    given = vprbench.compare(
        [answering(3), Prototypes(noise=0.0), answering(24)], journey(30, 30), metrics=["r100p"], timing="none"
    )
    table = given.table
    assert (table["recall_at_1"].tolist(), table["r100p"].tolist()[0]) == ([1.0, 0.8, 0.1], 1.0)
    assert (table["low"] <= table["recall_at_1"]).all()
    assert table["hz"].isna().all()
    assert "Prototypes" in given.sentence
    latex = given.to_latex()
    assert [word in latex for word in ("\\toprule", "not timed")] == [True, True]
    assert (given.to_markdown().count("\n"), "80.0" in given._repr_html_()) == (4, True)
    assert len(given.plot_pr().axes) == 1
    assert (repr(given).count("\n"), len(repr(given)) <= 100) == (0, True)
    printed = str(given).splitlines()
    assert (len(printed), "100.0" in printed[1], printed[4]) == (6, True, given.sentence)
    pairs = given.in_sequences(2)
    assert (len(pairs.results[0].queries), pairs.table["recall_at_1"].tolist()[0]) == (29, 1.0)


def test_a_comparison_writes_the_files_of_the_command_line(tmp_path):
    given = vprbench.compare([answering(3), answering(24)], journey(30, 30), timing="none")
    written = given.in_sequences(2).write(tmp_path / "out", "pairs")
    assert [path.name for path in written] == [
        *("pairs.md", "pairs.csv", "pairs.tex", "pairs-runs.csv", "pairs-predictions.csv"),
        *("captions.md", "pairs.html"),
    ]
    assert all(path.is_file() for path in written)
    assert {"similarity-journey", "recall-at-n-journey"} <= given.figures().keys()
    assert [group.view for group in given.report.groups] == [""]


def test_corruptions_are_set_beside_clean_frames_and_a_method_is_fitted_once_for_all(tmp_path):
    fits = []

    class Counted(Prototypes):
        def fit(self, references, places=None):
            fits.append(len(references))
            return super().fit(references, places)

    given = vprbench.compare(
        [Counted()], journey(30, 30), timing="none", results=None, corruptions=["noise", "shift-1"]
    )
    points = given.robustness.points
    assert [*zip(points["kind"], points["strength"], strict=True)] == [
        *(("clean", 0), ("shift", 1), ("noise", 1), ("noise", 2), ("noise", 3)),
    ]
    assert points["recall_at_1"].iloc[0] == given.results[0].recall()
    assert (points["recall_at_1"] + points["drop"]).tolist() == pytest.approx([given.results[0].recall()] * 5)
    assert fits == [30]
    names = {path.name for path in given.write(tmp_path / "out")}
    assert {"journey-robustness.md", "journey-robustness.csv"} <= names
    assert len(given.in_sequences(2).corrupted) == 4
    with pytest.raises(BadInput, match="fog"):
        vprbench.compare([Prototypes()], journey(4, 4), timing="none", corruptions=["fog"])


def test_a_method_that_was_tuned_on_places_of_the_dataset_has_its_recall_on_the_others_beside_it():
    given = vprbench.compare([answering(3), answering(24)], journey(30, 30), timing="none")
    assert given.table["elsewhere"].isna().all()
    assert "Elsewhere" not in given.to_markdown()
    other, best = (replace(result.run, dataset="synthetic") for result in given.results)
    tuned = replace(best, tuned_on={"dataset": "synthetic", "places": "0-9"})  # 14 of 24 hits are on 20 other places
    results = (replace(result, run=run) for result, run in zip(given.results, (other, tuned), strict=True))
    shown = replace(given, methods=tuple((result,) for result in results))
    assert shown.table["elsewhere"].tolist() == [pytest.approx(0.7), pytest.approx(np.nan, nan_ok=True)]
    assert shown.table["elsewhere_low"][0] < 0.7 < shown.table["elsewhere_high"][0]
    assert shown.to_markdown().count(" 70.0 [") == 1


def test_each_seed_runs_where_there_is_one():
    given = vprbench.compare([Prototypes(noise=4.0), answering(10)], journey(30, 30), seeds=3, timing="none")
    assert [result.run.config["seed"] for result in given.results] == [0, 1, 2, 0]
    assert given.table.set_index("method")["seeds"].to_dict()["Prototypes noise=4.0"] == 3
    recalls = [result.recall() for result in given.results[:3]]
    assert len(set(recalls)) > 1
    row = given.table[given.table["seeds"] == 3]
    assert row["recall_at_1"].item() == pytest.approx(np.mean(recalls))


def test_a_method_without_weights_stands_last_with_the_reason(caplog):
    given = vprbench.compare(["netvlad", Prototypes()], journey(4, 4), timing="none")
    assert given.table[["method", "seeds"]].to_numpy().tolist() == [["Prototypes", 1], ["netvlad", 0]]
    with pytest.raises(MissingData) as alone:
        vprbench.run("netvlad", journey(4, 4), timing="none")
    assert given.table["left_out"].tolist() == ["", str(alone.value)]
    assert "netvlad" in given.to_markdown().splitlines()[-1]
    assert [record.levelname for record in caplog.records if str(alone.value) in record.getMessage()] == ["WARNING"]


def test_all_errors_come_at_once():
    methods = ["nobody", Prototypes(), vprbench.method("sad", patch="wide"), "netvlad", Prototypes()]
    with pytest.raises(BadInput) as raised:
        vprbench.compare(methods, journey(4, 4), timing="none")
    lines = str(raised.value).splitlines()
    assert [line.partition(":")[0] for line in lines] == ["nobody", "method('sad', patch='wide')", "Prototypes"]
    with pytest.raises(BadInput, match=r"^sad, hog: .*quik"):
        vprbench.compare(["sad", "hog"], journey(4, 4), timing="quik")


METHODS = [["netvlad"], [Prototypes(), "nobody"], [Prototypes(), Prototypes()], [], "sad"]
OPTIONS = [{"metrics": ["r200p"]}, {"seeds": 0}, {"seeds": [0, 0]}, {"seeds": [0, -1]}, {"seed": 3}]


@pytest.mark.parametrize(
    ("methods", "more"), [*((each, {}) for each in METHODS), *(([Prototypes()], each) for each in OPTIONS)]
)
def test_an_argument_that_does_not_fit_is_an_error_before_anything_runs(tmp_path, methods, more):
    with pytest.raises(MissingData if methods == ["netvlad"] else BadInput):
        vprbench.compare(methods, journey(4, 4), timing="none", **more)
    assert list(tmp_path.rglob("run.json")) == []
