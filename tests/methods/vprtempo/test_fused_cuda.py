"""Each engine trains the layers that the readable one trains.

The engine for GPUs runs on one, or under Triton's interpreter. Triton decides on import whether it interprets, so its
training runs in a process of its own, which is this file as a script.
"""

import functools
import importlib.util
import os
import subprocess
import sys
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest
import torch

from vprbench.methods.vprtempo import fused, training
from vprbench.methods.vprtempo.layer import draw_layer, ramp_rates
from vprbench.methods.vprtempo.rules import RULES, RuleSet
from vprbench.methods.vprtempo.training import Training, draw_schedule

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
    sizes: tuple[int, ...] = (4, 2)  # places of each module
    n_pixels: int = 36
    n_features: int = 30
    epochs: int = 2


CASES = {
    "paper": Case(),
    "reference": Case("reference"),
    "v1": Case("v1"),
    "stdp divided by rate": Case(choices={"stdp_divided_by_rate": True}),
    "gain and error": Case(choices={"homeostasis_gain": 10.0, "error_to_each_sign": True}),
    "all excitatory synapses exist": Case(probabilities=(1.0, 0.5)),
    "at the limits": Case(strength=300.0),
}
FEW, MANY = "few steps per launch", "many neurons"
OVERFLOWING = "an overflowing learning rate"
# A step of both modules holds 2 * 36 values in the feature layer and 2 * (36 + 30) in the output layer.
ALL = {
    **CASES,
    FEW: Case(steps_per_launch=7, values_held=5 * 132),
    MANY: Case(sizes=(40, 40, 20), n_pixels=100, n_features=300),
    OVERFLOWING: Case(stdp=1e38),
}


def spikes(case):
    """Two traverses of the same places: smooth frames, the second with noise, a sixth of the pixels silent."""
    generator = np.random.default_rng(3)
    scenes = np.cumsum(generator.normal(size=(sum(case.sizes), case.n_pixels)), axis=1)
    scenes = (scenes - scenes.mean(1, keepdims=True)) / scenes.std(1, keepdims=True)
    frames = np.concatenate([scenes, scenes + 0.2 * generator.normal(size=scenes.shape)])
    return torch.from_numpy((np.floor(255 * (1 + np.clip(frames, -1, 1)) / 2) / 255).astype(np.float32))


def trained(case, engine, device, report=lambda _: None):
    """Return excitation, inhibition and thresholds of both layers."""
    rules, sizes = replace(RULES[case.rule_set], **case.choices), case.sizes
    generators = [torch.Generator().manual_seed(11 + module) for module in range(len(sizes))]
    n_features, places = [case.n_features] * len(sizes), np.tile(np.arange(sum(sizes)), 2)
    features = draw_layer(generators, n_features, case.n_pixels, case.probabilities, 0.5, rules.constant_input, rules)
    outputs = draw_layer(generators, sizes, case.n_features, (1.0, 1.0), 0.0, 0.0, rules)
    orders = [draw_schedule(generators, sizes, places, case.epochs, rules).to(device) for _ in range(2)]
    for layer in (features, outputs):
        layer.excitation *= case.strength
        layer.inhibition *= case.strength
    features, outputs = features.to(device), outputs.to(device)
    rates = ramp_rates(case.n_features, 0.2, 0.9).to(device)
    lesson = Training(spikes(case).to(device), rates, rules, case.stdp, 0.15, case.stdp)
    engine.train_features(features, orders[0], lesson, report)
    engine.train_places(outputs, features, orders[1], lesson, report)
    return {**parts("features", features), **parts("outputs", outputs)}


def parts(name, layer):
    return {f"{name} {part}": getattr(layer, part).cpu() for part in ("excitation", "inhibition", "thresholds")}


def train_in_triton(name, results):
    """Train a case and write what it gave and the progress it reported; the entry point of the other process."""
    from vprbench.methods.vprtempo import fused_cuda

    device = "cuda" if torch.cuda.is_available() else "cpu"
    case, progress = ALL[name], []
    fused_cuda._STEPS_PER_LAUNCH, fused_cuda._VALUES_HELD = case.steps_per_launch, case.values_held
    torch.save((trained(case, fused_cuda, device, progress.append), progress), results)


def not_run(reason):
    """Skip, but fail where these tests were asked for by name (`VPRBENCH_INSIST_ON_TRITON`)."""
    if os.environ.get("VPRBENCH_INSIST_ON_TRITON"):
        pytest.fail(reason)
    pytest.skip(reason)


@pytest.fixture(scope="module")
def by_triton(tmp_path_factory):
    if importlib.util.find_spec("triton") is None:
        not_run("triton is not installed: the engine for GPUs can run neither on one nor interpreted")
    folder = tmp_path_factory.mktemp("triton")
    interpreted = {} if torch.cuda.is_available() else {"TRITON_INTERPRET": "1"}

    @functools.cache  # a process for each case: the interpreter takes about 10 s for one
    def found(name):
        results = folder / f"{name}.pt"
        command = [sys.executable, __file__, name, results]
        child = subprocess.run(command, env=os.environ | interpreted, capture_output=True, text=True, check=False)
        if interpreted and "only 0-dimensional arrays can be converted" in child.stderr:
            not_run(f"triton's interpreter is older than numpy {np.__version__}: its loops fail (triton issue 9171)")
        assert child.returncode == 0, child.stderr
        return torch.load(results)

    return found


@functools.cache
def by(engine, name):
    return trained(ALL[name], engine, "cpu")


def distance(first, second):
    """Return the largest difference as a share of the largest number of `second`."""
    return float((first - second).abs().max()) / (float(second.abs().max()) or 1.0)


@pytest.mark.parametrize("name", [*CASES, MANY])
def test_a_compiled_training_gives_the_same_layers(name):
    for part in PARTS:
        assert distance(by(fused, name)[part], by(training, name)[part]) <= RELATIVE, part


@pytest.mark.extended
@pytest.mark.parametrize("name", CASES)
def test_a_training_in_triton_gives_the_same_layers(by_triton, name):
    for part in PARTS:
        assert distance(by_triton(name)[0][part], by(training, name)[part]) <= RELATIVE, part


@pytest.mark.extended
def test_launches_of_few_steps_change_nothing_are_reported_and_leave_no_number_hidden(by_triton):
    for part in PARTS:
        assert distance(by_triton(FEW)[0][part], by_triton("paper")[0][part]) <= ROUNDING
    assert by_triton(FEW)[1] == [step / 16 for step in (7, 14, 16, 5, 10, 15, 16)]
    for layer in ("features", "outputs"):
        assert not bool(torch.isfinite(by_triton(OVERFLOWING)[0][f"{layer} inhibition"]).all())


if __name__ == "__main__":
    train_in_triton(*sys.argv[1:])
