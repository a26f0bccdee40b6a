"""What a registered yaml holds, that of the yaml it builds on included: names of arguments, and which were changed."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import hydra
import pytest
from omegaconf import OmegaConf

from vprbench.api.method import Method
from vprbench.cli import main
from vprbench.errors import BadInput
from vprbench.methods.sad import SAD
from vprbench.methods.vprtempo.ensemble import VPRTempoEnsemble
from vprbench.methods.vprtempo.int8 import VPRTempoInt8
from vprbench.methods.vprtempo.method import VPRTempo
from vprbench.plugins import registry
from vprbench.plugins.registry import Entry
from vprbench.run.store import Store


@pytest.fixture
def method(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Return what registers a yaml under a name and gives its entry."""
    (tmp_path / "method").mkdir()
    monkeypatch.setattr("vprbench.plugins.entries.conf_folders", lambda: {"little": tmp_path})

    def written(name: str, text: str) -> Entry:
        (tmp_path / "method" / f"{name}.yaml").write_text(text)
        return registry.entries("method")[name]

    return written


@pytest.mark.parametrize(
    ("text", "options"),
    [
        ("# One\n_target_: a.B\nwidth: 2\nheight: 1\n", ["width", "height"]),
        ("", []),
        ("defaults: [lower, _self_]\n_target_: a.C\nmembers: 5\nwidth: 3\n", ["height", "depth", "width", "members"]),
        ("defaults: [elsewhere, one, _self_]\nwidth: 2\n", ["width"]),  # nobody registers elsewhere
        ("defaults:\n- override /dataset: nordland\n- _self_\nwidth: 2\n", ["width"]),
    ],
)
def test_options_are_the_arguments_once_each_those_of_the_yaml_below_included(method, text: str, options) -> None:
    method("lowest", "_target_: vprbench.methods.sad.SAD\nheight: 1\ndepth: 1\n")
    method("lower", "defaults: [lowest, _self_]\nwidth: 2\nheight: 1\n")
    assert method("lower", "defaults: [lowest, _self_]\nwidth: 2\nheight: 1\n").target() is SAD
    assert method("one", text).options == options


@pytest.mark.parametrize("text", ["a: [", "- a list\n", "width: 1\n", "word\n"])
def test_a_yaml_that_names_no_class_is_named(method, text: str) -> None:
    with pytest.raises(BadInput, match=r"broken\.yaml(, line 2)? is no method"):
        method("broken", text).target()


def test_the_options_of_a_method_are_the_arguments_of_its_class() -> None:
    for name, kind in {
        "vprtempo": VPRTempo,
        "vprtempo_int8": VPRTempoInt8,
        "vprtempo_ensemble": VPRTempoEnsemble,
    }.items():
        arguments = {field.name for field in fields(kind) if not field.name.startswith("_")}
        assert set(registry.entries("method")[name].options) == arguments


# Changed arguments

NESTED = "defaults: [lower]\nweights: {file: b.pth}\n"
LOWER = "# Lower\n_target_: a.B\nwidth: 2\nrate: 1e-3\nsizes: [1, 2]\nnothing: null\nseed: ${seed}\ndevice: ${device}\n"


def test_what_differs_from_the_yaml_is_changed_but_never_seed_and_device(method) -> None:
    given = {"_target_": "a.B", "width": 2, "rate": 0.001, "sizes": [1, 2], "nothing": None}
    lower = method("lower", LOWER)
    for changed in (
        {},
        {"width": 3},
        {"rate": 0.01},
        {"sizes": [1, 2, 3]},
        {"nothing": 0},
        {"width": None},
        {"more": 1},
    ):
        assert lower.changed({**given, **changed}) == changed
    for entry in (lower, method("fixed", "_target_: a.B\nseed: 1\ndevice: cpu\n")):
        assert entry.changed({"seed": 7, "device": "cuda"}) == {}


@pytest.mark.parametrize(
    ("text", "given", "changed"),
    [
        (
            "size: 4\nfile: net_${.size}.pth\nall: ['${seed}']\n",
            {"size": 5, "file": "net_5.pth", "all": [3]},
            {"size": 5},
        ),
        ("defaults: [lower, _self_]\nwidth: 3\n", {"width": 3, "rate": 0.001}, {}),
        ("defaults: [lower, _self_]\nwidth: 3\n", {"width": 2, "rate": 0.001}, {"width": 2}),
        (NESTED, {"weights": {"file": "b.pth", "url": "http://b", "path": None}}, {}),
        (NESTED, {"weights": {"file": "b.pth", "url": "http://b", "path": "/b"}}, {"weights": {"path": "/b"}}),
        ("", {"_target_": "a.B", "width": 1}, {"width": 1}),
    ],
    ids=["interpolated", "as the upper", "as the lower", "a mapping", "within a mapping", "nothing there"],
)
def test_what_differs_from_the_yaml_and_those_below_is_changed(
    method, text: str, given: dict[str, object], changed: dict[str, object]
) -> None:
    method("lower", LOWER + "weights: {file: a.pth, url: 'http://${.file}', path: null}\n")
    assert method("upper", text).changed(given) == changed


def composed(name: str, *asked: str) -> dict[str, object]:
    with hydra.initialize_config_module("vprbench.conf", version_base="1.3"):
        config = hydra.compose("run", overrides=[f"method={name}", *asked])
    return OmegaConf.to_container(config.method, resolve=True)  # type: ignore[return-value]


@pytest.mark.parametrize("name", registry.entries("method"))
def test_a_method_of_which_nothing_was_asked_for_is_not_changed_and_is_built_without_weights(name: str) -> None:
    assert isinstance(registry.make_method(composed(name)), Method)
    assert registry.entries("method")[name].changed(composed(name, "seed=5", "device=cuda:1")) == {}


@pytest.mark.parametrize(
    ("name", "asked", "wanted"),
    [
        ("vprtempo", ["method.rules=reference", "method.max_module=1100"], {"rules": "reference"}),
        ("vprtempo_ensemble", ["method.members=3", "method.epochs=4"], {"members": 3}),
        ("vprtempo_tuned", ["method.epochs=4"], {"epochs": 4}),
        ("cosplace", ["method.backbone=ResNet18"], {"backbone": "ResNet18"}),
    ],
)
def test_what_was_asked_for_on_the_command_line_is_changed(
    name: str, asked: list[str], wanted: dict[str, object]
) -> None:
    assert registry.entries("method")[name].changed(composed(name, *asked)) == wanted


def test_a_stored_run_names_the_arguments_that_were_changed_if_a_yaml_registers_its_method(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own" / "method").mkdir(parents=True)
    (tmp_path / "own" / "method" / "mine.yaml").write_text("_target_: vprbench.methods.sad.SAD\npatch: 5\n")
    quick = ["dataset.places=12", "dataset.first_query_place=0", "timing=none", "threads=1"]
    assert main(["method=sad", "method.patch=5", "method.width=28", "seed=3", *quick]) == 0
    assert main(["--config-dir", "own", "method='mine'", *quick]) == 0
    configs = {run.method: run.config for run in Store(Path("results")).runs()}
    assert configs["sad"]["changed"] == {"patch": 5}
    assert "changed" not in configs["mine"]
