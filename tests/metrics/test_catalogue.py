"""Every metric is reached by its name, and one that is added is everywhere at once."""

import csv
import io
import json
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest
from checkout import ROOT
from little import a_run, unanswerable_run
from little_runs import quiet_surroundings
from small_plan import RUN, install, run_apart
from stored_runs import measured, run, table

from vprbench.api.arithmetic import Arithmetic
from vprbench.cli import main
from vprbench.errors import BadInput
from vprbench.metrics import catalogue
from vprbench.metrics.accuracy import average_precision, pr_curve_multi
from vprbench.metrics.catalogue import METRICS, Metric, average_metric
from vprbench.report.table import formats
from vprbench.report.table.quantities import list_quantities
from vprbench.runs.energy import count_synops, estimate_joules
from vprbench.runs.recall_intervals import estimate_interval


@pytest.fixture
def package(monkeypatch):
    """A function that lets a package name a metric at this entry point."""

    def name_metric(value):
        monkeypatch.setattr(catalogue, "entry_points", lambda group: [EntryPoint("mine", value, group)])

    monkeypatch.syspath_prepend(ROOT / "tests" / "example_plugin")
    catalogue.load_plug_in_metrics.cache_clear()
    yield name_metric
    catalogue.load_plug_in_metrics.cache_clear()
    METRICS.pop("mrr", None)


def test_each_metric_of_four_queries_is_the_one_worked_by_hand_and_undefined_without_a_right_place():
    # right, right, wrong, wrong in falling order of confidence, the right places of the last two 3rd and 8th
    found = {name: METRICS[name].of(a_run()) for name, each in METRICS.items() if each.cost is None and name != "ap_c"}
    wanted = {"recall_at_1": 0.5, "recall_at_5": 0.75, "recall_at_10": 1, "recall_at_25": 1, "auc_pr_a": 0.5}
    wanted |= {"average_precision_a": 0.5, "r100p": 0.5, "p100r": 0.5, "auc_roc": 1, "ep": 1, "f1_max": 2 / 3}
    assert found == pytest.approx(wanted)
    assert {name: METRICS[name].of(unanswerable_run()) for name in METRICS} == dict.fromkeys(METRICS)


def test_all_pairs_are_judged_where_a_run_keeps_the_whole_map():
    scores = np.random.default_rng(3).random((4, 10)).astype(np.float32)
    best = np.argsort(-scores, axis=1).astype(np.int32)
    kept = run(top_places=best, top_scores=np.take_along_axis(scores, best, axis=1))
    wanted = average_precision(pr_curve_multi(scores, kept.positives))
    assert METRICS["ap_c"].of(kept) == pytest.approx(wanted)
    fewer = run(top_places=best[:, :9], top_scores=kept.top_scores[:, :9])
    assert METRICS["ap_c"].of(fewer) is None


ONE = ["method=sad", "dataset=synthetic", "dataset.places=20", "dataset.first_query_place=4", *RUN]


def test_a_metric_of_a_package_is_in_row_json_csv_and_table_with_its_interval(package, tmp_path, monkeypatch, capfd):
    package("vprbench_example.metrics:MRR")
    with quiet_surroundings():
        install(monkeypatch, tmp_path)
        row = run_apart([*ONE, "metrics=[mrr,r100p]"]).printed
        assert {"MRR", "R@100P %"} <= {*row.replace("  ", "\n").split("\n")}
        said = json.loads(run_apart([*ONE, "metrics=mrr", "output=json"]).printed)
    assert main(["table", "rows=[SAD]", "metrics=[mrr]", "stored=true"]) == 0
    assert "| MRR " in capfd.readouterr().out
    cells = csv.DictReader(Path("results/table.csv").read_text().splitlines())
    (cell,) = [cell for cell in cells if cell["quantity"] == "mrr" and cell["value"]]
    assert (said["from_store"], float(cell["value"])) == (True, pytest.approx(said["mrr"]))
    assert 0 < float(cell["low"]) < float(cell["value"]) <= float(cell["high"]) <= 1
    assert next(csv.DictReader(Path("results/table-runs.csv").read_text().splitlines()))["mrr"] == cell["value"]


@pytest.mark.parametrize("value", ["vprbench_example.metrics:invert_ranks", "vprbench.metrics.catalogue:RECALLS"])
def test_an_entry_point_that_is_no_metric_is_one_line(package, capfd, value):
    package(value)
    assert main(["method=sad", "metrics=mine"]) == 2
    assert f"{value} of vprbench.metrics is" in capfd.readouterr().err


def test_a_metric_without_values_per_query_is_in_the_table_in_its_unit_and_never_bold(monkeypatch):
    lost = Metric("lost", "Lost", lambda run: 1 - float(run.outcome.answerable.mean()), "no right place", 2, False)
    monkeypatch.setitem(METRICS, "lost", lost)
    names = ("r100p", "ep", "lost")
    made = table([run(hits=[1] * 40), run("vprsnn", hits=[0] * 40)], quantities=list_quantities(names))
    assert [measured(made, "SAD", name).value for name in names] == [100, 1, 0]
    assert not any(measured(made, "SAD", name).best for name in names)
    (line, *_) = [line for line in csv.DictReader(io.StringIO(formats.to_csv(made))) if line["quantity"] == "ep"]
    assert (line["unit"], line["value"]) == ("", "1.0")
    assert lost.explained in formats.to_markdown(made)


def test_a_metric_whose_values_per_query_are_no_shares_is_refused_by_name_before_any_interval():
    ranks = average_metric(
        "mean_rank", "Mean rank", lambda answers, ties: answers.outcome.above + 1.0, "of all", unit=""
    )
    for compute in (ranks.of, lambda answers: estimate_interval([answers], ranks)):
        with pytest.raises(BadInput, match=r"mean_rank.* 1 to 8.*per_query"):
            compute(a_run())


def test_an_unknown_metric_is_told_with_its_neighbours(capfd):
    for options in (["method=sad"], ["table"]):
        assert main([*options, "metrics=[r100]"]) == 2
        assert "did you mean r100p" in capfd.readouterr().err


def test_arithmetic_costs_what_the_table_says_and_synaptic_operations_add_up_by_their_kind():
    for arithmetic, picojoules in (
        ([Arithmetic(1000, 0)], 4600),  # Horowitz: 3.7 + 0.9
        ([Arithmetic(0, 1000)], 900),
        ([Arithmetic(1000, 1000, "int8")], 330),  # 0.2 + 0.1 of a sum in 32 bits; 0.03
        ([Arithmetic(10, 0), Arithmetic(10, 10, "int64")], 79),  # 0.1 + 3.1; 0.1
    ):
        assert 1e12 * estimate_joules(arithmetic) == pytest.approx(picojoules)
    layers = [{"synops": n, "operation": kind} for n, kind in ((5.0, "AC"), (7.0, "MAC"), (1.5, "AC"))]
    assert count_synops({"layers": [*layers, {"name": "output"}]}) == (6.5, 7.0)
    assert count_synops({"layers": [{"name": "output"}]}) is None
    assert count_synops(None) is None
