"""The check of a GPU: refused without one, and a network that differs is seen (here the CPU stands in for the GPU)."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from vprbench.api.method import Method
from vprbench.cli import main
from vprbench.methods.vprtempo.method import VPRTempo
from vprbench.plugins import registry
from vprbench.plugins.options import chosen
from vprbench.speed import gpu
from vprbench.speed.gpu import Comparison, Settings, compared
from vprbench.speed.measure import Make
from vprbench.speed.route import Route

AGAINST_CPU, AGAINST_READABLE, BATCH = 0, 1, 2


@pytest.fixture(autouse=True)
def in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize(
    ("options", "n_gpus", "wanted"),
    [
        ([], 0, r"PyTorch \S+ sees no GPU here: .*"),
        (["place=3"], 0, r"option place is unknown: did you mean places\?.*"),
        (["device=cpu"], 1, r"device=cpu: gpu-check compares .*"),
        (["pixels=0"], 1, "pixels=0: give at least 1"),
        (["batch_sizes=[]"], 1, r"batch_sizes=\[\]: give .*"),
    ],
)
def test_what_cannot_be_checked_is_refused_in_one_line_and_nothing_is_written(
    options: list[str], n_gpus: int, wanted: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(torch.cuda, "device_count", lambda: n_gpus)
    assert main(["gpu-check", *options]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert re.fullmatch(rf"vprbench: {wanted}\n", captured.err)
    assert not list(Path().iterdir())


def make(name: str, device: str, **arguments: Any) -> Method:
    return registry.make_method({"_target_": VPRTempo.__module__ + ".VPRTempo", "device": device, **arguments})


def comparisons(make: Make, rules: str = "paper") -> list[Comparison]:
    settings = chosen(Settings, ["quick=true", "device=cpu", "max_module=12"], gpu.QUICK)
    return compared(settings, make, Route.drawn(settings.check_places, 32, 64, 0), rules)


def bent(engine: str, bend: Callable[[Method], None], number: int | None = None) -> Make:
    """Return what makes methods of which those of an engine, or only the last made of them, answer wrongly."""
    made: list[Method] = []

    def bending(name: str, device: str, **arguments: Any) -> Method:
        method = make(name, device, **arguments)
        if arguments["engine"] == engine:
            made.append(method)
            if number in (None, len(made)):
                bend(method)
        return method

    return bending


@pytest.mark.parametrize("rules", ["paper", "reference"])
def test_the_same_networks_are_the_same(rules: str) -> None:
    found = comparisons(make, rules)
    assert [each.holds for each in found] == [True] * 3
    assert [each.queries for each in found] == [12] * 3


@pytest.mark.parametrize("name", ["features", "outputs_0", "feature_thresholds"])
@pytest.mark.parametrize("change", [2e-4, np.nan])
def test_a_network_that_learnt_something_else_is_seen(name: str, change: float) -> None:
    def bend(method: Method) -> None:
        state = method.state

        def wrong() -> dict[str, Any]:
            arrays = {key: array.copy() for key, array in state().items()}
            arrays[name].flat[np.abs(arrays[name]).argmax()] *= 1 + change
            return arrays

        monkey(method, "state", wrong)

    found = comparisons(bent("readable", bend))
    assert [each.holds for each in found] == [True, False, True]
    assert not found[AGAINST_READABLE].difference < 1.9e-4


def test_the_fused_network_of_the_gpu_is_compared_with_that_of_the_cpu() -> None:
    def bend(method: Method) -> None:
        state = method.state
        monkey(method, "state", lambda: {key: array + 1 for key, array in state().items()})

    assert [each.holds for each in comparisons(bent("fused", bend, number=1))] == [False, True, True]
    assert [each.holds for each in comparisons(bent("fused", bend, number=2))] == [False, False, True]


def test_other_best_places_are_counted() -> None:
    def bend(method: Method) -> None:
        match = method.match
        monkey(method, "match", lambda codes: np.roll(match(codes), 1, axis=1))

    found = comparisons(bent("readable", bend))
    assert found[AGAINST_READABLE].other_places == 12
    assert [each.holds for each in found] == [True, False, True]


def test_a_batch_that_answers_unlike_its_single_queries_is_seen() -> None:
    def bend(method: Method) -> None:
        match = method.match
        monkey(method, "match", lambda codes: match(codes) * np.float32(1.001 if len(codes) > 1 else 1))

    found = comparisons(bent("fused", bend, number=2))
    assert found[BATCH].difference == pytest.approx(1e-3, rel=0.01)
    assert not found[BATCH].holds


def monkey(method: Method, name: str, replacement: Any) -> None:
    """Replace what a single method does."""
    object.__setattr__(method, name, replacement)


QUICK = ["gpu-check", "quick=true", "threads=1", "device=cpu", "results=here"]


@pytest.fixture
def cpu_as_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gpu, "require_gpu", lambda _: None)


@pytest.mark.usefixtures("cpu_as_gpu")
def test_what_was_found_is_printed_and_written(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(QUICK) == 0
    text = Path("here/gpu.md").read_text()
    assert capsys.readouterr().out.startswith(text)
    assert "The GPU gives what the CPU gives." in text
    assert len(re.findall(r"\| (?:paper|reference) +\| GPU, fused.*\| same +\|", text)) == 6
    assert (
        len(re.findall(r"\| (?:paper|reference) +\| [\d.]+ +\| [\d.]+ +\| 2, (?:met|missed) by the second", text)) == 2
    )
    assert (
        len(re.findall(r"offline, batch [14] +\| [\d,.]+ / [\d,.]+ / [\d,.]+ +\| 100,000, (?:met|missed)", text)) == 4
    )
    assert re.search(r"^triton (missing|\d)", text, re.MULTILINE)
    assert [path.name for path in Path("here").iterdir()] == ["gpu.md"]


@pytest.mark.usefixtures("cpu_as_gpu")
def test_a_difference_ends_with_code_1_and_the_file_says_so(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    state = VPRTempo.state

    def wrong(self: VPRTempo) -> dict[str, Any]:
        return {name: array * (1.01 if self.engine == "readable" else 1) for name, array in state(self).items()}

    monkeypatch.setattr(VPRTempo, "state", wrong)
    assert main(QUICK) == 1
    text = Path("here/gpu.md").read_text()
    assert "**FAILED: see below.**" in text
    assert len(re.findall(r"against GPU, readable.*\| FAILED +\|", text)) == 2
    assert "FAILED" in capsys.readouterr().out


@pytest.mark.usefixtures("cpu_as_gpu")
def test_an_engine_that_cannot_run_is_named_and_ends_with_code_1(monkeypatch: pytest.MonkeyPatch) -> None:
    engine = VPRTempo._engine

    def missing(self: VPRTempo) -> Any:
        if self.engine == "fused":
            raise RuntimeError("no triton here")
        return engine(self)

    monkeypatch.setattr(VPRTempo, "_engine", missing)
    assert main(QUICK) == 1
    assert Path("here/gpu.md").read_text().count("RuntimeError: no triton here") == 4 + 2
