"""Jobs of batch systems: each yaml of conf/cluster makes dask-jobqueue submit what it and the command line ask for."""

import gc
import os
import shlex
import signal
import sys

import pytest

from vprbench.errors import BadInput
from vprbench.jobs.options import ClusterOptions
from vprbench.plugins.options import parse_options

cluster = pytest.importorskip("vprbench.jobs.cluster", reason="needs vprbench[cluster]")
ASKED = ["cluster.cores=6", "cluster.memory=32GiB", "cluster.queue=long"]
WANTED = {  # as the manuals of sbatch, qsub (OpenPBS), bsub and qsub (Grid Engine) have them
    "slurm": ["#SBATCH -p long", "#SBATCH --cpus-per-task=6", "#SBATCH --mem=32G", "#SBATCH -t 24:00:00"],
    "pbs": ["#PBS -q long", "#PBS -l select=1:ncpus=6:mem=32GB", "#PBS -l walltime=24:00:00"],
    "lsf": ["#BSUB -q long", "#BSUB -n 6", "#BSUB -W 24:00"],
    "sge": ["#$ -q long", "#$ -l h_rt=24:00:00"],
}


@pytest.fixture(autouse=True)
def batch_systems(tmp_path, monkeypatch):
    """Let the commands of all systems take any script, and keep it."""
    keep = f'cat "$@" >{tmp_path}/submitted; echo "Submitted batch job 1; Job <1> is submitted; 1.host"'
    commands = dict.fromkeys(("sbatch", "qsub", "bsub"), keep) | dict.fromkeys(("scancel", "qdel", "bkill"), ":")
    for command, does in commands.items():
        program = tmp_path / "bin" / command
        program.parent.mkdir(exist_ok=True)
        program.write_text(f"#!/bin/sh\n{does}\n")
        program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}/bin", prepend=os.pathsep)
    monkeypatch.chdir(tmp_path)


def start(*given):
    return cluster.start_jobs(parse_options(ClusterOptions, given).job_arguments(), 3)


@pytest.mark.parametrize("system", WANTED)
def test_a_script_asks_its_system_for_the_fields_of_its_yaml_and_begins_one_worker(system, tmp_path):
    more = ["cluster.job_extra_directives=[--one-more=a:1]", "cluster.job_script_prologue=[module load cuda]"]
    handler = signal.getsignal(signal.SIGINT)
    with start(f"cluster={system}", *ASKED, *more):
        assert signal.getsignal(signal.SIGINT) is handler  # dask_jobqueue brings one of its own
        lines = (tmp_path / "submitted").read_text().splitlines()
    head = WANTED[system][0].split(" ")[0]
    assert not [line for line in [*WANTED[system], f"{head} --one-more=a:1"] if line not in lines], lines
    *_, prologue, worker = [line for line in lines if line and not line.startswith("#")]
    assert prologue == "module load cuda"
    words = shlex.split(worker)
    assert words[0] == sys.executable
    assert words[-1 - words[::-1].index("--nthreads") + 1] == "1"  # of several the last one counts


def test_a_yaml_of_ones_own_names_any_class_of_dask_jobqueue_and_workers_bounds_the_jobs(tmp_path):
    (tmp_path / "ours.yaml").write_text("_target_: dask_jobqueue.PBSCluster\ncores: 2\nmemory: 4GiB\nqueue: night\n")
    options = parse_options(ClusterOptions, ["cluster=./ours.yaml", "cluster.cores=8", "workers=5"])
    assert (cluster.DaskExecutor(options).count_slots(), options.threads([])) == (5, ["threads=8"])
    with cluster.start_jobs(options.job_arguments(), 5):
        assert "#PBS -q night" in (tmp_path / "submitted").read_text()


@pytest.mark.filterwarnings("ignore:unclosed cluster")
def test_a_system_or_argument_that_is_unknown_is_refused_by_name():
    for given, words in (
        (["cluster=torque"], "cluster=torque: .*slurm"),
        (["cluster=slurm", "cluster.cores=many"], "cores"),
        (["cluster=slurm", "cluster.core=4"], "SLURMCluster: .*core"),
        (["cluster=slurm", "cluster.memory=lots"], "lots"),
        (["cluster=slurm", "cluster._target_=dask_jobqueue.NoCluster"], "NoCluster"),
    ):
        with pytest.raises(BadInput, match=words):
            start(*given)
        gc.collect()


def test_a_system_that_takes_no_job_is_one_line(tmp_path):
    (tmp_path / "bin" / "sbatch").write_text("#!/bin/sh\necho partition long is closed >&2\nexit 1\n")
    with pytest.raises(BadInput, match=r"takes no job: partition long is closed$"):
        start("cluster=slurm")
    gc.collect()  # an unclosed cluster would warn, which is an error
