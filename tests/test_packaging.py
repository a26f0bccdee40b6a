"""The wheel, an installed plug-in and the bare checkout run as they are meant to."""

import json
import os
import shutil
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import pytest
from checkout import ROOT
from small_plan import RUN

PARTS = ("vprbench", "methods", "datasets", "conf", "pyproject.toml", "README.md", "LICENSE")
QUICK = ("dataset.places=12", "dataset.first_query_place=0", *RUN)


def run(*command, cwd):
    """Return what a command prints that has to succeed."""
    clean = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"} | {"OMP_NUM_THREADS": "1"}
    done = subprocess.run(command, cwd=cwd, env=clean, capture_output=True, text=True, timeout=240, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def copied(target):
    for part in PARTS:
        copy = shutil.copytree if (ROOT / part).is_dir() else shutil.copy
        copy(ROOT / part, target / part)
    return target


def build_wheel(source, target):
    target.mkdir(parents=True)
    asked = ("-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "--wheel-dir")
    run(sys.executable, *asked, target, source, cwd=target)
    (wheel,) = target.glob("*.whl")
    return wheel


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """The python of a fresh environment that has both wheels, and the libraries of this one but not our checkout."""
    work = tmp_path_factory.mktemp("packaging")
    (work / "source").mkdir()
    shutil.copytree(ROOT / "tests" / "example_plugin", work / "plugin")
    sources = {"project": copied(work / "source"), "plugin": work / "plugin"}
    wheels = [build_wheel(source, work / "wheels" / name) for name, source in sources.items()]
    run(sys.executable, "-m", "venv", "--without-pip", work / "env", cwd=work)
    site = next((work / "env").glob("lib/python*/site-packages"))
    (site / "libraries.pth").write_text(sysconfig.get_paths()["purelib"] + "\n", encoding="utf-8")
    asked = ("-m", "pip", "install", "--quiet", "--no-deps", "--no-index", "--no-compile", "--target")
    run(sys.executable, *asked, site, *wheels, cwd=work)
    return work / "env" / "bin" / "python"


@pytest.mark.extended
def test_the_wheel_runs_from_another_folder_with_a_plug_in_and_holds_no_top_level_package_but_ours(installed, tmp_path):
    row = json.loads(run(installed, "-m", "vprbench", "method=sad", *QUICK, "output=json", cwd=tmp_path))
    assert (tmp_path / row["run_folder"] / "run.json").is_file()
    there = run(installed, "-c", "import vprbench; print(vprbench.__file__)", cwd=tmp_path)
    assert Path(there.strip()).is_relative_to(installed.parents[1])
    (wheel,) = (installed.parents[2] / "wheels" / "project").glob("*.whl")
    top = {name.split("/")[0] for name in zipfile.ZipFile(wheel).namelist()}
    assert {name for name in top if not name.endswith(".dist-info")} == {"vprbench"}
    printed = " ".join(run(installed, "-m", "vprbench", "list", cwd=tmp_path).split())
    assert "thumbnail Colours of a coarse grid of cells [vprbench_example]" in printed
    assert "panorama Views all around a made-up panorama, by day and at dusk [vprbench_example]" in printed
    assert "compdef _vprbench" in run(installed, "-m", "vprbench", "completion", "zsh", cwd=tmp_path)
    names = ("method=thumbnail", "method.cells=6", "dataset=panorama", "dataset.places=12", "metrics=mrr")
    told = json.loads(run(installed, "-m", "vprbench", *names, *RUN, "output=json", cwd=tmp_path))
    assert (told["method"], told["dataset"], told["mrr"] > 0) == ("thumbnail", "panorama", True)
    for asked, counted in ("method=thumbnail", "12 kept, 1 excepted"), ("dataset=panorama", "6 kept, 0 excepted"):
        assert f"{counted}, 0 broken" in run(installed, "-m", "vprbench", "check", asked, cwd=tmp_path)


@pytest.mark.extended
def test_a_bare_checkout_runs(tmp_path):
    there = run(sys.executable, "-c", "import vprbench.methods.sad as s; print(s.__file__)", cwd=copied(tmp_path))
    assert there.strip() == str(tmp_path / "methods" / "sad.py")


def test_importing_the_package_needs_neither_torch_nor_matplotlib():
    code = "import sys, vprbench, vprbench.api.descriptor; print('torch' in sys.modules, 'matplotlib' in sys.modules)"
    assert run(sys.executable, "-c", code, cwd=ROOT).split() == ["False", "False"]
