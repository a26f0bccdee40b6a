"""A comparison under corruptions: runs of their own, which stand beside clean ones and never among them."""

import csv
from pathlib import Path

import pytest
from quick_runs import quick_runs
from small_plan import install, quick_figures

import vprbench
from vprbench.cli import main
from vprbench.metrics.accuracy import recall_at
from vprbench.report.report import Report
from vprbench.runs.store import Store

pytestmark = pytest.mark.extended

ROUTE = {"places": 20, "first_query_place": 4}
ASKED = [
    *("compare", "methods=sad", "timing=none", "threads=1", "name=mine", "dataset=synthetic"),
    *(f"dataset.{name}={value}" for name, value in ROUTE.items()),
]
UNDER = "corruptions=[noise-1,shift-3]"


@pytest.fixture(scope="module")
def compared(tmp_path_factory):
    """A folder with a comparison on clean frames and under corruptions, and what was run for it."""
    folder = tmp_path_factory.mktemp("compared")
    with pytest.MonkeyPatch.context() as monkeypatch:
        apart = install(monkeypatch, folder)
        quick_figures(monkeypatch)
        quick_runs(monkeypatch)
        assert main([*ASKED, UNDER]) == 0
    return folder, apart


@pytest.fixture
def apart(compared, monkeypatch):
    """Stand in the folder of the comparison; returns what stands in for processes."""
    return install(monkeypatch, compared[0])


def lines(path):
    with Path("results", path).open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def runs():
    """Return the stored runs by their corruption."""
    return {run.config["corruption"]: run for run in Store(Path("results")).runs()}


def recall(run):
    return recall_at(run.outcome, 1).expected


def test_untimed_runs_of_each_corruption_stand_beside_clean_frames_in_the_files(compared, apart):
    asked = compared[1].asked
    assert [each.corruption for each in asked] == [None, ["shift-3", "noise-1"]]  # fitted once
    assert not asked[1].timing.rates
    found = runs()
    assert found.keys() == {None, "noise-1", "shift-3"}
    assert len({run.key for run in found.values()}) == len({run.fingerprint for run in found.values()}) == 3
    clean = recall(found[None])
    told = {f"{line['kind']}-{line['strength']}": line for line in lines("mine-robustness.csv")}
    assert {name: (float(line["recall_at_1"]), float(line["drop"])) for name, line in told.items()} == {
        str(name or "clean-0"): pytest.approx((recall(run), clean - recall(run))) for name, run in found.items()
    }
    assert "| shift 8 px" in Path("results/mine-robustness.md").read_text(encoding="utf-8")
    assert Path("results/figures/mine/robustness-mine.pdf").is_file()
    assert "robustness-mine" in Path("results/mine.html").read_text(encoding="utf-8")


def test_what_is_stored_is_found_by_all_commands_and_clean_frames_are_compared_and_tabled_alone(
    apart, monkeypatch, capsys
):
    shown = []
    monkeypatch.setattr(Report, "write", lambda one, *_: shown.append(one) or [])
    for more in [], ["stored=true"]:
        assert main([*ASKED, UNDER, *more]) == 0
        assert "noise ±5" in capsys.readouterr().out
    assert main(ASKED) == 0
    assert [run.key for group in shown[-1].groups for run in group.runs] == [runs()[None].key]
    assert main(["table", "rows=[SAD]", "columns=[route]", "name=table", "timing=none", "threads=1"]) == 0
    (cell,) = (line for line in lines("table.csv") if line["quantity"] == "recall_at_1")
    assert float(cell["value"]) == pytest.approx(100 * recall(runs()[None]))
    assert len(lines("table-runs.csv")) == 1
    assert apart.asked == []
    data = vprbench.dataset("synthetic", **ROUTE)
    for name in (None, "shift-3"):
        result = vprbench.run("sad", data, timing="none", threads=1, corruption=name)
        assert (result.from_store, result.run.key) == (True, runs()[name].key)
        assert ("corruption" in result.run.protocol) == (name is not None)


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ([*ASKED, "corruptions=[shfit]"], "shift"),
        ([*ASKED, "corruption=shift-1"], "corruptions=NAME"),
        (["table", "corruption=shift-1"], "clean"),
        (["corruption=shift-9"], "1 to 3"),
    ],
)
def test_an_unknown_corruption_and_one_that_is_out_of_place_are_named(apart, capsys, options, word):
    assert main(options) == 2
    assert word in capsys.readouterr().err
    assert apart.asked == []
