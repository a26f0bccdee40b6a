"""The training in Triton gives what the readable one gives: on the GPU, or under Triton's interpreter without one.

Triton decides on import whether it interprets. So it runs in a process of its own, which is this file as a script.
"""

from __future__ import annotations

import functools
import importlib.util
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from types import ModuleType
from typing import Any, NoReturn

import numpy as np
import pytest
import torch

from vprbench.methods.vprtempo import training
from vprbench.methods.vprtempo.layer import Layer, draw_layer, feature_rates
from vprbench.methods.vprtempo.rules import RULES, RuleSet
from vprbench.methods.vprtempo.training import draw_schedule

SIZES = [4, 2]  # places of both modules
N_PIXELS, N_FEATURES = 36, 30
EPOCHS = 2
PLACES = np.tile(np.arange(sum(SIZES)), 2)
RELATIVE = 1e-4
ROUNDING = 1e-6
PARTS = [f"{layer} {part}" for layer in ("features", "outputs") for part in ("excitation", "inhibition", "thresholds")]


@dataclass(frozen=True)
class Case:
    """One training; `strength` multiplies the initial weights, so that more than 1 brings them to their limits."""

    rule_set: RuleSet = "paper"
    choices: dict[str, Any] = field(default_factory=dict)
    probabilities: tuple[float, float] = (0.1, 0.5)
    strength: float = 1.0
    stdp: float = 0.005
    steps_per_launch: int = 1000
    values_held: int = 2**28


CASES = {
    "paper": Case(),
    "reference": Case("reference"),
    "v1": Case("v1"),
    "stdp divided by rate": Case(choices={"stdp_divided_by_rate": True}),
    "gain": Case(choices={"homeostasis_gain": 10.0}),
    "error to each sign": Case(choices={"error_to_each_sign": True}),
    "all excitatory synapses exist": Case(probabilities=(1.0, 0.5)),
    "at the limits": Case(strength=300.0),
}
FEW = "few steps per launch"
OVERFLOWING = "an overflowing learning rate"
# A step of both modules holds 2 * 36 values in the feature layer and 2 * (36 + 30) in the output layer.
OTHER_CASES = {FEW: Case(steps_per_launch=7, values_held=5 * 132), OVERFLOWING: Case(stdp=1e38)}

Trained = dict[str, torch.Tensor]
Found = Callable[[str], tuple[Trained, list[float]]]  # of a case, with the progress reported
Report = Callable[[float], None]


def spikes() -> torch.Tensor:
    """Two traverses of the same places: smooth frames, the second with noise, a sixth of the pixels silent."""
    generator = np.random.default_rng(3)
    scenes = np.cumsum(generator.normal(size=(sum(SIZES), N_PIXELS)), axis=1)
    scenes = (scenes - scenes.mean(1, keepdims=True)) / scenes.std(1, keepdims=True)
    frames = np.concatenate([scenes, scenes + 0.2 * generator.normal(size=scenes.shape)])
    return torch.from_numpy((np.floor(255 * (1 + np.clip(frames, -1, 1)) / 2) / 255).astype(np.float32))


def trained(case: Case, engine: ModuleType, device: str, report: Report = lambda _: None) -> Trained:
    """Return excitation, inhibition and thresholds of both layers."""
    rules = replace(RULES[case.rule_set], **case.choices)
    generators = [torch.Generator().manual_seed(11 + module) for module in range(len(SIZES))]
    n_features = [N_FEATURES] * len(SIZES)
    features = draw_layer(generators, n_features, N_PIXELS, case.probabilities, 0.5, rules.constant_input, rules)
    outputs = draw_layer(generators, SIZES, N_FEATURES, (1.0, 1.0), 0.0, 0.0, rules)
    schedules = [draw_schedule(generators, SIZES, PLACES, EPOCHS, rules).to(device) for _ in range(2)]
    for layer in (features, outputs):
        layer.excitation *= case.strength
        layer.inhibition *= case.strength
    features, outputs, shown = features.to(device), outputs.to(device), spikes().to(device)
    rates = feature_rates(N_FEATURES, 0.2, 0.9).to(device)
    engine.train_features(features, shown, schedules[0], rates, case.stdp, 0.15, rules, report)
    engine.train_places(outputs, features, shown, schedules[1], rates, case.stdp, rules, report)
    return {**parts("features", features), **parts("outputs", outputs)}


