"""Cells are made here or on a cluster, each ends once, and a worker that dies costs what it was making alone."""

import subprocess
import sys

import pytest
from killed_worker import Kills

from vprbench import cli
from vprbench.cluster import crew as crews
from vprbench.cluster import options as cluster_options
from vprbench.cluster import sweep
from vprbench.cluster.cell import Order, make
from vprbench.cluster.crew import Crew
from vprbench.cluster.dask_crew import DaskCrew
from vprbench.cluster.gathered import Parcel, packed, unpack
from vprbench.cluster.options import ClusterOptions
from vprbench.errors import BadInput
from vprbench.plugins.options import chosen
from vprbench.run.processes import Ending
from vprbench.run.store import Store

RUN = ["method=sad", "dataset=synthetic", "dataset.places=12", "timing=none", "frames=false", "threads=1"]


def test_a_cell_is_asked_for_when_there_is_room_and_one_that_another_sweep_makes_is_asked_again_at_the_end(monkeypatch):
    asked = []
    held = iter([True, False])
    ends = iter([Ending(0), Ending(0, held="a lock"), Ending(1), Ending(0, key="of the other sweep")])
    monkeypatch.setattr(crews, "run_apart", lambda options, **_: asked.append(f"makes {options[0]}") or next(ends))
    monkeypatch.setattr(crews.run_lock, "is_held", lambda lock: next(held))
    monkeypatch.setattr(crews, "_LOOK_EVERY", 0.0)

    def cells():
        for number in range(3):
            asked.append(f"asks {number}")
            yield number, [str(number)]

    endings = [*Crew().endings(cells(), lambda *_: None)]
    assert endings == [(0, Ending(0)), (2, Ending(1)), (1, Ending(0, key="of the other sweep"))]
    assert asked == ["asks 0", "makes 0", "asks 1", "makes 1", "asks 2", "makes 2", "makes 1"]


@pytest.mark.parametrize(
    ("given", "told"),
    [
        (["workers=0"], "workers=0: give at least 1"),
        (["scheduler=tcp://here:8786", "workers=2"], "leave workers= and cluster= out"),
        (["gather=true"], "give workers=, scheduler= or cluster= too"),
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


def test_a_run_of_a_sweep_that_is_lost_with_its_workers_is_a_stored_failure(monkeypatch, tmp_path):
    class Lost(Crew):
        def endings(self, cells, *_):
            yield from ((number, Ending(1, error="its worker died on node7")) for number, _ in cells)

    monkeypatch.setattr(sweep, "crew", lambda *_, **__: Lost())
    assert sweep.swept([[*RUN, f"results={tmp_path}", "seed=3"]], ClusterOptions()) == 1
    (failure,) = Store(tmp_path).failures()
    assert (failure.method, failure.dataset, failure.error) == ("sad", "synthetic", "its worker died on node7")
    assert failure.config["seed"] == 3


@pytest.mark.extended
def test_workers_of_this_machine_make_cells_gather_them_and_make_up_for_those_that_die(tmp_path):
    results, begun = tmp_path / "results", []
    with DaskCrew(ClusterOptions(workers=2, gather=True)) as crew:
        cell = [*RUN, f"results={results}"]
        ((number, ending),) = crew.endings([(5, cell)], lambda number, host: begun.append(number))
        (once,) = crew.answers(Kills(tmp_path), [False], print)
        (always,) = crew.answers(Kills(tmp_path), [True], print)
    assert (number, ending.code, begun) == (5, 0, [5])
    (run,) = Store(results).runs()
    assert (run.method, run.key, run.environment["threads"]) == ("sad", ending.key, 1)
    assert not (results / ".locks").exists()
    assert once == (0, 2, "")
    assert (always[1], always[2][:12]) == (None, "KilledWorker")
    assert len([*(tmp_path / "True").iterdir()]) == 4  # it was tried again three times


def test_a_worker_of_another_version_makes_no_cell():
    order = Order("sweep", 0, (), "", shows=False, since=0.0, gather=False, version="0.0.1")
    with pytest.raises(BadInput, match=r"0\.0\.1"):
        make(order)


def test_the_runs_of_a_worker_are_packed_once_its_descriptors_stay_and_what_comes_back_damaged_is_not_stored(tmp_path):
    for name in ("synthetic/sad-1/run.json", "descriptors/abc/kept.npy", "frames/f.npz", ".locks/sad"):
        (tmp_path / name).parent.mkdir(parents=True)
        (tmp_path / name).write_bytes(name.encode())
    assert {*packed(tmp_path).files} == {"synthetic/sad-1/run.json", "frames/f.npz"}
    assert {*packed(tmp_path).files} == {"frames/f.npz"}
    assert (tmp_path / "descriptors/abc/kept.npy").exists()
    with pytest.raises(BadInput, match=r"synthetic/sad-1/run\.json"):
        unpack(Parcel({"synthetic/sad-1/run.json": (b"{}", "0" * 64)}), Store(tmp_path / "results"))
    assert not [*tmp_path.rglob("run.json")]
