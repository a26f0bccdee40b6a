"""A method or dataset in a loose file is used by its path; its parameters are its options, its source counts."""

import json
import sys
from pathlib import Path

import pytest
from small_plan import Apart

from vprbench.cli import main
from vprbench.cluster import crew
from vprbench.errors import BadInput
from vprbench.plugins import entries, registry
from vprbench.run.compose import composed, readable
from vprbench.run.processes import IN_SWEEP
from vprbench.run.store import Store

METHOD = """
from dataclasses import dataclass, field
import numpy as np
from vprbench.api import DescriptorMethod
from beside import TINY

@dataclass
class Means(DescriptorMethod):
    '''Mean colours.'''
    bins: int = 2
    sizes: tuple[int, ...] = (1, 2)
    names: list[str] = field(default_factory=lambda: ["a"])
    seed: int = 5
    device: str = "cpu"

    def encode(self, images):
        values = np.array([image.mean(axis=(0, 1)) for image in images], np.float32) + TINY
        return values / np.linalg.norm(values, axis=1, keepdims=True)

def other(places: int, seed: int = 3, root: str | None = None):
    return places
"""
DATASET = """
import numpy as np
from vprbench.api import Dataset, Images

def walk(places: int = 5, seed: int = 0) -> Dataset:
    frames = np.random.default_rng(seed).integers(0, 256, (places, 8, 9, 3), dtype=np.uint8)
    right = tuple(np.array([place]) for place in range(places))
    protocol = {"references": "there", "query": "back"}
    images = Images.from_arrays([*frames])
    return Dataset("walk", images, np.arange(places), images, right, protocol)
"""
QUICK = ["timing=none", "threads=1"]


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    """A working folder with loose files; what they leave in this process is removed."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.setattr(entries, "_LOOSE", {"method": {}, "dataset": {}})
    for name, text in (("means.py", METHOD), ("walk.py", DATASET), ("beside.py", "TINY = 1e-6\n")):
        (tmp_path / name).write_text(text)
    modules = {*sys.modules}
    yield tmp_path
    for name in {*sys.modules} - modules:
        if str(getattr(sys.modules[name], "__file__", "")).startswith(str(tmp_path)):
            del sys.modules[name]


def test_parameters_are_options_with_their_defaults_and_seed_and_device_those_of_the_run():
    asked = ["method=./means.py:Means", "method.bins=3", "seed=8", "dataset=./means.py:other"]
    config = composed(readable(asked))
    wanted = {"bins": 3, "sizes": [1, 2], "names": ["a"], "seed": 8, "device": "cpu", "index": "exact"}
    assert {name: config["method"][name] for name in wanted} == wanted
    assert (config["dataset"]["places"], config["dataset"]["seed"], config["dataset"]["root"]) == ("???", 3, None)
    entry = registry.entries("method")["Means"]
    assert (entry.description, entry.changed(config["method"])) == ("Mean colours.", {"bins": 3})


@pytest.mark.parametrize(
    ("options", "named"),
    [
        (["method=means.py:Means", "method.bins=few"], "method.bins=few: wanted an integer"),
        (["method=means.py:Means", "method.bin=2"], "method.bin is unknown to Means: did you mean bins"),
        (["dataset=means.py:other"], "dataset.places is missing"),
        (["method=absent.py:Means"], "absent.py is not there"),
        (["method=means.py:Mean"], "did you mean Means?"),
        (["method=walk.py"], "walk.py: it defines no method"),
        (["method=walk.py:walk", "dataset.places=12"], "made a Dataset"),
    ],
)
def test_what_does_not_fit_is_told_in_a_line(options, named, capsys):
    assert main([*options, *QUICK]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert named in line


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("import numpy\nclass Broken(\n    x = 1\n", 2),
        ("import sys\nsys.exit(4)\n", 2),
        ("def f():\n    return 1 / 0\nX = f()\n", 2),
        ("def Broken(places: int = 2):\n    return [1][places]\n", 2),
    ],
)
def test_an_error_in_the_file_names_its_line(here, text, line, capsys):
    (here / "broken.py").write_text(text)
    assert main(["method=./broken.py:Broken"]) == 2
    (said,) = capsys.readouterr().err.splitlines()
    assert f"(broken.py, line {line})" in said


def test_a_name_that_is_taken_is_refused_and_a_file_may_have_the_name_of_a_library(here):
    (here / "mine.py").write_text("def Sad(): pass\n")
    (here / "more.py").write_text("def Means(): pass\n")
    (here / "json.py").write_text(METHOD.replace("Means", "Named"))
    registry.named("method", "./means.py:Means")
    for text in ("mine.py:Sad", "more.py:Means"):
        with pytest.raises(BadInput, match="that name too"):
            registry.named("method", text)
    assert registry.named("method", "./means.py:Means") == "Means"
    assert registry.named("method", "./json.py") == "Named"
    method = registry.make_method(composed(readable(["method=Named"]))["method"])
    assert (method.names, json.loads("1")) == (["a"], 1)


@pytest.mark.parametrize(
    ("asked", "read"),
    [
        ("method=./means.py:Means", "method=Means"),
        ("method=sad,./means.py:Means", "method=sad,Means"),
        ("methods=[means.py,sad]", "methods=[Means,sad]"),
        ("methods=sad,pca", "methods=sad,pca"),
        ("dataset=./walk.py", "dataset=walk"),
        ("method=", "method="),
    ],
)
def test_a_path_among_names_is_read_as_a_name(asked, read):
    assert readable([asked]) == [read]


def test_a_loose_file_is_checked(capsys):
    for asked in ("dataset=walk.py", "dataset=./walk.py:walk"):
        assert main(["check", asked, "dataset.places=4"]) == 0
        assert capsys.readouterr().out.splitlines()[-1] == "17 rules: 17 kept, 0 excepted, 0 broken"


def test_the_source_of_the_file_and_of_what_lies_beside_it_counts(here):
    def key():
        for name in ("means", "beside"):
            sys.modules.pop(name, None)
        assert main(["method=./means.py:Means", "dataset=./walk.py:walk", *QUICK]) == 0
        return max(Path("results/walk").glob("Means-*"), key=lambda folder: folder.stat().st_mtime_ns).name

    first = key()
    (here / "means.py").write_text("# a word\n" + METHOD)
    assert key() == first
    (here / "beside.py").write_text("TINY = 1e-5\n")
    second = key()
    (here / "means.py").write_text(METHOD.replace("axis=(0, 1)", "axis=(1, 0)"))
    assert len({first, second, key()}) == 3


def test_a_sweep_over_loose_files_stores_their_runs_by_name_and_another_process_gets_the_path(here, monkeypatch):
    monkeypatch.setenv(IN_SWEEP, "1")
    monkeypatch.setattr(crew, "run_apart", Apart())
    assert main(["-m", "method=./means.py:Means,sad", "dataset=./walk.py", "dataset.places=6", *QUICK]) == 0
    runs = [*Store(here / "results").runs()]
    assert sorted((run.method, run.dataset) for run in runs) == [("Means", "walk"), ("sad", "walk")]
    asked = next(run for run in runs if run.method == "Means").config["overrides"]
    assert {"method=means.py:Means", "dataset=walk.py:walk"} <= {*asked}
    options = ["method=sad,Means", "dataset=Means", "seed=1"]
    assert [*map(registry.as_asked, options)] == ["method=sad,means.py:Means", "dataset=Means", "seed=1"]
