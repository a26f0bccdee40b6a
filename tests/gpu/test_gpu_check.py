"""The check of a GPU: refused without one, and a network that differs is seen (here the CPU stands in for the GPU)."""

import re
from pathlib import Path

import numpy as np
import pytest
import torch

import vprbench
from vprbench.cli import main
from vprbench.gpu import check as gpu
from vprbench.gpu.check import Route, Settings, compared
from vprbench.methods.vprtempo.method import VPRTempo
from vprbench.plugins import registry
from vprbench.plugins.options import chosen


@pytest.fixture(autouse=True)
def in_a_folder_of_its_own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def test_what_cannot_be_checked_is_refused_in_one_line_and_nothing_is_written(capsys, monkeypatch):
    wanted = {"": "sees no GPU here", "place=3": "place is unknown", "device=cpu": "device=cpu: gpu-check compares"}
    for option, said in {**wanted, "pixels=0": "pixels=0: give", "batch_sizes=[]": "batch_sizes=[]: give"}.items():
        monkeypatch.setattr(torch.cuda, "device_count", lambda option=option: int(option != ""))
        assert main(["gpu-check", *option.split()]) == 2
        captured = capsys.readouterr()
        assert (captured.out, captured.err.count("\n")) == ("", 1)
        assert said in captured.err
    assert not list(Path().iterdir())


def make(name, device, **arguments):
    return registry.make_method({"_target_": VPRTempo.__module__ + ".VPRTempo", "device": device, **arguments})


def comparisons(make):
    settings = chosen(Settings, ["quick=true", "device=cpu", "max_module=12"], gpu.QUICK)
    return compared(settings, make, Route.drawn(settings.check_places), "paper")


def bent(engine, name, bend, number=None):
    """Return what makes methods of which those of an engine, or only one of them, answer wrongly by `name`."""
    made = []

    def bending(called, device, **arguments):
        method = make(called, device, **arguments)
        made.extend([method] * (arguments["engine"] == engine))
        if arguments["engine"] == engine and number in (None, len(made)):
            own = getattr(method, name)
            object.__setattr__(method, name, lambda *given: bend(own(*given)))
        return method

    return bending


def changed(name, change):
    def bend(state):
        array = state[name].copy()
        array.flat[np.abs(array).argmax()] *= 1 + change
        return {**state, name: array}

    return bend


def larger(state):
    return {key: array + 1 for key, array in state.items()}


def rolled(scores):
    return np.roll(scores, 1, axis=1)


def stretched_in_batches(scores):
    return scores * np.float32(1.001 if len(scores) > 1 else 1)


@pytest.mark.parametrize(
    ("wrong", "holds"),
    [
        (("readable", "state", changed("features", 2e-4)), [True, False, True]),
        (("readable", "state", changed("outputs_0", np.nan)), [True, False, True]),
        (("readable", "state", changed("feature_thresholds", 2e-4)), [True, False, True]),
        (("fused", "state", larger, 1), [False, True, True]),  # of the CPU
        (("fused", "state", larger, 2), [False, False, True]),
        (("readable", "match", rolled), [True, False, True]),
        (("fused", "match", stretched_in_batches, 2), [True, True, False]),
    ],
)
@pytest.mark.extended
def test_each_comparison_sees_its_difference(wrong, holds):
    found = comparisons(bent(*wrong))
    assert [each.holds for each in found] == holds
    assert found[1].other_places == (12 if wrong[2] is rolled else 0)
    assert not found[1].difference < 1.9e-4 or holds[1] or wrong[2] is rolled
    assert holds[2] or found[2].difference == pytest.approx(1e-3, rel=0.01)


@pytest.mark.parametrize(("change", "holds"), [(1, True), (1.01, False)])
def test_descriptors_of_a_trained_network_are_compared_too(change, holds):
    made = []

    def make(name, device):
        method = vprbench.method(name).build()
        encode, factor = method.encode, np.float32(change if not made else 1)
        method.encode = lambda images: encode(images) * factor
        made.append(method)
        return method

    settings = chosen(Settings, ["quick=true", "device=cpu"], gpu.QUICK)
    found = gpu.compare_descriptors(settings, make, Route.drawn(settings.check_places))
    assert (found.holds, found.other_places, len(made)) == (holds, 0, 2)


QUICK = ["gpu-check", "quick=true", "threads=1", "device=cpu", "results=here"]


@pytest.mark.extended
def test_what_was_found_is_written_and_a_difference_or_an_engine_that_cannot_run_ends_with_code_1(capsys, monkeypatch):
    monkeypatch.setattr(gpu, "require_gpu", lambda _: None)
    assert main(QUICK) == 0
    text = Path("here/gpu.md").read_text()
    assert capsys.readouterr().out.startswith(text)
    for row, times in (
        (r"GPU, fused.*\| same +\|", 6),
        (r"\| [\d.]+ +\| [\d.]+ +\| 2, (?:met|missed) by the second", 2),
        (r"offline, batch [14] +\| [\d,.]+ / [\d,.]+ / [\d,.]+ +\| 100,000, (?:met|missed)", 4),
    ):
        assert len(re.findall(row, text)) == times
    assert [path.name for path in Path("here").iterdir()] == ["gpu.md"]
    state, engine = VPRTempo.state, VPRTempo._engine

    def wrong(self):
        return {name: array * (1.01 if self.engine == "readable" else 1) for name, array in state(self).items()}

    def missing(self):
        return 1 / 0 if self.engine == "fused" else engine(self)

    monkeypatch.setattr(VPRTempo, "state", wrong)
    assert main(QUICK) == 1
    assert len(re.findall(r"against GPU, readable.*\| FAILED +\|", Path("here/gpu.md").read_text())) == 2
    monkeypatch.setattr(VPRTempo, "_engine", missing)
    assert main(QUICK) == 1
    assert Path("here/gpu.md").read_text().count("ZeroDivisionError") == 4 + 2
