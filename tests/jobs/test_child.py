"""A run in a process of its own: it leaves nothing behind, and each death is a failure that names it."""

import importlib.util
import json
import os
import signal
import sys
import tempfile
import threading
import time
from pathlib import Path

import psutil
import pytest

from vprbench import cli
from vprbench.config import make_request
from vprbench.jobs import child, executors
from vprbench.jobs.job import JobResult, describe_failure
from vprbench.plugins import entries
from vprbench.runs.request import RunRequest
from vprbench.runs.run_lock import read_claims
from vprbench.runs.store import Store

RUN = ["dataset=synthetic", "dataset.places=12", "timing=none", "frames=false", "threads=1"]
HEAD = """import ctypes, os, pathlib, signal, subprocess, sys, time
from vprbench.methods.sad import SAD

class Mine(SAD):
    def fit(self, *given):
"""
SLEEPER = "pathlib.Path('sleeper').write_text(str(subprocess.Popen(['sleep', '60']).pid)); "


@pytest.fixture
def run(tmp_path, monkeypatch):
    """Return a function that makes a run of SAD in a child whose `fit` executes a statement first."""
    monkeypatch.setattr(entries, "_LOOSE", {"method": {}, "dataset": {}})
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.delitem(sys.modules, "mine", raising=False)
    monkeypatch.chdir(tmp_path)

    def run(statement, *arguments, **options):
        Path("mine.py").write_text(f"{HEAD}        {statement}\n        return super().fit(*given)\n")
        request = make_request([*RUN, "method=./mine.py:Mine"], {"results": str(tmp_path / "results"), **options})
        return child.run_in_child(request.to_json(), *arguments)

    return run


def is_running(pid_file):
    """Tell whether the process of a file still runs; it has a moment to end."""
    until = time.monotonic() + 5
    while psutil.pid_exists(pid := int(Path(pid_file).read_text())) and time.monotonic() < until:
        if psutil.Process(pid).status() == psutil.STATUS_ZOMBIE:
            return False
        time.sleep(0.05)
    return psutil.pid_exists(pid)


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


def test_of_several_runs_a_bad_one_is_refused_before_any_is_made(monkeypatch, capsys):
    monkeypatch.setattr(executors, "run_in_child", lambda *_: pytest.fail("it ran"))
    assert cli.main(["-m", "method=vprtempo,sad", "method.rules=paper"]) == 2
    assert "method.rules is unknown to sad" in capsys.readouterr().err


def test_every_module_that_the_warm_process_imports_is_there():
    # The server passes over a module that cannot be imported, and each run would import it again.
    assert [name for name in child._PRELOADED if importlib.util.find_spec(name) is None] == []
