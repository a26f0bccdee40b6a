"""Runs are made here or on a cluster, each ends once, and a worker that dies costs the run that it was making."""

import subprocess
import sys
from pathlib import Path

import pytest
from killed_worker import Kills
from little import a_failure, a_run

from vprbench import cli
from vprbench.errors import BadInput
from vprbench.jobs import executors
from vprbench.jobs import options as cluster_options
from vprbench.jobs.dask_executor import DaskExecutor
from vprbench.jobs.executors import Callbacks, SerialExecutor, run_all
from vprbench.jobs.job import JobResult
from vprbench.jobs.options import ClusterOptions
from vprbench.jobs.worker import RemoteJob, make, put_in, taken_out
from vprbench.plugins.options import chosen
from vprbench.runs.store import Store
from vprbench.tuning.workers import Answer, Workers

RUN = ["method=sad", "dataset=synthetic", "dataset.places=12", "timing=none", "frames=false", "threads=1"]


def test_a_run_is_asked_for_when_there_is_room_and_a_run_that_another_sweep_makes_is_asked_again_last(
    monkeypatch,
):
    asked = []
    held = iter([True, False])
    ends = iter([JobResult(0), JobResult(0, held="a lock"), JobResult(1), JobResult(0, key="of the other sweep")])
    monkeypatch.setattr(executors, "run_job", lambda options, **_: asked.append(f"makes {options[0]}") or next(ends))
    monkeypatch.setattr(executors.run_lock, "is_held", lambda lock: next(held))
    monkeypatch.setattr(executors, "_LOOK_EVERY", 0.0)

    def runs():
        for number in range(3):
            asked.append(f"asks {number}")
            yield number, [str(number)]

    results = [*run_all(SerialExecutor(), runs())]
    assert results == [(0, JobResult(0)), (2, JobResult(1)), (1, JobResult(0, key="of the other sweep"))]
    assert asked == ["asks 0", "makes 0", "asks 1", "makes 1", "asks 2", "makes 2", "makes 1"]


@pytest.mark.parametrize(
    ("given", "told"),
    [
        (["workers=0"], "workers=0: give at least 1"),
        (["scheduler=tcp://here:8786", "workers=2"], "leave workers= and cluster= out"),
        (["cluster=torque"], "cluster=torque: .*slurm"),
        (["cluster=slurm", "cluster.core=4"], "option cluster.core is unknown: .*cores"),
        (["cluster=slurm", "cluster.cores=many"], "cluster.cores=many: wanted an integer"),
    ],
)
def test_options_of_a_cluster_that_cannot_be_are_refused_by_name_and_a_single_run_takes_none(given, told, capsys):
    with pytest.raises(BadInput, match=told):
        chosen(ClusterOptions, given, {})
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
    assert chosen(ClusterOptions, given, {}).threads(options) == threads


def test_a_yaml_of_ones_own_and_the_command_line_say_what_a_job_is(tmp_path):
    path = tmp_path / "ours.yaml"
    path.write_text("system: pbs\nqueue: long\ncores: 2\nmaximum: 30\n")
    job = chosen(ClusterOptions, [f"cluster={path}", "cluster.cores=8", "workers=5"], {}).job()
    assert (job.system, job.queue, job.cores, job.maximum) == ("pbs", "long", 8, 5)


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
    monkeypatch.setattr(Path, "touch", Path.touch if shared else lambda *_: None)  # no worker finds the results folder
    with DaskExecutor(ClusterOptions(workers=2)) as executor:
        run = [*RUN, f"results={results}"]
        ((number, result),) = run_all(executor, [(5, run)], Callbacks(lambda number, host: begun.append(number)))
        monkeypatch.undo()
        with Workers(Kills(tmp_path), 1, executor.of_functions) as workers:
            (once,) = workers.answers([False], print)
            (always,) = workers.answers([True], print)
    assert (number, result.code, begun) == (5, 0, [5])
    (stored,) = Store(results).runs()
    assert (stored.method, stored.key, stored.environment["threads"]) == ("sad", result.key, 1)
    assert [path.name for path in results.iterdir()] == ["synthetic"]
    assert once == Answer(0, 2)
    assert (always.given, always.error[:12]) == (None, "KilledWorker")
    assert len([*(tmp_path / "True").iterdir()]) == 4  # it was tried again three times


def test_a_worker_of_another_version_makes_no_run():
    order = RemoteJob("sweep", 0, (), "", shared="", version="0.0.1")
    with pytest.raises(BadInput, match=r"0\.0\.1"):
        make(order)


def test_the_runs_of_a_worker_are_taken_out_once_and_put_in_and_its_descriptors_stay(tmp_path):
    worker, client = Store(tmp_path / "worker"), Store(tmp_path / "client")
    worker.prepare()
    worker.save(a_run())
    worker.save_failure(a_failure(error="no"))
    for name in ("descriptors/abc/kept.npy", "frames/f.npz", ".locks/sad"):
        (worker.root / name).parent.mkdir(parents=True, exist_ok=True)
        (worker.root / name).write_bytes(name.encode())
    files = taken_out(worker.root)
    assert {name.partition("/")[0] for name in files} == {"journey", "frames"}
    assert {*taken_out(worker.root)} == {"frames/f.npz"}
    assert (worker.root / "descriptors/abc/kept.npy").exists()
    put_in(files, client)
    assert [run.key for run in client.runs()] == [a_run().key]
    assert (client.root / "frames/f.npz").read_bytes() == b"frames/f.npz"
