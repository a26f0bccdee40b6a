"""Runs are made here or on a cluster, each ends once, and a worker that dies costs the run that it was making."""

import subprocess
import sys
import time
from types import SimpleNamespace

import pytest
from killed_worker import Kills
from little import a_run

from vprbench import cli
from vprbench.config import make_request
from vprbench.errors import BadInput
from vprbench.jobs import cluster, executors
from vprbench.jobs import options as cluster_options
from vprbench.jobs.cluster import DaskExecutor, pack_results, run_on_worker, unpack_results
from vprbench.jobs.executors import Executor, run_all
from vprbench.jobs.job import JobResult
from vprbench.jobs.options import ClusterOptions
from vprbench.plugins import entries
from vprbench.plugins.options import parse_options
from vprbench.runs.request import RunRequest
from vprbench.runs.run_lock import read_claims
from vprbench.runs.store import Store

RUN = ["method=sad", "dataset=synthetic", "dataset.places=12", "timing=none", "frames=false", "threads=1"]


def a_request(seed=0, **changes):
    return RunRequest("sad", {}, "journey", {"name": "journey"}, seed=seed, **changes)


def test_a_run_is_taken_when_there_is_room_and_a_run_that_another_sweep_makes_is_tried_again_last(monkeypatch):
    asked = []
    held = iter([True, False])
    ends = iter([JobResult(0), JobResult(0, held="a lock"), JobResult(1), JobResult(0, key="of the other sweep")])

    def run(request_json, _):
        asked.append(f"makes {RunRequest.from_json(request_json).seed}")
        return next(ends)

    monkeypatch.setattr(executors, "run_in_child", run)
    monkeypatch.setattr(executors.run_lock, "is_held", lambda lock: next(held))
    monkeypatch.setattr(executors, "_LOOK_EVERY", 0.0)

    def runs():
        for number in range(3):
            asked.append(f"asks {number}")
            yield number, a_request(number)

    results = [*run_all(Executor(), runs())]
    assert results == [(0, JobResult(0)), (2, JobResult(1)), (1, JobResult(0, key="of the other sweep"))]
    assert asked == ["asks 0", "makes 0", "asks 1", "makes 1", "asks 2", "makes 2", "makes 1"]


@pytest.mark.parametrize(
    ("given", "told"),
    [
        (["workers=0"], "workers=0: give at least 1"),
        (["scheduler=tcp://here:8786", "workers=2"], "leave workers= and cluster= out"),
    ],
)
def test_options_of_a_cluster_that_cannot_be_are_refused_by_name_and_a_single_run_takes_none(given, told, capsys):
    with pytest.raises(BadInput, match=told):
        parse_options(ClusterOptions, given, {})
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
    monkeypatch.setattr(cluster_options, "core_count", lambda: 8)
    assert parse_options(ClusterOptions, given, {}).threads(options) == threads


@pytest.mark.extended
def test_without_the_options_nothing_of_dask_is_imported(tmp_path):
    code = (
        f"import sys; from vprbench.cli import main; main({RUN}); print({{'dask', 'distributed'}} & {{*sys.modules}})"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "set()"


@pytest.mark.extended
@pytest.mark.parametrize("shared", [True, False])
def test_workers_of_this_machine_make_runs_bring_them_home_and_are_made_up_for_if_they_die(
    shared, tmp_path, monkeypatch
):
    results, begun = tmp_path / "results", []
    if not shared:  # no worker finds the results folder
        monkeypatch.setattr(cluster.DaskExecutor, "_probe", lambda *_: "/nowhere/probe")
    with DaskExecutor(ClusterOptions(workers=2)) as executor:
        request = make_request(RUN, {"results": str(results)})
        ((number, result),) = run_all(executor, [(5, request)], begun.append)
        functions = executor.of_functions()
        assert functions.submit(Kills(tmp_path), False).result() == 2
        with pytest.raises(Exception, match=r"died|kill") as error:
            functions.submit(Kills(tmp_path), True).result()
    assert (number, result.code, begun) == (5, 0, [5])
    (stored,) = Store(results).runs()
    assert (stored.method, stored.key, stored.environment["threads"]) == ("sad", result.key, 1)
    assert not [*results.rglob(".partial-*")]
    assert type(error.value).__name__ == "KilledWorker"
    assert len([*(tmp_path / "True").iterdir()]) == 4  # it was tried again three times


@pytest.mark.extended
def test_an_interruption_ends_the_runs_of_the_workers(tmp_path, monkeypatch):
    monkeypatch.setattr(entries, "_LOOSE", {"method": {}, "dataset": {}})
    text = "import time, pathlib\nfrom vprbench.methods.sad import SAD\nclass Slow(SAD):\n"
    text += f"    def fit(self, *_):\n        pathlib.Path(r'{tmp_path}/begun').touch()\n        time.sleep(60)\n"
    (tmp_path / "slow.py").write_text(text)
    request = make_request([*RUN[1:], f"method={tmp_path}/slow.py:Slow"], {"results": str(tmp_path / "results")})

    def interrupt():
        while not (tmp_path / "begun").exists():
            time.sleep(0.1)
        raise KeyboardInterrupt

    def run():
        with DaskExecutor(ClusterOptions(workers=1)) as executor:
            monkeypatch.setattr(executor, "require_cluster", interrupt)
            [*run_all(executor, [(0, request)])]

    began = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        run()
    assert time.monotonic() - began < 50
    assert [*Store(tmp_path / "results").runs()] == []
    assert read_claims(tmp_path / "results") == []


def test_a_worker_of_another_version_makes_no_run():
    with pytest.raises(BadInput, match=r"0\.0\.1"):
        run_on_worker("{}", "", "", "0.0.1")


def test_the_runs_of_a_worker_are_packed_once_and_unpacked_and_its_descriptors_stay(tmp_path):
    worker, client = Store(tmp_path / "worker"), Store(tmp_path / "client")
    worker.prepare()
    worker.save(a_run())
    for name in ("descriptors/abc/kept.npy", "frames/f.zip", ".locks/sad"):
        (worker.root / name).parent.mkdir(parents=True, exist_ok=True)
        (worker.root / name).write_bytes(name.encode())
    packed = pack_results(worker.root)
    assert [*worker.runs()] == []
    assert (worker.root / "descriptors/abc/kept.npy").exists()
    unpack_results(packed, client)
    assert [run.key for run in client.runs()] == [a_run().key]
    assert (client.root / "frames/f.zip").read_bytes() == b"frames/f.zip"
    assert {path.name for path in client.root.iterdir()} == {"journey", "frames"}


def test_runs_on_a_gpu_take_those_of_the_machine_in_turn(monkeypatch):
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "GPU-a,GPU-b")
    seen = [cluster._gpu_of(SimpleNamespace(name=name)) for name in (0, 1, 2, "tcp://elsewhere")]
    assert seen == [{"CUDA_VISIBLE_DEVICES": f"GPU-{name}"} for name in "aba"] + [{}]
