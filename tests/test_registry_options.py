"""The names of arguments that a registered yaml holds, those of the yaml it builds on included."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import hydra
import pytest
from omegaconf import OmegaConf

from vprbench import registry
from vprbench.interface import Method
from vprbench.methods.vprtempo.ensemble import VPRTempoEnsemble
from vprbench.methods.vprtempo.int8 import VPRTempoInt8
from vprbench.methods.vprtempo.method import VPRTempo
from vprbench.registry import Entry


@pytest.fixture
def method(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Return what registers a yaml under a name and gives its entry."""
    (tmp_path / "method").mkdir()
    monkeypatch.setattr(registry, "conf_folders", lambda: {"little": tmp_path})

    def written(name: str, text: str) -> Entry:
        (tmp_path / "method" / f"{name}.yaml").write_text(text)
        return registry.entries("method")[name]

    return written


def test_options_are_the_arguments_in_their_order(method) -> None:
    assert method("one", "# One\n_target_: a.B\nwidth: 2\nheight: 1\n").options == ["width", "height"]


def test_a_yaml_of_nothing_has_no_options(method) -> None:
    assert method("none", "").options == []


def test_a_yaml_that_builds_on_another_has_the_options_of_both_once_each(method) -> None:
    method("lower", "_target_: a.B\nwidth: 2\nheight: 1\n")
    entry = method("upper", "defaults: [lower, _self_]\n_target_: a.C\nmembers: 5\nwidth: 3\n")
    assert sorted(entry.options) == ["height", "members", "width"]


def test_a_yaml_may_build_on_one_that_builds_on_another(method) -> None:
    method("lowest", "_target_: a.A\nheight: 1\n")
    method("lower", "defaults: [lowest, _self_]\n_target_: a.B\nwidth: 2\n")
    assert sorted(method("upper", "defaults: [lower]\n_target_: a.C\n").options) == ["height", "width"]


def test_what_a_yaml_builds_on_that_is_no_registered_one_is_passed_over(method) -> None:
    assert method("one", "defaults: [elsewhere, one, _self_]\n_target_: a.B\nwidth: 2\n").options == ["width"]


def test_a_mapping_among_the_defaults_is_passed_over(method) -> None:
    assert method("one", "defaults:\n- override /dataset: nordland\n- _self_\nwidth: 2\n").options == ["width"]


@pytest.mark.parametrize(
    ("name", "kind"), [("vprtempo", VPRTempo), ("vprtempo_int8", VPRTempoInt8), ("vprtempo_ensemble", VPRTempoEnsemble)]
)
def test_the_options_of_a_method_are_the_arguments_of_its_class(name: str, kind: type) -> None:
    arguments = {field.name for field in fields(kind) if not field.name.startswith("_")}
    assert set(registry.entries("method")[name].options) == arguments


@pytest.mark.parametrize("name", registry.entries("method"))
def test_every_method_can_be_built_without_any_file_of_weights(name: str) -> None:
    with hydra.initialize_config_module("vprbench.conf", version_base="1.3"):
        config = OmegaConf.to_container(hydra.compose("run", overrides=[f"method={name}"]).method, resolve=True)
    assert isinstance(registry.make_method(config), Method)  # type: ignore[arg-type]
