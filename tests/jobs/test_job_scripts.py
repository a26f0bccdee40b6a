"""The scripts that batch systems get: what conf/cluster and the command line ask for stands in them, in their words."""

import gc
import os
import re
import shlex
import subprocess
import sys

import pytest

from vprbench.errors import BadInput
from vprbench.jobs.batch import job, started

ASKED = {
    **{"queue": "long", "account": "robots", "cores": 6, "memory": "32GB", "walltime": "12:30:00", "gpus": 2},
    **{"directives": ["--one-more"], "prologue": ["module load cuda"]},
}
WANTED = {  # as the manuals of sbatch, qsub (OpenPBS), bsub and qsub (Grid Engine) have them
    # 32 GB are 29.8 of their GB and 30,517.6 of their MB, taken whole, which are 32,000,442.4 thousands of bytes
    "slurm": ["-p long", "-A robots", "--cpus-per-task=6", "--mem=30G", "-t 12:30:00", "--gres=gpu:2"],
    "pbs": ["-q long", "-A robots", "-l select=1:ncpus=6:mem=30518mb:ngpus=2", "-l walltime=12:30:00"],
    "lsf": ["-q long", '-P "robots"', "-n 6", "-M 32000443", "-W 12:30", '-gpu "num=2"'],
    "sge": ["-q long", "-P robots", "-pe smp 6", "-l mem_free=30518M", "-l h_rt=12:30:00", "-l gpu=2"],
}
SENTINEL = {"slurm": "#SBATCH", "pbs": "#PBS", "lsf": "#BSUB", "sge": "#$"}


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


def script(tmp_path, system, **given):
    """Return the script that a system gets of a job."""
    with started(job({"name": system, "logs": str(tmp_path / "logs"), **given}, workers=None)):
        return (tmp_path / "submitted").read_text()


def directives(text, system):
    """Return what a script asks of its system, of the lines that it reads: those before the first command."""
    head = re.split(r"^[^#\n]", text, maxsplit=1, flags=re.MULTILINE)[0]
    return [
        line.removeprefix(SENTINEL[system]).strip() for line in head.splitlines() if line.startswith(SENTINEL[system])
    ]


@pytest.mark.parametrize("system", WANTED)
def test_a_script_asks_its_system_for_what_was_asked_and_for_no_queue_account_or_gpu_else(system, tmp_path):
    found = directives(script(tmp_path, system, **ASKED), system)
    assert not [line for line in [*WANTED[system], "--one-more"] if line not in found], found
    text = " ".join(directives(script(tmp_path, system), system))  # unless they are named
    assert not re.search(r"(^| )-(q|p|A|P) |gpu|None", text)


@pytest.mark.parametrize("system", WANTED)
def test_a_script_begins_one_worker_in_the_folder_and_environment_of_the_client(system, tmp_path, monkeypatch):
    home = tmp_path / "a folder"
    home.mkdir()
    monkeypatch.chdir(home)
    monkeypatch.setenv("VPRBENCH_DATA", "/data of all/frames")
    lines = script(tmp_path, system, **ASKED).strip().splitlines()
    *before, worker = [line for line in lines if line and not line.startswith("#")]
    words = shlex.split(worker)
    assert words[0] == sys.executable
    assert words[-1 - words[::-1].index("--nthreads") + 1] == "1"  # of several the last one counts
    assert "--nworkers" not in words
    assert before[-1] == "module load cuda"
    text = "\n".join([*before[:-1], 'echo "$PWD" "$VPRBENCH_DATA"', f"{sys.executable} -c 'import vprbench'"])
    said = subprocess.run(["bash", "-ec", text], cwd="/", env={}, capture_output=True, text=True, check=True)
    assert said.stdout == f"{home} /data of all/frames\n"


def test_memory_is_the_same_in_the_units_of_all_systems_and_what_is_none_is_refused(tmp_path):
    found = {system: " ".join(directives(script(tmp_path, system, memory="512MiB"), system)) for system in WANTED}
    assert "--mem=512M" in found["slurm"]
    assert re.search("mem=512mb", found["pbs"], re.IGNORECASE)
    assert re.search(r"mem_free=512M(?!i)", found["sge"])
    with pytest.raises(BadInput, match=r"cluster\.memory=lots: give a number and a unit"):
        script(tmp_path, "slurm", memory="lots")


def test_a_system_that_takes_no_job_is_said_in_one_line(tmp_path):
    (tmp_path / "bin" / "sbatch").write_text("#!/bin/sh\necho partition long is closed >&2\nexit 1\n")
    with pytest.raises(BadInput, match=r"^cluster=slurm takes no job: partition long is closed$"):
        script(tmp_path, "slurm")
    gc.collect()  # an unclosed cluster would warn, which is an error
