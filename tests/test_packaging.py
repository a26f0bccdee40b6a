"""The wheel, an installed plug-in and the bare checkout run as they are meant to."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import sysconfig
import tomllib
import zipfile
from pathlib import Path

import pytest
from checkout import ROOT

PARTS = ("vprbench", "methods", "datasets", "conf", "pyproject.toml", "README.md", "LICENSE")
QUICK = (
    "dataset.places=12",
    "dataset.first_query_place=0",
    "timing.minimum_seconds=0",
    "timing.sample=4",
    "timing.minimum_queries=4",
    "timing.batch_sizes=[4]",
    "threads=1",
)


def run(*command: str | Path, cwd: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    clean = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    return subprocess.run(
        [str(part) for part in command],
        cwd=cwd,
        env={**clean, "OMP_NUM_THREADS": "1", **environment},
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
    )


def build_wheel(source: Path, target: Path) -> Path:
    built = run(
        sys.executable,
        *("-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "--wheel-dir"),
        target,
        source,
        cwd=target,
    )
    assert built.returncode == 0, built.stderr
    (wheel,) = target.glob("*.whl")
    return wheel


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The python of a fresh environment that has both wheels, and the libraries of this one but not our checkout."""
    work = tmp_path_factory.mktemp("packaging")
    source = work / "source"
    source.mkdir()
    for part in PARTS:
        copy = shutil.copytree if (ROOT / part).is_dir() else shutil.copy
        copy(ROOT / part, source / part)
    shutil.copytree(ROOT / "tests" / "example_plugin", work / "plugin")
    wheels = [work / "wheels" / name for name in ("project", "plugin")]
    for wheel in wheels:
        wheel.mkdir(parents=True)
    paths = [build_wheel(source, wheels[0]), build_wheel(work / "plugin", wheels[1])]
    made = run(sys.executable, "-m", "venv", "--without-pip", work / "env", cwd=work)
    assert made.returncode == 0, made.stderr
    site = next((work / "env").glob("lib/python*/site-packages"))
    (site / "libraries.pth").write_text(sysconfig.get_paths()["purelib"] + "\n", encoding="utf-8")
    put = run(
        sys.executable,
        *("-m", "pip", "install", "--quiet", "--no-deps", "--no-index", "--no-compile", "--target"),
        site,
        *paths,
        cwd=work,
    )
    assert put.returncode == 0, put.stderr
    return work / "env" / "bin" / "python"


def test_the_wheel_runs_from_another_folder(installed: Path, tmp_path: Path) -> None:
    done = run(installed, "-m", "vprbench", "method=sad", *QUICK, "output=json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    row = json.loads(done.stdout)
    assert (tmp_path / row["run_folder"] / "run.json").is_file()


def test_the_wheel_is_what_runs_there(installed: Path, tmp_path: Path) -> None:
    done = run(installed, "-c", "import vprbench; print(vprbench.__file__)", cwd=tmp_path)
    assert Path(done.stdout.strip()).is_relative_to(installed.parents[1])


def test_the_wheel_holds_no_top_level_package_but_ours(installed: Path) -> None:
    (wheel,) = (installed.parents[2] / "wheels" / "project").glob("*.whl")
    top = {name.split("/")[0] for name in zipfile.ZipFile(wheel).namelist()}
    assert {name for name in top if not name.endswith(".dist-info")} == {"vprbench"}


def test_an_installed_plug_in_is_listed_with_its_provider(installed: Path, tmp_path: Path) -> None:
    done = run(installed, "-m", "vprbench", "list", cwd=tmp_path)
    printed = " ".join(done.stdout.split())
    assert "thumbnail Colours of a coarse grid of cells [example]" in printed
    assert "panorama Views all around a made-up panorama, by day and at dusk [example]" in printed


def test_an_installed_plug_in_runs_by_its_name(installed: Path, tmp_path: Path) -> None:
    options = (
        "method=thumbnail",
        "method.cells=6",
        "dataset=panorama",
        "dataset.places=12",
        "timing=none",
        "threads=1",
    )
    done = run(installed, "-m", "vprbench", *options, "output=json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert (told["method"], told["dataset"]) == ("thumbnail", "panorama")


@pytest.mark.parametrize(
    ("asked", "counted"),
    [("method=thumbnail", "15 kept, 1 excepted, 0 broken"), ("dataset=panorama", "17 kept, 0 excepted, 0 broken")],
)
def test_an_installed_plug_in_can_be_checked_against_the_contract(
    installed: Path, tmp_path: Path, asked: str, counted: str
) -> None:
    done = run(installed, "-m", "vprbench", "check", asked, cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    assert counted in done.stdout


def test_a_bare_checkout_runs(tmp_path: Path) -> None:
    for part in PARTS:
        copy = shutil.copytree if (ROOT / part).is_dir() else shutil.copy
        copy(ROOT / part, tmp_path / part)
    done = run(sys.executable, "-c", "import vprbench.methods.sad as s; print(s.__file__)", cwd=tmp_path)
    assert done.stdout.strip() == str(tmp_path / "methods" / "sad.py")


def test_every_folder_with_code_or_yaml_is_a_listed_package() -> None:
    listed = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["packages"]
    mapped = {"methods": "vprbench.methods", "datasets": "vprbench.datasets", "conf": "vprbench.conf"}
    found = {"vprbench"}
    for top, package in mapped.items():
        for file in (ROOT / top).rglob("*"):
            if file.suffix in (".py", ".yaml"):
                found.add(".".join([package, *file.parent.relative_to(ROOT / top).parts]))
    found |= {".".join(file.parent.relative_to(ROOT).parts) for file in (ROOT / "vprbench").rglob("*.py")}
    assert found == set(listed)


def test_methods_and_datasets_have_no_init_file_of_their_own() -> None:
    assert [name for name in ("methods", "datasets") if (ROOT / name / "__init__.py").exists()] == []


def test_importing_the_package_needs_neither_torch_nor_matplotlib() -> None:
    code = "import sys, vprbench, vprbench.api.descriptor; print('torch' in sys.modules, 'matplotlib' in sys.modules)"
    assert run(sys.executable, "-c", code, cwd=ROOT).stdout.split() == ["False", "False"]


def test_every_pinned_version_is_installed_here() -> None:
    from importlib.metadata import PackageNotFoundError, version

    pins = [line.split("==") for line in (ROOT / "constraints.txt").read_text().splitlines() if "==" in line]
    differing = []
    for name, wanted in pins:
        try:
            if version(name).split("+")[0] != wanted:
                differing.append(f"{name} {version(name)}, pinned {wanted}")
        except PackageNotFoundError:
            continue  # a pin may be for another platform
    assert differing == []
