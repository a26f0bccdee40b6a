"""Methods and datasets in yamls and loose files, new, broken and the example: options, rules and one-line errors."""

import json
import re
import sys
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, Literal

import pytest
from checkout import ROOT
from described_images import composed
from little_runs import quiet_surroundings
from omegaconf import OmegaConf
from plugged_in import forget_loose_files, see_yamls

from vprbench.api.method import Method
from vprbench.cli import main
from vprbench.config import make_request
from vprbench.errors import BadInput
from vprbench.plugins import loose, registry
from vprbench.plugins.entries import find_entries
from vprbench.plugins.options import check_value, parse_options
from vprbench.runs.store import Store


def test_a_yaml_holds_what_hydra_reads_in_it_and_tells_what_computes_by_spikes_or_needs_weights():
    for entry in (*find_entries("method").values(), *find_entries("dataset").values()):
        told, read = OmegaConf.to_container(OmegaConf.load(entry.path)), entry.values()
        own = told.keys() - {"defaults", "weights"}
        assert {name: read[name] for name in own} == {name: told[name] for name in own}
        assert ("spiking" in entry.tags) == entry.name.startswith(("vprtempo", "vprsnn", "lens"))
    needy = {name for name, entry in find_entries("method").items() if entry.needs_weights}
    assert {"netvlad", "megaloc", "boq_resnet50"} <= needy
    assert not {"sad", "hog", "vprtempo", "densevlad"} & needy


# Changed arguments

NESTED = "defaults: [lower, _self_]\nweights: {file: b.pth}\n"
UPPER = "defaults: [lower, _self_]\nwidth: 3\n"
LOWER = """# Lower
_target_: a.B
width: 2
rate: 1e-3
sizes: [1, 2]
nothing: null
size: 4
file: n_${.size}
weights: {file: a.pth, url: 'http://${.file}', path: null}
seed: ${seed}
device: ${device}
"""


def test_arguments_that_differ_from_the_yaml_and_those_below_are_changed_but_never_seed_and_device(
    tmp_path, monkeypatch
):
    write = see_yamls(tmp_path, monkeypatch)
    write("lower", LOWER)
    for text, options, changed in (
        (LOWER, ["width=2", "rate=0.001", "sizes=[1,2]", "seed=7", "device=cpu"], {}),
        (LOWER, ["rate=0.01", "sizes=[1]", "nothing=0"], {"rate": 0.01, "sizes": [1], "nothing": 0}),
        (UPPER, ["rate=0.001", "width=3"], {}),
        (UPPER, ["width=2"], {"width": 2}),
        (NESTED, ["weights.path=/b"], {"weights": {"path": "/b"}}),
    ):
        write("upper", text)
        asked = ["method=upper", *(f"method.{option}" for option in options)]
        assert make_request(asked).changed == changed
    assert make_request(["method=upper", "+method.more=1"]).changed == {"more": 1}


@pytest.mark.parametrize("name", registry.find_entries("method"))
def test_a_method_has_the_options_of_its_class_and_is_built_without_weights(name):
    entry, config = registry.find_entries("method")[name], composed(f"method={name}", "seed=5", "device=cuda:1")
    assert {*entry.options} == {one.name for one in fields(entry.target()) if one.init and one.name[0] != "_"}
    assert isinstance(registry.make_method({**config, "device": "cpu"} if "device" in config else config), Method)


# Options as name=value have to be of the types that hints name; nothing is converted.


@dataclass(frozen=True)
class Asked:
    names: list[str] = field(default_factory=list)
    sizes: list[int] | None = None
    frames: list[list[int]] = field(default_factory=list)
    name: str = ""
    view: Any = None