def parts(name: str, layer: Layer) -> Trained:
    return {f"{name} {part}": getattr(layer, part).cpu() for part in ("excitation", "inhibition", "thresholds")}


def train_in_triton(name: str, results: str) -> None:
    """Train a case and write what it gave and the progress it reported; the entry point of the other process."""
    from vprbench.methods.vprtempo import fused_cuda

    device = "cuda" if torch.cuda.is_available() else "cpu"
    case, progress = (CASES | OTHER_CASES)[name], []
    fused_cuda._STEPS_PER_LAUNCH, fused_cuda._VALUES_HELD = case.steps_per_launch, case.values_held
    torch.save((trained(case, fused_cuda, device, progress.append), progress), results)


def not_run(reason: str) -> NoReturn:
    """Skip, but fail where these tests were asked for by name (`make test-triton`)."""
    if os.environ.get("VPRBENCH_INSIST_ON_TRITON"):
        pytest.fail(reason)
    pytest.skip(reason)


@pytest.fixture(scope="module")
def by_triton(tmp_path_factory: pytest.TempPathFactory) -> Found:
    if importlib.util.find_spec("triton") is None:
        not_run("triton is not installed: the engine for GPUs can run neither on one nor interpreted")
    folder = tmp_path_factory.mktemp("triton")
    interpreted = {} if torch.cuda.is_available() else {"TRITON_INTERPRET": "1"}

    @functools.cache  # a process for each case: the interpreter takes about 10 s for one
    def found(name: str) -> tuple[Trained, list[float]]:
        results = folder / f"{name}.pt"
        command = [sys.executable, __file__, name, results]
        child = subprocess.run(command, env=os.environ | interpreted, capture_output=True, text=True, check=False)
        if interpreted and "only 0-dimensional arrays can be converted" in child.stderr:
            not_run(f"triton's interpreter is older than numpy {np.__version__}: its loops fail (triton issue 9171)")
        assert child.returncode == 0, child.stderr
        return torch.load(results)

    return found


@pytest.fixture(scope="module")
def readable() -> Callable[[str], Trained]:
    return functools.cache(lambda name: trained((CASES | OTHER_CASES)[name], training, "cpu"))


def distance(first: torch.Tensor, second: torch.Tensor) -> float:
    """Return the largest difference as a share of the largest number of `second`."""
    return float((first - second).abs().max()) / (float(second.abs().max()) or 1.0)


@pytest.mark.parametrize("part", PARTS)
@pytest.mark.parametrize("name", CASES)
def test_a_training_in_triton_gives_the_same_layer(
    by_triton: Found, readable: Callable[[str], Trained], name: str, part: str
) -> None:
    assert distance(by_triton(name)[0][part], readable(name)[part]) <= RELATIVE


@pytest.mark.parametrize("part", PARTS)
def test_the_number_of_steps_per_launch_changes_nothing(by_triton: Found, part: str) -> None:
    assert distance(by_triton(FEW)[0][part], by_triton("paper")[0][part]) <= ROUNDING


def test_a_launch_takes_as_many_steps_as_memory_allows_and_is_reported(by_triton: Found) -> None:
    assert by_triton(FEW)[1] == [step / 16 for step in (7, 14, 16, 5, 10, 15, 16)]


@pytest.mark.parametrize("part", ["features inhibition", "outputs inhibition"])
def test_weights_that_are_no_numbers_stay_visible(
    by_triton: Found, readable: Callable[[str], Trained], part: str
) -> None:
    assert not bool(torch.isfinite(readable(OVERFLOWING)[part]).all())
    assert not bool(torch.isfinite(by_triton(OVERFLOWING)[0][part]).all())


if __name__ == "__main__":
    train_in_triton(*sys.argv[1:])
