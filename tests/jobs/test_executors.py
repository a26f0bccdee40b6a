"""Runs are made here or on a dask cluster, each in a process that leaves nothing behind; each death is told."""

import importlib.util
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import psutil
import pytest
from checkout import ROOT
from killed_worker import Kills
from plugged_in import forget_loose_files

from vprbench import __version__, cli
from vprbench.config import make_request
from vprbench.errors import BadInput, ClusterLostError
from vprbench.jobs import child, executors
from vprbench.jobs import options as cluster_options
from vprbench.jobs.executors import Executor, choose_executor, choose_gpu, run_all
from vprbench.jobs.job import JobResult, describe_failure
from vprbench.jobs.options import ClusterOptions
from vprbench.plugins.options import parse_options
from vprbench.runs.request import RunRequest
from vprbench.runs.run_lock import read_claims
from vprbench.runs.store import Store

RUN = ["method=sad", "dataset=synthetic", "dataset.places=12", "timing=none", "frames=false", "threads=1"]
NEEDS = "needs vprbench[cluster]"
HEAD = """import ctypes, os, pathlib, signal, subprocess, sys, time
from vprbench.methods.sad import SAD

class Mine(SAD):
    def fit(self, *given):
"""
SLEEPER = "pathlib.Path('sleeper').write_text(str(subprocess.Popen(['sleep', '60']).pid)); "


@pytest.fixture
def asked(tmp_path, monkeypatch):
    """Return a function that asks for a run of SAD whose `fit` executes a statement first."""
    forget_loose_files(monkeypatch)
    monkeypatch.delitem(sys.modules, "mine", raising=False)
    monkeypatch.chdir(tmp_path)

    def asked(statement, **options):
        Path("mine.py").write_text(f"{HEAD}        {statement}\n        return super().fit(*given)\n")
        return make_request([*RUN[1:], "method=./mine.py:Mine"], {"results": str(tmp_path / "results"), **options})

    return asked


@pytest.fixture
def run(asked):
    """Return a function that makes such a run in a child."""

    def run(statement, *arguments, **options):
        return child.run_in_child(asked(statement, **options).to_json(), *arguments)

    return run


def is_running(pid_file):
    """Tell whether the process of a file still runs; it has a moment to end."""
    until = time.monotonic() + 5
    while psutil.pid_exists(pid := int(Path(pid_file).read_text())) and time.monotonic() < until:
        if psutil.Process(pid).status() == psutil.STATUS_ZOMBIE:
            return False
        time.sleep(0.05)
    return psutil.pid_exists(pid)


@pytest.fixture(scope="module")
def scheduler():
    """Return the address of a dask cluster of two workers, which restarts those that die."""
    distributed = pytest.importorskip("distributed", reason=NEEDS)
    sizes = {"n_workers": 2, "threads_per_worker": 1, "memory_limit": 0}
    with distributed.LocalCluster(dashboard_address=":0", silence_logs=50, **sizes) as cluster:
        yield cluster.scheduler_address


def test_a_run_is_taken_when_there_is_room_and_a_run_that_another_sweep_makes_is_tried_again_last(monkeypatch):
    asked = []
    held = iter([True, False])
    ends = iter([JobResult(0), JobResult(0, lock="a lock"), JobResult(1), JobResult(0, key="of the other sweep")])

    def run(request_json, _):
        asked.append(f"makes {json.loads(request_json)['seed']}")
        return next(ends)

    monkeypatch.setattr(executors, "run_in_child", run)
    monkeypatch.setattr(executors.run_lock, "is_held", lambda lock: next(held))
    monkeypatch.setattr(executors, "_LOOK_EVERY", 0.0)

    def runs():
        for number in range(3):
            asked.append(f"asks {number}")
            yield number, RunRequest("sad", {}, "journey", {"name": "journey"}, seed=number)

    results = [*run_all(Executor(), runs())]
    assert results == [(0, JobResult(0)), (2, JobResult(1)), (1, JobResult(0, key="of the other sweep"))]
    assert asked == ["asks 0", "makes 0", "asks 1", "makes 1", "asks 2", "makes 2", "makes 1"]


def test_impossible_options_are_refused_by_name_and_a_single_run_takes_none(capsys):
    for given, words in (
        (["workers=0"], "workers=0: give at least 1"),
        (["scheduler=tcp://here:8786", "workers=2"], "leave workers= and cluster= out"),
    ):
        with pytest.raises(BadInput, match=words):
            parse_options(ClusterOptions, given)
    assert cli.main([*RUN, "workers=2"]) == 2
    assert "workers=2: " in capsys.readouterr().err


def test_each_cell_gets_its_share_of_the_cores_unless_threads_are_asked_for(monkeypatch):
    monkeypatch.setattr(cluster_options, "count_cores", lambda: 8)
    for given, options, threads in (
        ([], [], []),
        (["workers=3"], [], ["threads=2"]),
        (["workers=9"], [], ["threads=1"]),
        (["workers=2"], ["threads=3"], []),
        (["scheduler=tcp://here:8786"], [], ["threads=1"]),
        (["cluster=pbs", "cluster.cores=6"], [], ["threads=6"]),
    ):
        assert parse_options(ClusterOptions, given).threads(options) == threads


