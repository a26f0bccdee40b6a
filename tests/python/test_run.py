"""`vprbench.run` and `compare`: names and objects run in this process, are found again and ranked, or are an error."""

import json
import logging
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from little import Lookup, Prototypes, journey

import vprbench
from vprbench.api import BadInput, BinaryMethod, DescriptorMethod, Method, MissingData
from vprbench.cli import main
from vprbench.python.comparison import report_results
from vprbench.runs.frame import COLUMNS

SMALL = {"places": 12, "first_query_place": 0}


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def untimed(method, data, **options):
    return vprbench.run(method, data, timing="none", **options)


class Plain(Method):
    """No dataclass; keeps its argument under another name if asked to."""

    def __init__(self, weight=1.0, hidden=False):
        setattr(self, "secret" if hidden else "weight", weight)
        self.hidden = hidden

    def fit(self, references, places):
        self.n_places = int(places.max()) + 1
        return self

    def encode(self, images):
        return np.stack([image.ravel() for image in images])

    def match(self, codes):
        return np.zeros((len(codes), self.n_places), np.float32)


def test_a_named_run_is_the_one_that_the_command_line_stores(capsys):
    result = untimed("pca", vprbench.dataset("synthetic", **SMALL))
    assert (result.from_store, result.folder is not None and result.folder.is_dir()) == (False, True)
    options = [f"dataset.{name}={value}" for name, value in SMALL.items()]
    assert main(["method=pca", *options, "timing=none", "output=json"]) == 0
    printed = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert (printed["from_store"], printed["recall_at_1"]) == (True, result.recall(1))


def test_an_object_runs_as_it_is_is_not_fitted_and_is_found_by_its_arguments():
    data, method = journey(6, 6), Prototypes(noise=0.0)
    first, again = untimed(method, data), untimed(method, data)
    assert (first.recall(1), first.from_store, again.from_store) == (1.0, False, True)
    assert (method._means, first.run.method, first.run.config["changed"]) == (None, "Prototypes", {"noise": 0.0})
    assert not untimed(Prototypes(noise=0.25), data).from_store
    assert untimed(Prototypes(0.0), data).from_store
    seeds = [untimed(Prototypes(seed=5), data, **more).run.config["seed"] for more in ({}, {"seed": 2})]
    assert seeds == [5, 2]
    assert untimed(Prototypes, data, seed=3).run.config["method"]["seed"] == 3


def test_a_class_is_known_by_its_attributes_and_nothing_is_stored_without_them_or_a_folder(caplog, tmp_path):
    stored = untimed(Plain(weight=2.0), journey(4, 4))
    assert stored.run.config["method"]["weight"] == 2.0
    with caplog.at_level(logging.WARNING):
        hidden = untimed(Plain(weight=2.0, hidden=True), journey(4, 4))
    assert hidden.folder is None
    assert any("weight" in record.getMessage() for record in caplog.records)
    assert hidden.recall(1) == stored.recall(1) == 0.25
    there = list(tmp_path.rglob("*"))
    for _ in range(2):
        result = untimed(Lookup(np.eye(4, dtype=np.float32)), journey(4, 4), results=None)
        assert (result.folder, result.from_store, result.run.scores.shape) == (None, False, (4, 4))
    assert list(tmp_path.rglob("*")) == there


@pytest.mark.parametrize(
    ("kind", "given"), [(Plain, None), (DescriptorMethod, [[1.0]] * 4), (BinaryMethod, np.ones(7, np.float32))]
)
def test_codes_that_are_no_array_with_a_row_for_each_image_are_one_line_and_fit_need_not_return(kind, given):
    class Odd(kind):
        def encode(self, images):
            return given

    class Forgetful(Plain):
        def fit(self, references, places):
            super().fit(references, places)

    with pytest.raises(BadInput, match="encode") as error:
        untimed(Odd(), journey(4, 4), results=None)
    assert "\n" not in str(error.value)
    assert untimed(Forgetful(), journey(4, 4), results=None).recall(1) == 0.25


@pytest.mark.extended
def test_results_is_a_row_for_each_stored_run_and_tells_data_of_one_name_apart():
    with pytest.raises(BadInput, match="there"):
        vprbench.results("there")
    Path("there").mkdir()
    empty = vprbench.results("there")
    assert {*COLUMNS} <= {*empty}
    untimed(Prototypes(0.25), journey(4, 6), results="there", seed=1)
    for more in ({}, {"places": 14}, {"tolerance": 1}):
        untimed("sad", vprbench.dataset("synthetic", **{**SMALL, **more}), results="there")
    table = vprbench.results("there").set_index("dataset")
    assert (len(empty), [*empty]) == (0, [*vprbench.results("there")])
    own = table.loc["journey"]
    told = ["method", "seed", "arguments", "places", "queries", "dataset_arguments"]
    assert own[told].tolist() == ["Prototypes", 1, "noise=0.25", 6, 4, ""]
    assert (np.isnan(own["hz"]), own["training_seconds"]) == (True, own["fit_seconds"])
    of_name = table.loc["synthetic"].set_index("dataset_arguments")
    assert of_name["places"].tolist().count(14) == 1
    assert of_name["fingerprint"].nunique() == of_name["protocol"].nunique() == 3


@pytest.mark.parametrize(
    ("method", "dataset", "options", "error", "named"),
    [
        ("sadd", "synthetic", {}, BadInput, "sad"),
        ("sad", "synthetik", {}, BadInput, "synthetic"),
        (3, "synthetic", {}, BadInput, "int"),
        ("sad", 3, {}, BadInput, "int"),
        ("sad", "synthetic", {"sed": 1}, BadInput, "seed"),
        ("sad", "synthetic", {"limit_minutes": 1}, BadInput, "limit_minutes"),
        ("sad", "synthetic", {"timing": {"minimum_second": 1}}, BadInput, "minimum_second"),
        ("sad", "folders", {}, MissingData, "references"),
        (Prototypes(), "synthetic", {"device": "gpu"}, BadInput, "gpu"),
    ],
)
def test_what_does_not_fit_is_an_error_that_names_it(method, dataset, options, error, named):
    with pytest.raises(error, match=named):
        vprbench.run(method, dataset, **options)


def test_options_of_methods_and_datasets_are_checked_and_build_what_they_say():
    with pytest.raises(BadInput, match="patch"):
        vprbench.method("sad", patsh=3)
    for wrong, named in (({"places": "ten"}, r"dataset\.places"), ({**SMALL, "name": "it's [a, b]=\\c"}, "name")):
        with pytest.raises(BadInput, match=named):
            vprbench.dataset("synthetic", **wrong).build()
    assert repr(vprbench.dataset("synthetic", **SMALL)) == "dataset('synthetic', places=12, first_query_place=0)"
    many = vprbench.dataset("synthetic", references=["spring"] * 99, name="line\nbreak")
    assert (len(repr(many)), repr(many).count("\n")) == (100, 0)
    assert vprbench.dataset("synthetic", references=("spring",), **SMALL).build().n_places == 12
    assert vprbench.method("vprtempo", max_module=np.int64(50)).build(seed=4).max_module == 50


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