def test_an_option_has_the_type_of_its_hint_with_or_without_brackets_and_is_else_refused_by_its_name():
    for option, value in (
        ("names=sad,hog", ["sad", "hog"]),
        ("names=[sad, hog]", ["sad", "hog"]),
        ("names=[]", []),
        ("sizes=1,8,32", [1, 8, 32]),
        ("sizes=null", None),
        ("frames=[[2,3]]", [[2, 3]]),
        ("name=a,b", "a,b"),
        ("name={a}", "{a}"),
        ("view={length:[2,4],window:centred}", {"length": [2, 4], "window": "centred"}),
    ):
        assert getattr(parse_options(Asked, [option]), option.split("=")[0]) == value
    for option in ("sizes=1,two", "name", "nmae=x", "sizes=[[1]]"):
        with pytest.raises(BadInput, match=option.split("=")[0]):
            parse_options(Asked, [option])
    for value, hint in (("4", int), (1, bool), (4.5, int), ("x", Literal["y"]), ({"a": 1}, list[str])):
        with pytest.raises(BadInput, match=rf"^method\.cells={re.escape(str(value))}: "):
            check_value("method.cells", value, hint)
    lists = ((3, list[int], [3]), ("mrr", list[str], ["mrr"]))  # one value is a list of one
    others = ((4, float, 4.0), ([1, 2], tuple[int, ...], (1, 2)), ("a/b", Path, Path("a/b")))
    for value, hint, wanted in (*lists, *others):  # which JSON cannot say otherwise
        assert check_value("x", value, hint) == wanted