def test_workers_make_runs_side_by_side_without_dask(tmp_path):
    command = ["-m", *RUN, "seed=0,1,2", "workers=2", f"results={tmp_path}", "output=json"]
    code = f"import sys; sys.modules['distributed'] = None; from vprbench.cli import main; sys.exit(main({command}))"
    done = subprocess.run([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, check=True)
    assert {json.loads(line)["method"] for line in done.stdout.splitlines()} == {"sad"}
    assert {run.config["seed"] for run in Store(tmp_path).runs()} == {0, 1, 2}


@pytest.mark.extended
def test_workers_of_dask_make_runs_on_the_disk_that_they_share(scheduler, tmp_path):
    results, begun = tmp_path / "results", []
    with choose_executor(ClusterOptions(scheduler=scheduler)) as executor:
        request = make_request(RUN, {"results": str(results)})
        ((number, result),) = run_all(executor, [(5, request)], begun.append)
    assert (number, result.code, begun) == (5, 0, [5])
    (stored,) = Store(results).runs()
    assert (stored.method, stored.key, stored.environment["threads"]) == ("sad", result.key, 1)
    assert not [*results.rglob(".partial-*")]


@pytest.mark.extended
def test_a_worker_that_dies_is_made_up_for_three_times(scheduler, tmp_path):
    with choose_executor(ClusterOptions(scheduler=scheduler)) as executor:
        functions = executor.open_pool()
        assert functions.submit(Kills(tmp_path), False).result() == 2
        result = executor.collect(make_request(RUN), functions.submit(Kills(tmp_path), True))
    assert (result.code, "4 times" in result.failure.error) == (1, True)
    assert len([*(tmp_path / "True").iterdir()]) == 4


@pytest.mark.extended
def test_a_scheduler_that_is_gone_is_one_line(tmp_path):
    distributed = pytest.importorskip("distributed", reason=NEEDS)
    with distributed.LocalCluster(n_workers=1, dashboard_address=":0", silence_logs=50) as cluster:
        executor = choose_executor(ClusterOptions(scheduler=cluster.scheduler_address))
        made = executor.open_pool().submit(time.sleep, 60)
    with executor, pytest.raises(ClusterLostError, match="give the same command again"):
        executor.collect(make_request(RUN), made)


@pytest.mark.parametrize("place", ["workers", pytest.param("scheduler", marks=pytest.mark.extended)])
def test_an_interruption_ends_the_runs_of_workers(place, asked, tmp_path, request):
    slow = asked("pathlib.Path(__file__).with_name('begun').touch(); time.sleep(60)")
    where = {"workers": 2} if place == "workers" else {"scheduler": request.getfixturevalue("scheduler")}

    def interrupt():
        while not Path("begun").exists():
            time.sleep(0.1)
        os.kill(os.getpid(), signal.SIGINT)

    threading.Thread(target=interrupt, daemon=True).start()
    began = time.monotonic()
    with pytest.raises(KeyboardInterrupt), choose_executor(ClusterOptions(**where)) as executor:
        [*run_all(executor, [(0, slow)])]
    while read_claims(tmp_path / "results") and time.monotonic() - began < 40:
        time.sleep(0.1)
    assert read_claims(tmp_path / "results") == []
    assert [*Store(tmp_path / "results").runs()] == []


def test_a_worker_of_another_version_or_disk_makes_no_run(tmp_path):
    cluster = pytest.importorskip("vprbench.jobs.cluster", reason=NEEDS)
    probe = tmp_path / "elsewhere" / "probe"
    with pytest.raises(BadInput, match=r"0\.0\.1"):
        cluster.run_on_worker("{}", tmp_path, probe, "0.0.1")
    with pytest.raises(BadInput, match=f"does not share {probe.parent}"):
        cluster.run_on_worker("{}", tmp_path, probe, __version__)


def test_runs_on_a_gpu_take_those_of_the_machine_in_turn(monkeypatch):
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "GPU-a,GPU-b")
    assert [choose_gpu(worker)["CUDA_VISIBLE_DEVICES"] for worker in range(3)] == ["GPU-a", "GPU-b", "GPU-a"]


def test_a_run_is_stored_its_prints_are_passed_on_and_nothing_of_its_process_stays(run, tmp_path, monkeypatch):
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    child.start_server()  # whose socket lies in the usual folder
    monkeypatch.setattr(tempfile, "tempdir", str(temporary))
    monkeypatch.setenv("HEARD", "by environment")
    prints = "print('one', os.environ['HEARD']); os.write(1, b'compiled\\n'); os.write(2, b'rest\\n'); "
    result = run(prints + SLEEPER + "os.fork() or time.sleep(60)", False, seed=3)
    assert result.code == 0
    (stored,) = Store(tmp_path / "results").runs()
    assert (stored.key, stored.config["seed"]) == (result.key, 3)
    assert {"one by environment", "compiled", "rest"} <= {*result.lines}
    assert [*temporary.iterdir()] == []
    assert not is_running("sleeper")


