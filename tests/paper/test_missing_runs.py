"""Runs that are wanted and not stored are made apart, and whatever happens to them is stored."""

import io
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from small_plan import RUN

from vprbench.cli import main
from vprbench.jobs import executors
from vprbench.jobs.job import JobResult
from vprbench.paper import missing_runs, stored_runs
from vprbench.paper.missing_runs import MissingRun
from vprbench.paper.plan import Row
from vprbench.runs.compose import composed
from vprbench.runs.store import Store

SAD = Row("SAD", "sad", training="none")
ROUTE = ("dataset=synthetic", "dataset.places=20", "dataset.first_query_place=4")


def a_wish(row=SAD, seed=0, **changes):
    of_data = {"title": "Journey", "dataset_options": ROUTE[:2], "dataset": {"name": "synthetic", "places": 20}}
    given = {"row": row, "seed": seed, "device": "cpu", "arguments": dict(row.arguments), **of_data}
    return MissingRun(**{**given, **changes})


def fill(wishes, store, options=()):
    return missing_runs.fill(wishes, options, store, lambda options: composed(list(options)))


@pytest.fixture
def children(monkeypatch):
    """Let processes end in these ways, one after the other; returns the options that they are asked with."""

    def ending(*answers):
        asked = []
        left = list(answers)
        monkeypatch.setattr(executors, "run_job", lambda options, **_: asked.append(list(options)) or left.pop(0))
        return asked

    return ending


@pytest.fixture
def store(tmp_path):
    return Store(tmp_path / "results")


def test_a_run_is_asked_for_by_its_options_and_one_without_its_method_is_a_failure_without_a_process(children, store):
    asked = children(JobResult(0))
    row = Row("Big patches", "sad", arguments={"patch": 14, "preprocessing": "A"})
    assert fill([a_wish(row, seed=3)], store, ["threads=1"]) == [JobResult(0)]
    of_method = ["method=sad", "method.patch=14", 'method.preprocessing="A"']
    assert asked == [[*ROUTE[:2], *of_method, "seed=3", "device=cpu", "threads=1", f"results={store.root}"]]
    asked = children()
    row = Row("Nothing", "no_such_method", seeds=(0, 1))
    endings = fill([a_wish(row, 0), a_wish(row, 1)], store)
    assert [(ending.code, ending.missing) for ending in endings] == [(2, True), (2, True)]
    (failure,) = store.failures()
    assert (failure.method, failure.dataset, failure.missing) == ("no_such_method", "synthetic", True)
    assert "no_such_method" in failure.error
    assert fill([a_wish(Row("HOG", "hog"), device="cuda")], store) == [JobResult(0)]  # it knows no device
    assert asked == []


def test_weights_that_are_missing_are_looked_for_once_and_without_a_process(monkeypatch, children, store, tmp_path):
    monkeypatch.setenv("VPRBENCH_WEIGHTS", str(tmp_path))
    asked = children(JobResult(0))
    row = Row("GCL", "gcl", arguments={"backbone": "vgg16"}, training="pretrained")
    wishes = [a_wish(row), a_wish(row, title="Street", dataset={"name": "street", "places": 20})]
    assert [(ending.code, ending.missing) for ending in fill(wishes, store)] == [(2, True)] * 2
    told = {(each.dataset, each.missing, "MSLS_vgg16_GeM_480_GCL.pth" in each.error) for each in store.failures()}
    assert told == {("synthetic", True, True), ("street", True, True)}
    assert asked == []
    (tmp_path / "MSLS_vgg16_GeM_480_GCL.pth").write_bytes(b"what is in it is for the process to see")
    assert fill(wishes[:1], store) == [JobResult(0)]
    assert len(asked) == 1
    missing = JobResult(2, True, "weights are missing", recorded=True)  # as a process tells of its first seed
    asked = children(missing, JobResult(0))
    endings = fill([a_wish(seed=0), a_wish(seed=1), a_wish(Row("PCA", "pca"))], store)
    assert (endings, len(asked)) == ([missing, missing, JobResult(0)], 2)


