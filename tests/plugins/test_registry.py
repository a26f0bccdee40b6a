"""What a registered yaml holds, how its options are read and checked, and what a dataset plug-in has to return."""

import re
import subprocess
import sys
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, Literal

import pytest
from described_images import composed
from omegaconf import OmegaConf

from vprbench.api.method import Method
from vprbench.config import make_request
from vprbench.errors import BadInput
from vprbench.plugins import registry
from vprbench.plugins.entries import find_entries
from vprbench.plugins.options import check_value, parse_options


@pytest.fixture
def method(tmp_path, monkeypatch):
    """Return what registers a yaml under a name and gives its entry."""
    (tmp_path / "method").mkdir()
    folders = {**registry.find_conf_folders(), "little": tmp_path}
    monkeypatch.setattr("vprbench.plugins.entries.find_conf_folders", lambda: folders)

    def written(name, text):
        (tmp_path / "method" / f"{name}.yaml").write_text(text)
        return registry.find_entries("method")[name]

    return written


def test_reading_all_entries_imports_neither_hydra_nor_anything_that_computes():
    read = "[(e.options, e.tags, e.description) for g in ('method', 'dataset') for e in entries(g).values()]"
    heavy = "{'hydra', 'omegaconf', 'torch', 'numpy', 'pydantic', 'vprbench.methods'} & {*sys.modules}"
    program = f"import sys; from vprbench.plugins.entries import find_entries as entries; {read}; print({heavy})"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout == "set()\n"


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


def test_arguments_that_differ_from_the_yaml_and_those_below_are_changed_but_never_seed_and_device(method):
    method("lower", LOWER)
    for text, options, changed in (
        (LOWER, ["width=2", "rate=0.001", "sizes=[1,2]", "seed=7", "device=cpu"], {}),
        (LOWER, ["rate=0.01", "sizes=[1]", "nothing=0"], {"rate": 0.01, "sizes": [1], "nothing": 0}),
        (UPPER, ["rate=0.001", "width=3"], {}),
        (UPPER, ["width=2"], {"width": 2}),
        (NESTED, ["weights.path=/b"], {"weights": {"path": "/b"}}),
    ):
        method("upper", text)
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


def test_a_list_is_given_with_or_without_brackets_and_a_mapping_without_quotes():
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


def test_an_option_that_does_not_fit_is_refused_by_its_name_and_what_json_cannot_say_otherwise_is_taken():
    for option in ("sizes=1,two", "name", "nmae=x", "sizes=[[1]]"):
        with pytest.raises(BadInput, match=option.split("=")[0]):
            parse_options(Asked, [option])
    for value, hint in (("4", int), (1, bool), (4.5, int), ("x", Literal["y"]), ({"a": 1}, list[str])):
        with pytest.raises(BadInput, match=rf"^method\.cells={re.escape(str(value))}: "):
            check_value("method.cells", value, hint)
    lists = ((3, list[int], [3]), ("mrr", list[str], ["mrr"]))  # one value is a list of one
    others = ((4, float, 4.0), ([1, 2], tuple[int, ...], (1, 2)), ("a/b", Path, Path("a/b")))
    for value, hint, wanted in (*lists, *others):
        assert check_value("x", value, hint) == wanted


# What a dataset plug-in returns