@pytest.mark.parametrize(
    ("statement", "words"),
    [
        ("print('no room'); sys.stdout.flush(); os._exit(3)", "exit code 3: no room"),
        ("sys.exit('enough')", "SystemExit"),
        ("ctypes.string_at(0)", "signal 11 (SIGSEGV): File"),
        ("os.kill(os.getpid(), signal.SIGKILL)", "signal 9 (SIGKILL)"),
        ("raise ValueError('no')", "ValueError: no"),
    ],
)
def test_a_process_that_dies_is_one_failure_with_its_exit_code_or_signal_and_its_last_line(
    run, statement, words, tmp_path, capfd
):
    result = run(statement)
    assert (result.code, result.key, words in result.failure.error) == (1, "", True), result.failure
    assert capfd.readouterr().err.count("\nvprbench: ") == 1
    assert [*Store(tmp_path / "results").runs()] == []


def test_a_process_is_ended_at_its_limit_with_its_children_and_frees_its_lock(run, tmp_path):
    assert "limit_minutes=0.05" in run(SLEEPER + "time.sleep(60)", limit_minutes=0.05).failure.error
    assert not (Path("sleeper").exists() and is_running("sleeper"))  # a slow machine may not get so far in 3 s
    assert read_claims(tmp_path / "results") == []


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_an_interruption_of_this_process_ends_the_child_too(run, number):
    def interrupt(*_):
        raise KeyboardInterrupt(number)

    def kill_once_begun():
        while not Path("sleeper").exists():
            time.sleep(0.05)
        os.kill(os.getpid(), number)

    before = signal.signal(number, interrupt)
    threading.Thread(target=kill_once_begun, daemon=True).start()
    try:
        with pytest.raises(KeyboardInterrupt) as ended:
            run(SLEEPER + "time.sleep(60)")
    finally:
        signal.signal(number, before)
    assert ended.value.args == (number,)
    assert not is_running("sleeper")


@pytest.mark.parametrize("statement", ["", "signal.signal(2, signal.SIG_IGN); "])
def test_a_run_that_is_stopped_is_interrupted_and_killed_if_it_does_not_end(run, statement, monkeypatch):
    monkeypatch.setattr(child, "_PATIENCE", 2.0)
    with pytest.raises(KeyboardInterrupt):
        run(statement + SLEEPER + "time.sleep(60)", True, Path("sleeper").exists)
    assert not is_running("sleeper")


def test_a_sweep_makes_a_request_for_each_combination_and_stores_a_run_whose_process_dies_as_a_failure(
    tmp_path, monkeypatch, capsys
):
    asked = []

    def die(text, _):
        asked.append(RunRequest.from_json(text))
        return JobResult(1, describe_failure(asked[-1], "was ended by signal 7"))

    monkeypatch.setattr(executors, "run_in_child", die)
    monkeypatch.chdir(tmp_path)
    options = ["method.max_module=921", "-m", "seed=0,1", "dataset=folders", "dataset.references=[a,b]", "output=json"]
    assert cli.main(["method=vprtempo,vprtempo_int8", *options]) == 1
    wanted = [(method, seed) for method in ("vprtempo", "vprtempo_int8") for seed in (0, 1)]
    assert [(request.method_name, request.seed) for request in asked] == wanted
    assert all(request.changed == {"max_module": 921} for request in asked)
    assert all(request.dataset["references"] == ["a", "b"] for request in asked)
    stored = [*Store(tmp_path / "results").failures()]
    assert sorted((failure.method, failure.config["seed"]) for failure in stored) == wanted
    told = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [row["error"] for row in told] == ["was ended by signal 7"] * 4 == [failure.error for failure in stored]


def test_every_module_that_the_warm_process_imports_is_there():
    # The server passes over a module that cannot be imported, and each run would import it again.
    assert [name for name in child._PRELOADED if importlib.util.find_spec(name) is None] == []


PROGRAM = """
import os, runpy, sys

class Interrupting:
    def find_spec(self, name, path=None, target=None):
        if name == {module!r}:
            exec("os.kill(os.getpid(), {number})")  # as named tuples and dataclasses run code

sys.meta_path.insert(0, Interrupting())
sys.argv[0] = "vprbench"
runpy.run_module("vprbench", run_name="__main__", alter_sys=True)
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("module", ["vprbench.errors", "torch"])
def test_a_signal_while_modules_are_imported_ends_the_command_in_one_line(module, number, tmp_path):
    code = PROGRAM.format(module=module, number=int(number))
    command = [sys.executable, "-c", code, "method=sad", f"results={tmp_path}", "dataset.places=12"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stdout) == (128 + number, "")
    assert [line[:21] for line in done.stderr.splitlines()] == ["vprbench: interrupted"]