def test_a_failure_of_one_seed_does_not_stop_the_next_and_is_stored_unless_the_process_did(children, store):
    diverged, killed = JobResult(1, False, "it diverged", recorded=True), JobResult(1, False, "was ended by signal 9")
    children(diverged, killed, JobResult(0))
    endings = fill([a_wish(seed=seed) for seed in range(3)], store, ROUTE[2:])
    assert [(ending.code, ending.recorded) for ending in endings] == [(1, True), (1, True), (0, False)]
    (failure,) = store.failures()
    assert (failure.error, failure.missing, failure.config["seed"]) == ("was ended by signal 9", False, 1)
    assert main([*a_wish(seed=1).options(), *ROUTE[2:], "timing=none", f"results={store.root}"]) == 0
    assert not [*store.failures()]  # the run takes its place


STORED = a_wish(dataset_options=ROUTE)


@pytest.mark.parametrize(
    ("wish", "options", "patched", "n_processes"),
    [
        (STORED, [], {}, 0),
        (a_wish(seed=1, dataset_options=ROUTE), [], {}, 1),
        (a_wish(dataset_options=ROUTE, arguments={"patch": 14}), [], {}, 1),
        (a_wish(dataset_options=(*ROUTE, "dataset.query_places=5")), [], {}, 1),
        (a_wish(dataset_options=(*ROUTE, "dataset.protocol=nobody")), [], {}, 1),
        (STORED, ["timing.minimum_seconds=0.01"], {}, 1),
        (STORED, ["force=true"], {}, 1),
        (STORED, [], {"code_hash_of": "other code"}, 1),
        (STORED, [], {"code_hash_of": None}, 1),
        (STORED, [], {"fingerprint": "other frames"}, 1),
    ],
)
def test_a_process_is_started_only_for_what_is_not_stored_as_it_would_be_made_now(
    made, monkeypatch, children, wish, options, patched, n_processes
):
    asked = children(JobResult(0))
    for name, value in patched.items():
        monkeypatch.setattr(stored_runs, name, lambda _, value=value: value)
    assert fill([wish], Store(made[0] / "results"), [*RUN, *options]) == [JobResult(0)]
    assert len(asked) == n_processes


def test_frames_that_were_removed_are_kept_again_by_a_process(copied, children):
    shutil.rmtree("results/frames")
    assert missing_runs.results_folder("mine") == Path.cwd() / "mine"  # which a process elsewhere finds, too
    asked = children(JobResult(0))
    fill([STORED], Store(Path("results")), [*RUN, "frames=false"])
    assert asked == []
    fill([STORED], Store(Path("results")), RUN)
    assert len(asked) == 1


@pytest.mark.extended
def test_a_table_of_stored_runs_imports_no_torch(copied):
    code = """
import sys
from pathlib import Path
from vprbench.jobs import executors
from vprbench.paper import gather
from vprbench.paper.plan import read_plan
from vprbench.cli import main
gather.read_plan = lambda _: read_plan(Path("plan.yaml"))
executors.run_job = None
code = main(["table", "rows=[SAD]", "devices=[cpu]", *sys.argv[1:]])
sys.exit("torch" if "torch" in sys.modules else code)
"""
    done = subprocess.run([sys.executable, "-c", code, *RUN], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_on_a_terminal_a_table_fills_with_what_is_stored_and_leaves_it_clean_if_it_is_interrupted(made, monkeypatch):
    screen = io.StringIO()
    monkeypatch.setattr(screen, "isatty", lambda: True)
    monkeypatch.setattr(sys, "stderr", screen)
    monkeypatch.delenv("NO_COLOR", raising=False)
    for name, value in (("TERM", "xterm-256color"), ("COLUMNS", "100"), ("LINES", "30")):
        monkeypatch.setenv(name, value)

    def failing(_, heard, **__):
        for line in ("note: a warning", "vprbench: it failed"):
            heard(line)
        return JobResult(1, False, "it failed", recorded=True)

    def interrupted(*_, **__):
        raise KeyboardInterrupt(2)

    wishes = [STORED, a_wish(Row("A row with a name that is longer than its column may be", "sad"), seed=1)]
    monkeypatch.setattr(executors, "run_job", failing)
    assert [ending.code for ending in fill(wishes, Store(made[0] / "results"), RUN)] == [0, 1]
    for text in ("note: a warning", "\x1b[31mvprbench: it failed", " %  ", " Hz", "1 of 2, 1 running, 0 waiting"):
        assert text in screen.getvalue()
    monkeypatch.setattr(executors, "run_job", interrupted)
    with pytest.raises(KeyboardInterrupt):
        fill(wishes, Store(made[0] / "results"), RUN)
    assert screen.getvalue().rindex("\x1b[?25h") > screen.getvalue().rindex("\x1b[?25l")  # the cursor is there again
