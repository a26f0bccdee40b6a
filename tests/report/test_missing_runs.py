"""Runs that are wanted and not stored are made apart, and whatever happens to them is stored."""

import io
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from small_plan import RUN

from vprbench.cli import main
from vprbench.config import make_request
from vprbench.jobs import executors
from vprbench.jobs.job import JobResult, describe_failure
from vprbench.report.missing_runs import Cell, make_missing_runs
from vprbench.report.plan import Row
from vprbench.runs import experiment
from vprbench.runs.request import RunRequest
from vprbench.runs.store import Store

SAD = Row("SAD", "sad", training="none")
ROUTE = ["dataset=synthetic", "dataset.places=20", "dataset.first_query_place=4"]


def a_cell(row=SAD, seed=0, options=(), **values):
    given = {"seed": seed, "device": "cpu", **values}
    return Cell(row, "Journey", make_request([*ROUTE, *RUN, *options, f"method={row.method}"], given))


@pytest.fixture
def children(monkeypatch):
    """Let processes end in these ways, one after the other; returns the requests that they are asked."""

    def ending(*answers):
        asked, left = [], iter(answers)

        def run(text, *_):
            asked.append(RunRequest.from_json(text))
            return next(left)

        monkeypatch.setattr(executors, "run_in_child", run)
        return asked

    return ending


@pytest.fixture
def store(tmp_path):
    return Store(tmp_path / "results")


def test_what_is_missing_for_one_seed_is_sought_for_no_other(children, store):
    missing = JobResult(2, describe_failure(STORED.request, "weights are missing", True))  # of its first seed
    asked = children(missing, JobResult(0))
    endings = make_missing_runs([a_cell(seed=0), a_cell(seed=1), a_cell(Row("PCA", "pca"))], store)
    assert (endings, len(asked)) == ([missing, missing, JobResult(0)], 2)


def test_a_failure_of_one_seed_is_stored_and_does_not_stop_the_next(children, store):
    cells = [a_cell(seed=seed, results=str(store.root)) for seed in range(2)]
    children(JobResult(1, describe_failure(cells[0].request, "was ended by signal 9")), JobResult(0))
    assert [ending.code for ending in make_missing_runs(cells, store)] == [1, 0]
    (failure,) = store.failures()
    assert (failure.error, failure.missing, failure.config["seed"]) == ("was ended by signal 9", False, 0)
    assert main(["method=sad", *ROUTE, "seed=0", "timing=none", f"results={store.root}"]) == 0
    assert not [*store.failures()]  # the run takes its place


STORED = a_cell()


@pytest.mark.parametrize(
    ("cell", "other_code", "n_processes"),
    [
        (STORED, False, 0),
        (a_cell(seed=1), False, 1),
        *((a_cell(options=[each]), False, 1) for each in ("dataset.query_places=5", "dataset.protocol=nobody")),
        *((a_cell(options=[each]), False, 1) for each in ("timing.minimum_seconds=0.01", "force=true")),
        (STORED, True, 1),
    ],
)
def test_a_process_is_started_only_for_what_is_not_stored_as_it_would_be_made_now(
    made, monkeypatch, children, cell, other_code, n_processes
):
    asked = children(JobResult(0))
    if other_code:
        monkeypatch.setattr(experiment, "hash_code", lambda _: "other code")
    assert make_missing_runs([cell], Store(made[0] / "results")) == [JobResult(0)]
    assert len(asked) == n_processes


def test_frames_that_were_removed_are_kept_again_by_a_process(copied, children):
    shutil.rmtree("results/frames")
    asked = children(JobResult(0))
    without = replace(STORED, request=replace(STORED.request, frames=False))
    make_missing_runs([without], Store(Path("results")))
    assert asked == []
    make_missing_runs([STORED], Store(Path("results")))
    assert len(asked) == 1


def test_on_a_terminal_a_table_fills_with_what_is_stored_and_leaves_it_clean_if_it_is_interrupted(
    made, monkeypatch, tmp_path
):
    screen = io.StringIO()
    monkeypatch.setattr(screen, "isatty", lambda: True)
    monkeypatch.setattr(sys, "stderr", screen)
    monkeypatch.delenv("NO_COLOR", raising=False)
    for name, value in (("TERM", "xterm-256color"), ("COLUMNS", "100"), ("LINES", "30")):
        monkeypatch.setenv(name, value)

    def failing(*_):
        failed = describe_failure(STORED.request, "it failed")
        return JobResult(1, failed, lines=["note: a warning", "vprbench: it failed"])

    def interrupted(*_):
        raise KeyboardInterrupt(2)

    cells = [STORED, a_cell(Row("A row with a name that is longer than its column may be", "sad"), seed=1)]
    monkeypatch.setattr(executors, "run_in_child", failing)
    store = Store(tmp_path / "results")
    shutil.copytree(made[0] / "results", store.root)
    assert [ending.code for ending in make_missing_runs(cells, store)] == [0, 1]
    for text in ("note: a warning", "\x1b[31mvprbench: it failed", "done", "1 of 2, 1 running, 0 waiting"):
        assert text in screen.getvalue()
    monkeypatch.setattr(executors, "run_in_child", interrupted)
    with pytest.raises(KeyboardInterrupt):
        make_missing_runs(cells, store)
    assert screen.getvalue().rindex("\x1b[?25h") > screen.getvalue().rindex("\x1b[?25l")  # the cursor is there again
