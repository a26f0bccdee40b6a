"""Runs are made here or on a dask cluster, each ends once, and an interruption leaves nothing behind."""

import json
import os
import signal
import subprocess
import sys
import threading
import time

import pytest
from killed_worker import Kills

from vprbench import __version__, cli
from vprbench.config import make_request
from vprbench.errors import BadInput, ClusterLostError
from vprbench.jobs import executors
from vprbench.jobs import options as cluster_options
from vprbench.jobs.executors import Executor, choose_executor, choose_gpu, run_all
from vprbench.jobs.job import JobResult
from vprbench.jobs.options import ClusterOptions
from vprbench.plugins import entries
from vprbench.plugins.options import parse_options
from vprbench.runs.request import RunRequest
from vprbench.runs.run_lock import read_claims
from vprbench.runs.store import Store

RUN = ["method=sad", "dataset=synthetic", "dataset.places=12", "timing=none", "frames=false", "threads=1"]
NEEDS = "needs vprbench[cluster]"
SLOW = """import pathlib, time
from vprbench.methods.sad import SAD
class Slow(SAD):
    def fit(self, *_):
        pathlib.Path(__file__).with_name("begun").touch()
        time.sleep(60)
"""


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


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (["workers=0"], "workers=0: give at least 1"),
        (["scheduler=tcp://here:8786", "workers=2"], "leave workers= and cluster= out"),
    ],
)
def test_impossible_options_are_refused_by_name_and_a_single_run_takes_none(given, words, capsys):
    with pytest.raises(BadInput, match=words):
        parse_options(ClusterOptions, given)
    assert cli.main([*RUN, "workers=2"]) == 2
    assert "workers=2: " in capsys.readouterr().err


@pytest.mark.parametrize(
    ("given", "options", "threads"),
    [
        ([], [], []),
        (["workers=3"], [], ["threads=2"]),
        (["workers=9"], [], ["threads=1"]),
        (["workers=2"], ["threads=3"], []),
        (["scheduler=tcp://here:8786"], [], ["threads=1"]),
        (["cluster=pbs", "cluster.cores=6"], [], ["threads=6"]),
    ],
)
def test_each_cell_gets_its_share_of_the_cores_unless_threads_are_asked_for(given, options, threads, monkeypatch):
    monkeypatch.setattr(cluster_options, "count_cores", lambda: 8)
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
def test_an_interruption_ends_the_runs_of_workers(place, tmp_path, monkeypatch, request):
    monkeypatch.setattr(entries, "_LOOSE", {"method": {}, "dataset": {}})
    monkeypatch.delitem(sys.modules, "slow", raising=False)
    monkeypatch.setattr(sys, "path", [*sys.path])
    (tmp_path / "slow.py").write_text(SLOW)
    slow = make_request([*RUN[1:], f"method={tmp_path}/slow.py:Slow"], {"results": str(tmp_path / "results")})
    asked = {"workers": 2} if place == "workers" else {"scheduler": request.getfixturevalue("scheduler")}

    def interrupt():
        while not (tmp_path / "begun").exists():
            time.sleep(0.1)
        os.kill(os.getpid(), signal.SIGINT)

    threading.Thread(target=interrupt, daemon=True).start()
    began = time.monotonic()
    with pytest.raises(KeyboardInterrupt), choose_executor(ClusterOptions(**asked)) as executor:
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