METHOD = """
from dataclasses import dataclass, field
from pathlib import Path
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

class Filed(Means):
    def files(self):
        return [Path("weights.txt")]

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
    there, back = Images.from_arrays([*frames]), Images.from_arrays([*(frames ^ 1)])
    return Dataset("walk", there, np.arange(places), back, right, protocol)
"""
QUICK = ["timing=none", "threads=1"]
EXAMPLE = ROOT / "tests" / "example_plugin"


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    """A working folder with loose files; what they leave in this process is removed."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    forget_loose_files(monkeypatch)
    for name, text in (("means.py", METHOD), ("walk.py", DATASET), ("beside.py", "TINY = 1e-6\n")):
        (tmp_path / name).write_text(text)
    modules = {*sys.modules}
    with quiet_surroundings():
        yield tmp_path
    for name in {*sys.modules} - modules:
        if str(getattr(sys.modules[name], "__file__", "")).startswith(str(tmp_path)):
            del sys.modules[name]


def line_of(capsys):
    (line,) = capsys.readouterr().err.splitlines()
    return line


def counted(capsys):
    kept, broken = re.findall(r"rules: (\d+) kept, \d+ excepted, (\d+) broken", capsys.readouterr().out)[0]
    return int(kept), int(broken)


def test_parameters_are_options_with_their_defaults_and_seed_and_device_those_of_the_run():
    asked = ["method=./means.py:Means", "method.bins=3", "seed=8", "dataset=./means.py:other"]
    request = make_request(asked)
    wanted = {"bins": 3, "sizes": [1, 2], "names": ["a"], "seed": 8, "device": "cpu", "index": "exact"}
    assert {name: request.method[name] for name in wanted} == wanted
    assert tuple(request.dataset[name] for name in ("places", "seed", "root")) == ("???", 3, None)
    entry = registry.find_entries("method")["Means"]
    assert (entry.path.name, request.changed) == ("means.py", {"bins": 3})


def test_what_does_not_fit_is_told_in_a_line(capsys):
    for options, named in (
        (["method=means.py:Means", "method.bins=few"], "method.bins=few: wanted a valid integer"),
        (["method=means.py:Means", "method.bin=2"], "method.bin is unknown to Means: did you mean bins"),
        (["dataset=means.py:other"], "missing 1 required positional argument: 'places'"),
        (["method=absent.py:Means"], "absent.py is not there"),
        (["method=walk.py:walk", "dataset.places=12"], "made a Dataset"),
    ):
        assert main([*options, *QUICK]) == 2
        assert named in line_of(capsys)


def test_a_name_that_is_taken_is_refused_of_a_class_as_of_a_file(here):
    (here / "mine.py").write_text("def Sad(): pass\n")
    (here / "more.py").write_text("def Means(): pass\n")
    (here / "json.py").write_text(METHOD)
    loose.resolve_name("method", "./means.py:Means")
    for text in ("mine.py:Sad", "more.py:Means", "json.py:Means"):
        with pytest.raises(BadInput, match=r"name.*rename"):
            loose.resolve_name("method", text)
    assert loose.resolve_name("method", "./means.py:Means") == "Means"
    assert json.loads("1") == 1


def test_another_source_or_another_file_that_it_reads_makes_another_run(here, capsys):
    (here / "factors.txt").write_text("1")

    def is_stored(name="Means"):
        for module in ("means", "beside"):
            sys.modules.pop(module, None)
        capsys.readouterr()
        named = "method.names=[factors.txt]"
        assert main([f"method=./means.py:{name}", "dataset=./walk.py:walk", named, *QUICK, "output=json"]) == 0
        return json.loads(capsys.readouterr().out)["from_store"]

    assert [is_stored(), is_stored()] == [False, True]
    for file, text in (
        ("factors.txt", "2"),  # which an argument names
        ("beside.py", "TINY = 1e-5\n"),
        ("means.py", METHOD.replace("axis=(0, 1)", "axis=(1, 0)")),
    ):
        (here / file).write_text(text)
        assert not is_stored()
    for text in ("3", "4"):  # of the file that files() names
        (here / "weights.txt").write_text(text)
        assert not is_stored("Filed")


# What `new` writes keeps every rule at once, and nothing is overwritten.


@pytest.mark.parametrize(
    ("words", "asked"),
    [
        (["method", "my-means", "folder=below"], "method=./below/my_means.py:MyMeans"),
        (["dataset", "my_walk"], "dataset=./my_walk.py:my_walk"),
    ],
)
def test_a_new_file_keeps_every_rule_by_the_option_that_is_printed(here, words, asked, capsys):
    assert main(["new", *words]) == 0
    assert f"vprbench check {asked}\n" in capsys.readouterr().out
    assert main(["check", asked]) == 0
    kept, broken = counted(capsys)
    assert (kept >= 6, broken) == (True, 0)
    before = {path: path.read_text() for path in here.rglob("*.py")}
    assert main(["new", *words]) == 2
    assert {path: path.read_text() for path in here.rglob("*.py")} == before


# A broken plug-in ends check, list and run in one line that names what is wrong, its file and its line.

CODE = "from vprbench.api import DescriptorMethod\nclass Made(DescriptorMethod):\n"
DRAWN = "from vprbench.api import Dataset\ndef Made(places: int = 3) -> Dataset:\n"
TARGET = "# Broken\n_target_: broken_code.Made\n"


@pytest.mark.parametrize(
    ("group", "yaml", "code", "named"),
    [
        ("method", "# Broken\ncells: 3\n", "", "_target_"),
        ("method", TARGET, "\n\nclass Made(\n", "(broken_code.py, line 3)"),
        ("method", TARGET, CODE + "    encode = 1\n    def __init__(self): [][0]\n", "(broken_code.py, line 4)"),
        ("dataset", TARGET, DRAWN + "    return places\n", "gave int"),
        ("method", TARGET, "def Made(cells: int = 2): return cells\n", "made a int"),
    ],
)
def test_a_broken_plug_in_is_told_in_a_line_and_the_others_are_listed(
    here, monkeypatch, group, yaml, code, named, capsys
):
    see_yamls(here / "conf", monkeypatch)
    monkeypatch.syspath_prepend(here)
    (here / "conf" / group).mkdir(parents=True)
    (here / "conf" / group / "broken.yaml").write_text(yaml)
    (here / "broken_code.py").write_text(code)
    for command in (["check"], []):
        sys.modules.pop("broken_code", None)
        assert main([*command, f"{group}=broken"]) == 2
        assert named in line_of(capsys)
    if not code:
        assert main(["list"]) == 0
        lines = capsys.readouterr().out.splitlines()
        assert sum("BROKEN" in line and line.split()[0] == "broken" for line in lines) == 1
        assert sum(line.split()[:1] == ["sad"] for line in lines) == 1


def test_the_example_plug_in_keeps_every_rule_and_its_run_is_right(here, monkeypatch, capsys):
    see_yamls(EXAMPLE / "vprbench_example" / "conf", monkeypatch)
    monkeypatch.syspath_prepend(EXAMPLE)
    for asked in (["method=thumbnail"], ["dataset=panorama"], ["dataset=panorama", "dataset.overlap=0"]):
        assert main(["check", *asked]) == 0
        assert counted(capsys)[1] == 0
    assert main(["check", "dataset=panorama", "dataset.overlap=1"]) == 2
    assert "dataset.overlap=1" in capsys.readouterr().err
    assert main(["method=thumbnail", "dataset=panorama", "dataset.places=12", *QUICK]) == 0
    (run,) = Store(here / "results").runs()
    assert (run.method, run.dataset, len(run.outcome), run.outcome.n_places) == ("thumbnail", "panorama", 12, 12)
