"""`make table` shows and writes what is quick before the slow rows run, and keeps what is done if these are stopped."""

import csv
import signal
from pathlib import Path

import pytest
from quick_runs import quick_runs
from small_plan import RUN, install

from vprbench.cli import main
from vprbench.jobs import executors
from vprbench.runs.request import RunRequest


def marks():
    """Return the mark of each cell of R@1 in the files as they are now."""
    path = Path("results/table.csv")
    with path.open(encoding="utf-8", newline="") as file:
        return {(c["row"], c["column"]): c["mark"] for c in csv.DictReader(file) if c["quantity"] == "recall_at_1"}


@pytest.fixture
def seen(tmp_path, monkeypatch):
    """What the files hold whenever a run of the slow row (PCA on 12 places) begins; the second run never ends."""
    quick_runs(monkeypatch)
    apart, seen = install(monkeypatch, tmp_path), []

    def run(request_json, *_):
        if RunRequest.from_json(request_json).method_name != "pca":
            return apart(request_json)
        seen.append(marks())
        if len(seen) == 2:
            raise KeyboardInterrupt
        return apart(request_json)

    monkeypatch.setattr(executors, "run_in_child", run)
    return seen


ASKED = ("rows=[SAD,Nobody,PCA]", "name=table")
QUICK = {("SAD", "route_12"): "measured", ("Nobody", "route_12"): "not there"}


@pytest.mark.extended
def test_quick_rows_are_shown_and_written_before_a_slow_one_and_after_it_or_its_interruption(seen, capsys):
    assert main(["table", *ASKED, "columns=[route_12]", *RUN]) == 0
    printed = capsys.readouterr().out
    assert seen == [{**QUICK, ("PCA", "route_12"): "unfinished"}]
    assert printed.count("| SAD ") == 2
    assert marks() == {**QUICK, ("PCA", "route_12"): "measured"}
    assert main(["table", *ASKED, "columns=[route_12]", *RUN]) == 0
    assert capsys.readouterr().out.count("| SAD ") == 1
    assert main(["table", *ASKED, "columns=[route_12,route]", "full=true", *RUN]) == 128 + signal.SIGINT
    assert seen[1:] == [marks()]  # an interruption leaves the files of what is done
    assert (marks()["PCA", "route_12"], marks()["PCA", "route"]) == ("measured", "unfinished")
